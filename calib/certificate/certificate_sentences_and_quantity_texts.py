"""Sentences of a certificate, and texts of its quantities.

Scale, promise, volume, basis, conformity, ISO figures and uncertainties.
"""

from calib.certificate.certificate_content_dataclasses import Contents
from calib.certification.calibration_dataclass_and_claim_sentences import (
    claim_check_result_text,
    explaining_rigid_motion_text,
)
from calib.certification.calibration_evidence_verdict_and_claim_check import AgainstClaim
from calib.certification.iso230_and_iso9283_tests import POSES, VISITS, AxisTest
from calib.certification.pose_error_promise_and_conformity import CONFORMS, FAILS
from calib.certification.uncertainty_budget import Contribution, Expanded
from rig.effects.framework.parameters_covariates_and_marker_table import PLOT_UNITS


def micrometre_text(value: float) -> str:
    """Text of a length in micrometres.

    It has two significant digits.
    """
    return f"{value * 1e6:.1f} um" if value < 1e-3 else f"{value * 1e3:.3f} mm"


def _microradian_text(value: float) -> str:
    """An angle in microradians."""
    return f"{value * 1e6:.1f} urad" if value < 1e-3 else f"{value * 1e3:.3f} mrad"


def _percentage_text(value: float) -> str:
    """A share in per cent, to no more digits than it has."""
    return f"{100 * value:.4g} %"


def length_scale_line(certificate: Contents) -> str:
    """Line on the length scale that a certificate rests on.

    It says whose it is.
    """
    holder = certificate.conditions.frame
    if certificate.options.scale is None:
        return (
            f"The scale is not certified: lengths are in units of {holder}, whose error is in "
            "every figure here "
            f"({_far(certificate) * 1e-4 * 1e6:.0f} um at the volume's far end for each 0.1 mm/m)."
        )
    by = (
        f", by {certificate.options.scale_source}"
        if certificate.options.scale_source
        else ", as stated; its source is not stated"
    )
    return (
        f"Scale held by {holder}, standard uncertainty {certificate.options.scale * 1e6:.3g} um/m{by}; it is part "
        "of the promise."
    )


def _far(c: Contents) -> float:
    return float(sum(max(abs(low), abs(high)) ** 2 for low, high in zip(c.volume.low, c.volume.high)) ** 0.5)


def promise_line(certificate: Contents) -> str:
    """Line on a certificate's promise.

    The error bounds, their coverage and confidence.
    """
    p = certificate.promise
    both = (
        micrometre_text(p.position.upper)
        if p.rotation is None
        else f"both {micrometre_text(p.position.upper)} and {_microradian_text(p.rotation.upper)}"
    )
    how_sure = f"With {_percentage_text(p.confidence)} confidence, {_percentage_text(p.coverage)} of poses"
    one_sided = certificate.conditions.one_sided
    approached = f", approached {one_sided} as recorded," if one_sided else ""
    return f"{how_sure} in this volume{approached} lie within {both} of their nominal places."


def measured_volume_line(certificate: Contents) -> str:
    """Line on the volume in which a certificate's poses were measured."""
    v = certificate.volume
    box = ", ".join(f"{axis} {low * 1e3:.1f} to {high * 1e3:.1f} mm" for axis, low, high in zip("xyz", v.low, v.high))
    turned = "" if v.turned is None else f", turned by up to {v.turned * 57.29578:.1f} degrees from the middle"
    mixed, axes = len(set(v.units)) > 1, []
    for name, (low, high), unit in zip(v.axes, v.commands, v.units):
        scale, shown = PLOT_UNITS[unit]
        axes.append(f"{name} {low * scale:.1f} to {high * scale:.1f}" + (f" {shown}" if mixed else ""))
    return f"The volume: {box}{turned}; {', '.join(axes)}{'' if mixed else f' {PLOT_UNITS[v.units[0]][1]}'}."


def promise_basis_lines(certificate: Contents) -> list[str]:
    """Lines on what a certificate's promise rests on.

    They are poses, conditions and recordings.
    """
    p, r = certificate.promise, certificate.repeatability
    lines = [
        f"From {p.n} distinct configurations, none of which was used in fitting; as measured, noise "
        "included, the limit is "
        f"{micrometre_text(p.position.measured)}"
        + ("" if p.rotation is None else f" and {_microradian_text(p.rotation.measured)}")
        + f"; half of the poses lie within {micrometre_text(_median(certificate))}."
    ]
    lines += [f"{line[0].upper()}{line[1:]}." for line in certificate.displacement]
    lines += [_claim_line(one) for one in certificate.claims]
    if p.position.shared or p.position.scale:
        lines.append(
            f"In it: {micrometre_text(p.position.shared)} for what all poses of a recording share (cameras, lenses), "
            f"{micrometre_text(p.position.scale)} for "
            "the scale; margins add in squares."
        )
    if r.position is not None:
        ratio = certificate.after.position[0] / r.position if r.position else float("inf")
        one = f"; from one side {micrometre_text(r.one_sided[0])}" if r.one_sided else ""
        lines.append(
            f"Repeatability, the floor: {micrometre_text(r.position)}"
            + ("" if r.rotation is None else f" and {_microradian_text(r.rotation)}")
            + f" RMS over {r.visits} visits to {r.poses} poses, measuring included "
            f"({micrometre_text(r.noise[0])}){one}. "
            f"The error is {ratio:.2f} times it."
        )
    else:
        lines.append(
            "Repeatability is unknown: no configuration was visited twice. A measured pose is uncertain "
            f"by {micrometre_text(r.noise[0])}."
        )
    k = certificate.conditions
    if k.moving:
        lines.append(f"Not counted: {k.moving} exposures within {k.rest:g} s of a move; the limit is of poses held.")
    if certificate.confounds is not None:
        lines.append(_sentence(certificate.confounds.line()))
    if not certificate.cells:
        lines.append("No bound for parts of the volume: each part requires as many configurations as the whole.")
    return lines


