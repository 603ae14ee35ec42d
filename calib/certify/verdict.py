"""A calibration in a few lines: first what it is worth and on what that rests, then what matters."""

import math

from calib.certify.configurations import LEAST
from calib.certify.held_out import HeldOut
from calib.certify.claim import Claim

CHANCE = 2.4  # by how much the mean square of six shared errors, drawn once, may exceed what is expected (97.5 % of chi-square / 6)


def verdict(claim: Claim) -> list[str]:
    """Lines of a Claim, the first of which says it all."""
    configurations = f"{claim.distinct} distinct configuration{'' if claim.distinct == 1 else 's'}"
    rest = claim.unknowns - claim.determined
    told = (f"{claim.determined} of {claim.unknowns} combinations of the parameters are told by these poses"
            + (f", {claim.better} of them better than the owner's figures are" if claim.better < claim.determined else "")
            + (f"; {rest} rest on the owner's figures" if rest else "") + f" ({claim.tolerance})") if claim.unknowns else claim.tolerance
    if claim.ratio is None or claim.before is None or claim.after is None or claim.measured is None:
        few = ["no held-out figure either: what is left at the recorded configurations would only say how well these are known"]
        return [f"no factor is claimed: {claim.reason}", told, *(few if claim.distinct < LEAST else [])]
    before, after = claim.before[0], claim.after[0]
    turned = f", rotation {claim.before[1][0] * 1e3:.3f} -> {claim.after[1][0] * 1e3:.4f} mrad" if any(claim.before[1]) else ""
    return [f"{factor(claim.ratio)} all over the workspace: position error {before[0] * 1e3:.3f} -> {after[0] * 1e3:.4f} mm RMS ("
            f"{after[1] * 1e3:.4f} to {after[2] * 1e3:.4f}){turned}; "
            f"from {configurations}", told,
            f"the workspace is {claim.workspace}; seen there by an instrument like this one, its own errors included: {factor(claim.measured)}"]


def factor(three: tuple[float, ...]) -> str:
    """A ratio (median, low, high) in words; low and high are NaN where there is no interval."""
    interval = "too few configurations for an interval" if math.isnan(three[1]) else f"95 % interval {three[1]:.3g} to {three[2]:.3g}"
    return f"{three[0]:.3g} times better ({interval})"


def kept(held: HeldOut, claim: Claim) -> bool:
    """Whether measured poses are no further off than the claim's upper end and what measuring them adds."""
    return held.after.position[0] <= most(held, claim)


def most(held: HeldOut, claim: Claim) -> float:
    """m RMS, what a recording may be off by where the claim is kept. Raises ValueError for a Claim without a factor."""
    if claim.after is None:
        raise ValueError("no factor is claimed, so there is nothing to keep")
    return math.sqrt(claim.after[0][2] ** 2 + CHANCE * held.floor[0] ** 2)


def verified(held: HeldOut, claim: Claim | None) -> str:
    """The verdict on a calibration by a recording's poses: a line."""
    where = "this 1 configuration" if held.configurations == 1 else f"these {held.configurations} configurations"
    placed = math.isfinite(held.after.position[0])
    before, after, unit = (held.before.position, held.after.position, "mm") if placed else (held.before.rotation, held.after.rotation, "mrad")
    here = f"{factor(held.ratio)} on {where}: {before[0] * 1e3:.3f} -> {after[0] * 1e3:.4f} {unit} RMS as measured"
    if claim is None or claim.after is None:
        return f"{here}; no factor was claimed" + (f": {claim.reason}" if claim else "")
    limit = f"up to {most(held, claim) * 1e3:.4f} mm with what measuring adds"
    return f"{here}; the claim is {'kept' if kept(held, claim) else 'NOT kept'} ({claim.after[0][0] * 1e3:.4f} mm, {limit})"
