"""A certificate in sentences: the first line says whose scale it rests on, the next what is promised."""

from calib.certificate.certificate_contents import Contents
from calib.certify.calibration_verdict import rigid_motion_text, stands
from calib.certify.iso230_axis_errors import AxisTest
from calib.certify.iso9283 import POSES, VISITS
from calib.certify.recording_claim_check import AgainstClaim
from calib.certify.tolerance_conformity import CONFORMS, FAILS
from calib.certify.uncertainty_budget import Contribution, Expanded


def micrometre_text(value: float) -> str:
    """A length in micrometres, to two digits of what matters."""
    return f"{value * 1e6:.1f} um" if value < 1e-3 else f"{value * 1e3:.3f} mm"


def microradian_text(value: float) -> str:
    """An angle in microradians."""
    return f"{value * 1e6:.1f} urad" if value < 1e-3 else f"{value * 1e3:.3f} mrad"


def percentage_text(value: float) -> str:
    """A share in per cent, to no more digits than it has."""
    return f"{100 * value:.4g} %"


def scale_line(c: Contents) -> str:
    """Whose scale the certificate rests on."""
    holder = c.conditions.frame
    if c.asked.scale is None:
        return (
            f"Nobody certified the scale: lengths are in units of {holder}, and an error of theirs is in "
            "every figure here "
            f"({_far(c) * 1e-4 * 1e6:.0f} um at the volume's far end for each 0.1 mm/m)."
        )
    by = f", by {c.asked.scale_source}" if c.asked.scale_source else ", as stated; by whom is not said"
    return (
        f"Scale held by {holder}, standard uncertainty {c.asked.scale * 1e6:.3g} um/m{by}; it is part of the promise."
    )


def _far(c: Contents) -> float:
    return float(sum(max(abs(low), abs(high)) ** 2 for low, high in zip(c.volume.low, c.volume.high)) ** 0.5)


def promise_line(c: Contents) -> str:
    """What is promised."""
    p = c.promise
    both = (
        micrometre_text(p.position.upper)
        if p.rotation is None
        else f"both {micrometre_text(p.position.upper)} and {microradian_text(p.rotation.upper)}"
    )
    how_sure = f"With {percentage_text(p.confidence)} confidence, {percentage_text(p.coverage)} of poses"
    return f"{how_sure} in this volume lie within {both} of where they should be."


def volume_line(c: Contents) -> str:
    """Which volume is meant."""
    v = c.volume
    box = ", ".join(f"{axis} {low * 1e3:.1f} to {high * 1e3:.1f} mm" for axis, low, high in zip("xyz", v.low, v.high))
    turned = "" if v.turned is None else f", turned by up to {v.turned * 57.29578:.1f} degrees from the middle"
    unit, scale = ("degrees", 57.29578) if c.machine == "arm" else ("mm", 1e3)
    axes = ", ".join(f"{name} {low * scale:.1f} to {high * scale:.1f}" for name, (low, high) in zip(v.axes, v.commands))
    return f"The volume: {box}{turned}; {axes} {unit}."


def basis_lines(c: Contents) -> list[str]:
    """On what the promise rests, in a few lines."""
    p, r = c.promise, c.repeatability
    lines = [
        f"From {p.n} distinct configurations, none of which took part in fitting; as measured, noise and "
        "all, the limit is "
        f"{micrometre_text(p.position.measured)}"
        + ("" if p.rotation is None else f" and {microradian_text(p.rotation.measured)}")
        + f"; half of the poses lie nearer than {micrometre_text(_median(c))}."
    ]
    lines += [claim_line(one) for one in c.claims]
    if p.position.shared or p.position.scale:
        lines.append(
            f"In it: {micrometre_text(p.position.shared)} for what all poses of a recording share (cameras, lenses), "
            f"{micrometre_text(p.position.scale)} for "
            "the scale; margins add in squares."
        )
    if r.position is not None:
        ratio = c.after.position[0] / r.position if r.position else float("inf")
        one = f"; from one side {micrometre_text(r.one_sided[0])}" if r.one_sided else ""
        lines.append(
            f"Repeatability, the floor: {micrometre_text(r.position)}"
            + ("" if r.rotation is None else f" and {microradian_text(r.rotation)}")
            + f" RMS over {r.visits} visits to {r.poses} poses, measuring included "
            f"({micrometre_text(r.noise[0])}){one}. "
            f"The error is {ratio:.2f} times it."
        )
    else:
        lines.append(
            "Repeatability is not known: no configuration was visited twice. A measured pose is uncertain "
            f"by {micrometre_text(r.noise[0])}."
        )
    if c.confounds is not None:
        lines.append(_sentence(c.confounds.line()))
    if not c.cells:
        lines.append("No bound for parts of the volume: that takes as many configurations in each as for the whole.")
    return lines


