"""HTML page of a verification.

It says whether a calibration's claim still holds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration, verification_line
from calib.certification.calibration_evidence_verdict_and_claim_check import (
    calibration_evidence,
    evidence_with_confounds,
    evidence_with_displaced_base_or_tool,
    evidence_with_verification,
)
from calib.certification.claim_verification import Verification
from calib.certification.held_out_pose_error_statistics import Figures, HeldOut
from calib.certification.redundant_strut_length_conflict_causing_internal_forces import StrutConflict
from calib.report.pose_and_effect_figures import correction_error_figures, pose_coverage_figures, rig_scene
from calib.samples.commanded_and_measured_pose_samples import Samples
from calib.samples.position_confounds_and_poses_on_one_clock import Confounds
from rig.array_and_json_types import Floats, Integers
from rig.formats.numbers_and_units import count_text
from rig.model.design import Design
from rig.model.pose import pose_to_vector
from rig.report.pages.html_and_svg_elements import figures_with_caption_html, heading_html, paragraph_html, table_html
from rig.report.pages.image_plane_and_3d_views import view_3d_html, view_3d_scripts_if_needed
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import Series, figures_side_by_side_html, plot_panel_svg
from rig.report.verdict_refutations_and_result_display import (
    AGREES,
    Evidence,
    MissingEvidence,
    Refutation,
    Verdict,
    judge_evidence,
)

FAR = 3.0  # times the stated uncertainty, which errors that all poses share may reach by chance: beyond it is refuted
ANOTHER = "Verify with a recording that was not used in the calibration: `rig verify calibration.json OTHER-REC`"
CHANGED = "Determine what changed: `rig watch calibration.json REC`; unmodelled effects: `rig diagnose REC --out found`"
CERTIFY = "State what is promised, with what confidence: `rig certify calibration.json REC --out certificate.html`"


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """samples; before, after : (n, 6) errors by the nominal model and corrected, m and rad; held : their figures
    found : Verification of the claim, or None; calibration, refutations : Calibration, and what later recordings found
        against it
    same : numbers of frames that it was made from; driven : where poses were wanted, (figures of the errors, stated
    uncertainty (m, rad), errors (n, 6)), else None; unsolved : {frame number: why it has no pose}
    confounds : of the recording, None where it states no conditions
    displacement : what is stated of base and tool, which the errors are without; unexpected : those of them that stand
    elsewhere though their place is stated; conflict : of more than six struts, where followers show it"""

    design: Design
    samples: Samples
    before: Floats
    after: Floats
    held: HeldOut
    found: Verification | None
    calibration: Calibration
    refutations: Sequence[Refutation]
    same: Sequence[int]
    driven: tuple[Figures, tuple[float, float], Floats] | None
    unsolved: dict[int, str]
    confounds: Confounds | None = None
    displacement: tuple[str, ...] = ()
    unexpected: tuple[str, ...] = ()
    conflict: StrutConflict | None = None


def write_verification_page(path: Path | str, name: str, verified: Verified, links: Sequence[Link] = ()) -> None:
    """Write the HTML page of a verification.

    name : of the recording
    """
    floor = (
        f"The uncertainty of the measured poses is {verified.held.floor[0] * 1e3:.4f} mm and "
        f"{verified.held.floor[1] * 1e3:.4f} mrad."
    )
    errors = {"nominal model": -verified.before, "corrected": -verified.after}
    parts: list[str] = []
    if verified.driven is not None:
        parts += [
            heading_html("Wanted and measured poses"),
            _wanted_poses_html(verified.samples.frame, *verified.driven),
        ]
    parts += [
        heading_html("Errors before and after, by pose"),
        correction_error_figures(verified.before, verified.after, verified.samples.frame, "poses of this recording"),
        _figures(verified.held),
        *([paragraph_html(floor)] if np.isfinite(verified.held.floor).all() else []),
        *(paragraph_html(f"{_capitalised(line)}.") for line in verified.displacement),
        *([] if verified.conflict is None else [paragraph_html(f"{_capitalised(verified.conflict.line())}.")]),
        heading_html("In three dimensions"),
        *view_3d_html(
            rig_scene(
                verified.design,
                verified.samples.frame,
                verified.samples.T_base_platform,
                verified.samples.commanded,
                errors,
            )
        ),
        heading_html("Positions"),
        pose_coverage_figures(pose_to_vector(verified.samples.T_base_platform)),
    ]
    if verified.unsolved:
        parts += [
            heading_html("Frames without a pose"),
            table_html(("frame", "reason"), sorted(verified.unsolved.items())),
        ]
    verdict = verification_verdict(verified)
    write_page(
        path,
        Page(
            "verify", f"Verification by {name}", verdict, parts, verdict.next, links, view_3d_scripts_if_needed(parts)
        ),
    )


def _capitalised(line: str) -> str:
    return line[0].upper() + line[1:]


def verification_verdict(verified: Verified) -> Verdict:
    """Verdict on a verification."""
    if verified.driven is not None:
        return judge_evidence(_evidence_from_wanted_poses(verified))
    if verified.same:
        return judge_evidence(
            Evidence(
                "no verdict",
                missing=(
                    MissingEvidence(f"the calibration was made from {len(verified.same)} of these frames", ANOTHER),
                ),
            )
        )
    known = calibration_evidence(
        verified.calibration,
        verified.refutations,
        verification_line(verified.held, verified.calibration.claim, verified.found),
        (CERTIFY,),
    )
    known = evidence_with_confounds(known, verified.calibration, (verified.confounds,), "this recording")
    known = evidence_with_displaced_base_or_tool(known, verified.unexpected)
    return judge_evidence(evidence_with_verification(known, verified.found, next_step=CHANGED))


def refutes_claim(verified: Verified) -> bool:
    """Whether a verification refutes the calibration's claim.

    By its poses, which nothing was fitted to.
    """
    return verified.driven is None and not verified.same and verified.found is not None and verified.found.refutes


def _evidence_from_wanted_poses(v: Verified) -> Evidence:
    """Evidence of poses wanted against those that came."""
    assert v.driven is not None
    figures, stated, _ = v.driven
    pairs = [
        (size, sigma)
        for size, sigma in zip((figures.position[0], figures.rotation[0]), stated)
        if 0 < sigma < math.inf and math.isfinite(size)
    ]
    times = max((size / sigma for size, sigma in pairs), default=math.nan)
    line = (
        f"{count_text(figures.n, 'pose lies', 'poses lie')} within {figures.position[0] * 1e3:.4f} "
        f"mm RMS of those wanted, {times:.2f} "
        "times the stated standard "
        "uncertainty"
    )
    known = calibration_evidence(v.calibration, v.refutations, line, (CERTIFY,))
    beyond = f"poses are {times:.3g} times the stated standard uncertainty from those wanted"
    if times > FAR:
        return replace(known, refuted=(beyond, *known.refuted), held_out=None)
    return replace(known, missing=(*known.missing, *([MissingEvidence(beyond, CHANGED)] if times > AGREES else [])))


def _wanted_poses_html(frames: Integers, figures: Figures, stated: tuple[float, float], errors: Floats) -> str:
    rows = [
        ("position", *(f"{value * 1e3:.4f} mm" for value in (*figures.position, stated[0]))),
        ("rotation", *(f"{value * 1e3:.4f} mrad" for value in (*figures.rotation, stated[1]))),
    ]
    seen = [
        (part, label)
        for part, label in ((slice(0, 3), "off, mm"), (slice(3, 6), "off, mrad"))
        if np.isfinite(errors[:, part]).all()
    ]
    drawn = (
        plot_panel_svg(label, ("frame", label), [Series(frames, np.linalg.norm(errors[:, part], axis=1) * 1e3)])
        for part, label in seen
    )
    return table_html(
        ("deviation from wanted", "RMS", "95 %", "max", "stated uncertainty"), rows[: len(seen)]
    ) + figures_with_caption_html(
        figures_side_by_side_html(*drawn),
        "Deviation of each measured pose from the wanted one, position in mm and rotation in mrad. Good: all within "
        "the stated uncertainty of the table. Bad: single high dots, or a trend over the frames.",
    )


def _figures(held: HeldOut) -> str:
    rows = [
        (name, *(f"{value * 1e3:.4f}" if value == value else "-" for value in (*f.position, *f.rotation)))
        for name, f in (("nominal model", held.before), ("corrected", held.after))
    ]
    return table_html(("pose error", "RMS, mm", "95 %, mm", "max, mm", "RMS, mrad", "95 %, mrad", "max, mrad"), rows)