def _claim_line(claim_check: AgainstClaim) -> str:
    """The calibration's claim against what a held-out recording shows."""
    if not claim_check.parts:
        return f"Nothing that {claim_check.recording} measured is claimed by the calibration."
    lines = []
    for name, (_, beyond, (middle, low, high)) in claim_check.parts.items():
        size = micrometre_text if name == "position" else _microradian_text
        lines.append(
            f"{name} error {size(beyond)} RMS beyond measuring noise, claimed {size(middle)} ({size(low)} to "
            f"{size(high)})"
        )
    return (
        f"The calibration's claim is {claim_check_result_text(claim_check.found)} by {claim_check.recording}: "
        f"{'; '.join(lines)}{explaining_rigid_motion_text(claim_check.found)}."
    )


def _sentence(line: str) -> str:
    return line[:1].upper() + line[1:] + "."


def _median(c: Contents) -> float:
    import numpy as np

    return float(np.median(np.linalg.norm(c.errors[:, :3], axis=1)))


def conformity_lines(certificate: Contents) -> list[str]:
    """Lines on conformity with the tolerances.

    They are together and each alone.
    """
    if not certificate.conformity:
        return []
    first = certificate.conformity[0]
    sizes = {
        k.quantity: (micrometre_text if k.quantity == "position" else _microradian_text) for k in certificate.conformity
    }
    if first.estimate != first.estimate:
        why = "too few configurations for a decision that is wrong in at most 2.5 % of cases"
    elif first.verdict == CONFORMS:
        why = f"even the upper limit, {_each(certificate, 'upper')}, is within it"
    elif first.verdict == FAILS:
        why = f"even the lower limit, {_each(certificate, 'lower')}, is beyond it"
    elif first.given_scale == CONFORMS:
        why = (
            f"the scale is not certified; if {certificate.conditions.frame} are correct, it conforms, as even the "
            "upper limit, "
            f"{_each(certificate, 'upper')}, is within it"
        )
    else:
        why = f"it lies between the limits {_each(certificate, 'lower')} and {_each(certificate, 'upper')}"
    both = " and ".join(f"{k.quantity} within {sizes[k.quantity](k.tolerance)}" for k in certificate.conformity)
    lines = [
        f"{both[0].upper()}{both[1:]} for {_percentage_text(certificate.options.coverage)} of poses: "
        f"{first.verdict}; {why}."
    ]
    if len(certificate.conformity) > 1:
        counts = ", ".join(f"{k.beyond} lie beyond the tolerance of {k.quantity}" for k in certificate.conformity)
        lines.append(f"Of the {certificate.promise.n} held-out poses as measured, {counts}.")
    return lines


def _each(c: Contents, limit: str) -> str:
    return " with ".join(
        (micrometre_text if k.quantity == "position" else _microradian_text)(getattr(k, limit)) for k in c.conformity
    )


def iso9283_line(certificate: Contents) -> str:
    """Line on the ISO 9283 figures of a certificate."""
    t = certificate.iso9283
    n, mean, most = t.random
    random = (
        f"Over all {n} poses, one visit each, AP is {micrometre_text(mean)} on average and "
        f"{micrometre_text(most)} at the most."
    )
    if not t.repeated:
        return f"ISO 9283 requires {POSES} poses of {VISITS} visits; no pose was visited often enough for RP. {random}"
    least = min(row.visits for row in t.repeated)
    formal = "as the standard requires" if t.formal else f"not formal: {'; '.join(t.not_met)}"
    return f"{len(t.repeated)} poses of {least} visits and more, {formal}. Five poses say little of a volume. {random}"


def iso230_symbol_values(axis: AxisTest) -> list[tuple[str, float | None]]:
    """Values of one axis by symbol of ISO 230-2:2014.

    Returns (symbol, value in m or rad)
    """
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


def expanded_uncertainty_text(expanded_uncertainty: Expanded) -> str:
    """Text of an expanded uncertainty.

    It is that of the whole budget, with its coverage factors.
    """
    position = f"U = {micrometre_text(expanded_uncertainty.position)} (k = {expanded_uncertainty.k[0]:.2f})"
    return (
        position
        if expanded_uncertainty.rotation is None
        else f"{position} and {_microradian_text(expanded_uncertainty.rotation)} (k = {expanded_uncertainty.k[1]:.2f})"
    )


def coverage_factor_text(contribution: Contribution) -> str:
    """Text of a contribution's coverage factors, of position and of rotation."""
    if contribution.k is None:
        return ""
    return (
        f"{contribution.k[0]:.2f}"
        if contribution.rotation is None
        else f"{contribution.k[0]:.2f}, {contribution.k[1]:.2f}"
    )
