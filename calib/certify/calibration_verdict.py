"""A calibration in a few lines: first what it is worth and on what that rests, then what matters."""

import math

from calib.certify.claim_verification import Verification
from calib.certify.distinct_configurations import LEAST
from calib.certify.held_out_errors import HeldOut
from calib.certify.workspace_claim import Claim

WHERE = {"base": "base, or the instrument,", "platform": "target on the platform"}


def claim_lines(claim: Claim) -> list[str]:
    """Lines of a Claim, the first of which says it all."""
    configurations = f"{claim.distinct} distinct configuration{'' if claim.distinct == 1 else 's'}"
    rest = claim.unknowns - claim.determined
    told = (
        (
            f"{claim.determined} of {claim.unknowns} combinations of the parameters are told by these poses"
            + (
                f", {claim.better} of them better than the owner's figures are"
                if claim.better < claim.determined
                else ""
            )
            + (f"; {rest} rest on the owner's figures" if rest else "")
            + f" ({claim.tolerance})"
        )
        if claim.unknowns
        else claim.tolerance
    )
    if claim.ratio is None or claim.before is None or claim.after is None or claim.measured is None:
        few = [
            "no held-out figure either: what is left at the recorded configurations would only say how well "
            "these are known"
        ]
        return [f"no factor is claimed: {claim.reason}", told, *(few if claim.distinct < LEAST else [])]
    before, after = claim.before[0], claim.after[0]
    turned = (
        f", rotation {claim.before[1][0] * 1e3:.3f} -> {claim.after[1][0] * 1e3:.4f} mrad"
        if any(claim.before[1])
        else ""
    )
    return [
        f"{ratio_text(claim.ratio)} all over the workspace: position error {before[0] * 1e3:.3f} -> "
        f"{after[0] * 1e3:.4f} mm RMS ("
        f"{after[1] * 1e3:.4f} to {after[2] * 1e3:.4f}){turned}; "
        f"from {configurations}",
        told,
        f"the workspace is {claim.workspace}; seen there by an instrument like this one, its own errors "
        f"included: {ratio_text(claim.measured)}",
    ]


def ratio_text(three: tuple[float, ...]) -> str:
    """A ratio (median, low, high) in words; low and high are NaN where there is no interval."""
    interval = (
        "too few configurations for an interval"
        if math.isnan(three[1])
        else f"95 % interval {three[1]:.3g} to {three[2]:.3g}"
    )
    return f"{three[0]:.3g} times better ({interval})"


def verification_line(held: HeldOut, claim: Claim | None, found: Verification | None) -> str:
    """What a recording's poses show of a calibration: a line. found : Verification of the claim, None where no factor
    is claimed
    """
    where = "this 1 configuration" if held.configurations == 1 else f"these {held.configurations} configurations"
    placed = math.isfinite(held.after.position[0])
    before, after, unit = (
        (held.before.position, held.after.position, "mm")
        if placed
        else (held.before.rotation, held.after.rotation, "mrad")
    )
    here = f"{ratio_text(held.ratio)} on {where}: {before[0] * 1e3:.3f} -> {after[0] * 1e3:.4f} {unit} RMS as measured"
    if claim is None or found is None:
        return f"{here}; no factor was claimed" + (f": {claim.reason}" if claim else "")
    if not found.parts:
        return f"{here}; nothing that was measured is claimed"
    return f"{here}; the claim is {stands(found)} ({claim_comparison_text(found)})" + rigid_motion_text(found)


def stands(found: Verification) -> str:
    """Whether a claim is kept, in words."""
    if found.kept:
        return "kept"
    within = found.unexplained and not found.refutes and (found.offset is None or not found.offset.kept)
    return "exceeded by no more than what it names as unexplained may" if within else "NOT kept"


def claim_comparison_text(found: Verification) -> str:
    """Each part of a claim against what was measured, in words."""
    said = []
    for name, part in found.parts.items():
        unit = "mm" if name == "position" else "mrad"
        said.append(
            f"{name} {part.rms * 1e3:.4f} {unit} where up to {part.claimed * 1e3:.4f} is claimed, "
            f"{part.of_allowed:.2f} times what claim and "
            f"noise allow, chance up to {part.limit:.2f}"
        )
    return "; ".join(said)


def refutation_sentence(found: Verification) -> str:
    """What a claim that is not kept is refuted by, a sentence: 45 um where 3.4 um is claimed."""
    wrong = [(name, part) for name, part in found.parts.items() if not part.kept]
    return " and ".join(
        f"{name} error {_size(part.rms, name)} RMS where up to {_size(part.claimed, name)} is claimed"
        for name, part in wrong
    )


def rigid_motion_text(found: Verification) -> str:
    """The rigid motion that explains why a claim is not kept, in words that follow; nothing where none does."""
    if found.offset is None:
        return ""
    o = found.offset
    return (
        f"; the {WHERE[o.of]} stands elsewhere than when it was calibrated: by {o.position * 1e3:.4f} mm, "
        f"{o.rotation * 1e3:.4f} mrad; without "
        f"that motion the claim is {'kept' if o.kept else 'NOT kept either'}"
    )


def _size(value: float, name: str) -> str:
    return f"{value * 1e6:.3g} {'um' if name == 'position' else 'urad'}"