def claim_line(one: AgainstClaim) -> str:
    """The calibration's claim against what a held-out recording shows."""
    if not one.parts:
        return f"Nothing that {one.recording} measured is claimed by the calibration."
    said = []
    for name, (_, beyond, (middle, low, high)) in one.parts.items():
        size = micrometre_text if name == "position" else microradian_text
        said.append(
            f"{name} error {size(beyond)} RMS beyond measuring noise, claimed {size(middle)} ({size(low)} to "
            f"{size(high)})"
        )
    return (
        f"The calibration's claim is {stands(one.found)} by {one.recording}: "
        f"{'; '.join(said)}{rigid_motion_text(one.found)}."
    )


def _sentence(line: str) -> str:
    return line[:1].upper() + line[1:] + "."


def _median(c: Contents) -> float:
    import numpy as np

    return float(np.median(np.linalg.norm(c.errors[:, :3], axis=1)))


def conformity_lines(c: Contents) -> list[str]:
    """One sentence for the tolerances, and what each alone shows where there are two."""
    if not c.conformity:
        return []
    first = c.conformity[0]
    sizes = {k.quantity: (micrometre_text if k.quantity == "position" else microradian_text) for k in c.conformity}
    if first.estimate != first.estimate:
        why = "too few configurations for a decision that is wrong in 2.5 % of cases at the most"
    elif first.verdict == CONFORMS:
        why = f"even the upper limit, {_each(c, 'upper')}, is within it"
    elif first.verdict == FAILS:
        why = f"even the lower limit, {_each(c, 'lower')}, is beyond it"
    elif first.given_scale == CONFORMS:
        why = (
            f"nobody certified the scale; if {c.conditions.frame} hold, it conforms, as even the upper limit, "
            f"{_each(c, 'upper')}, is within it"
        )
    else:
        why = f"it lies between the limits {_each(c, 'lower')} and {_each(c, 'upper')}"
    both = " and ".join(f"{k.quantity} within {sizes[k.quantity](k.tolerance)}" for k in c.conformity)
    lines = [f"{both[0].upper()}{both[1:]} for {percentage_text(c.asked.coverage)} of poses: {first.verdict}; {why}."]
    if len(c.conformity) > 1:
        counts = ", ".join(f"{k.beyond} lie beyond the tolerance of {k.quantity}" for k in c.conformity)
        lines.append(f"Of the {c.promise.n} held-out poses as measured, {counts}.")
    return lines


def _each(c: Contents, limit: str) -> str:
    return " with ".join(
        (micrometre_text if k.quantity == "position" else microradian_text)(getattr(k, limit)) for k in c.conformity
    )


def iso9283_line(c: Contents) -> str:
    """What of ISO 9283 there is."""
    t = c.iso9283
    n, mean, most = t.random
    random = (
        f"Over all {n} poses, one visit each, AP is {micrometre_text(mean)} in the mean and "
        f"{micrometre_text(most)} at the most."
    )
    if not t.repeated:
        return f"ISO 9283 asks for {POSES} poses of {VISITS} visits; no pose was visited often enough for RP. {random}"
    least = min(row.visits for row in t.repeated)
    formal = "as the standard requires" if t.formal else f"not formal: {'; '.join(t.not_met)}"
    return f"{len(t.repeated)} poses of {least} visits and more, {formal}. Five poses say little of a volume. {random}"


def iso230_figures(axis: AxisTest) -> list[tuple[str, float | None]]:
    """(symbol of ISO 230-2:2014, value in m or rad) of one axis."""
    return [
        ("B", axis.B),
        ("mean B", axis.B_mean),
        ("M", axis.M),
        ("E", axis.E),
        ("E↑", axis.E_up),
        ("E↓", axis.E_down),
        ("R", axis.R),
        ("R↑", axis.R_up),
        ("R↓", axis.R_down),
        ("A", axis.A),
        ("A↑", axis.A_up),
        ("A↓", axis.A_down),
    ]


def expanded_uncertainty_text(total: Expanded) -> str:
    """A total of the budget with its coverage factors."""
    position = f"U = {micrometre_text(total.position)} (k = {total.k[0]:.2f})"
    return (
        position
        if total.rotation is None
        else f"{position} and {microradian_text(total.rotation)} (k = {total.k[1]:.2f})"
    )


def coverage_factor_text(row: Contribution) -> str:
    """Coverage factors of a contribution, of position and of rotation."""
    if row.k is None:
        return ""
    return f"{row.k[0]:.2f}" if row.rotation is None else f"{row.k[0]:.2f}, {row.k[1]:.2f}"
