"""The page of a verification: a calibration held against poses that it may or may not have seen, or wanted poses
against those that came.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.certify.calibration import Calibration
from calib.certify.calibration_evidence import calibration_evidence, evidence_with_verification, with_design
from calib.certify.calibration_verdict import verification_line
from calib.certify.claim_verification import Verification
from calib.certify.held_out_errors import Figures, HeldOut
from calib.report.pose_figures import correction_error_figures, pose_coverage_figures
from calib.report.scene_3d import rig_stage
from calib.samples.confounded_conditions import Confounds
from calib.samples.pose_samples import Samples
from rig.model.design import Design
from rig.model.pose import pose_to_vector
from rig.report.pages.html_elements import heading, paragraph, table
from rig.report.pages.page_template import Link, Page, write_page
from rig.report.pages.plots import Series, panel_row, plot_panel
from rig.report.pages.view_3d import view_3d_html, view_scripts
from rig.report.refutations import Refutation
from rig.report.verdict import AGREES, Evidence, Missing, Verdict, judge_evidence

FAR = 3.0  # times the stated uncertainty, which errors that all poses share may reach by chance: beyond it is refuted
ANOTHER = (
    "Take a recording that the calibration has not seen, and verify by that: `rig verify calibration.json OTHER-REC`"
)
CHANGED = "Determine what changed: `rig watch calibration.json REC`; what is left out: `rig diagnose REC --out found`"
CERTIFY = "State what is promised, with what confidence: `rig certify calibration.json REC --out certificate.html`"


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """samples; before, after : (n, 6) errors by the owner's model and corrected, m and rad; held : their figures
    found : Verification of the claim, or None; calibration, refutations : Calibration, and what later recordings found
        against it
    same : numbers of frames that it was made from; driven : where poses were wanted, (figures of the errors, stated
    uncertainty (m, rad), errors (n, 6)), else None; unsolved : {frame number: why it has no pose}
    confounds : of the recording, None where it states no conditions"""

    design: Design
    samples: Samples
    before: np.ndarray
    after: np.ndarray
    held: HeldOut
    found: Verification | None
    calibration: Calibration
    refutations: Sequence[Refutation]
    same: Sequence[int]
    driven: tuple[Figures, tuple[float, float], np.ndarray] | None
    unsolved: dict[int, str]
    confounds: Confounds | None = None


def write_verification_page(path: Path | str, name: str, v: Verified, links: Sequence[Link] = ()) -> None:
    """Write the page. name : of the recording"""
    floor = (
        f"The measured poses themselves are uncertain by {v.held.floor[0] * 1e3:.4f} mm and "
        f"{v.held.floor[1] * 1e3:.4f} mrad."
    )
    errors = {"owner's model": -v.before, "corrected": -v.after}
    parts = [paragraph(floor)] if np.isfinite(v.held.floor).all() else []
    if v.driven is not None:
        parts += [heading("Wanted poses against measured ones"), _driven(v.samples.frame, *v.driven)]
    parts += [
        heading("Before and after, pose by pose"),
        correction_error_figures(v.before, v.after, v.samples.frame),
        _figures(v.held),
        heading("In three dimensions"),
        *view_3d_html(rig_stage(v.design, v.samples.frame, v.samples.T_base_platform, v.samples.commanded, errors)),
        heading("Where it went"),
        pose_coverage_figures(pose_to_vector(v.samples.T_base_platform)),
    ]
    if v.unsolved:
        parts += [heading("Frames without a pose"), table(("frame", "reason"), sorted(v.unsolved.items()))]
    verdict = verification_verdict(v)
    write_page(
        path, Page("verify", f"Verification by {name}", verdict, parts, verdict.next, links, view_scripts(parts))
    )


def verification_verdict(v: Verified) -> Verdict:
    """The verdict on a verification."""
    if v.driven is not None:
        return judge_evidence(_of_driven(v))
    if v.same:
        return judge_evidence(
            Evidence(
                "no verdict",
                missing=(Missing(f"the calibration was made from {len(v.same)} of these frames", ANOTHER),),
            )
        )
    known = calibration_evidence(
        v.calibration, v.refutations, verification_line(v.held, v.calibration.claim, v.found), (CERTIFY,)
    )
    known = with_design(known, v.calibration, (v.confounds,), "this recording")
    return judge_evidence(evidence_with_verification(known, v.found, look=CHANGED))


def refutes_claim(v: Verified) -> bool:
    """Whether these poses, which nothing was fitted to, refute the calibration's claim."""
    return v.driven is None and not v.same and v.found is not None and v.found.refutes


def _of_driven(v: Verified) -> Evidence:
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
        f"{figures.n} poses came within {figures.position[0] * 1e3:.4f} mm RMS of those wanted, {times:.2f} "
        "times the stated standard "
        "uncertainty"
    )
    known = calibration_evidence(v.calibration, v.refutations, line, (CERTIFY,))
    beyond = f"poses are {times:.3g} times the stated standard uncertainty off those wanted"
    if times > FAR:
        return replace(known, refuted=(beyond, *known.refuted), held_out=None)
    return replace(known, missing=(*known.missing, *([Missing(beyond, CHANGED)] if times > AGREES else [])))


def _driven(frames: np.ndarray, figures: Figures, stated: tuple[float, float], errors: np.ndarray) -> str:
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
        plot_panel(label, ("frame", label), [Series(frames, np.linalg.norm(errors[:, part], axis=1) * 1e3)])
        for part, label in seen
    )
    return table(("off the wanted pose", "RMS", "95 %", "max", "stated uncertainty"), rows[: len(seen)]) + panel_row(
        *drawn
    )


def _figures(held: HeldOut) -> str:
    rows = [
        (name, *(f"{value * 1e3:.4f}" if value == value else "-" for value in (*f.position, *f.rotation)))
        for name, f in (("owner's model", held.before), ("corrected", held.after))
    ]
    return table(("pose error", "RMS, mm", "95 %, mm", "max, mm", "RMS, mrad", "95 %, mrad", "max, mrad"), rows)
