"""The page of a verification: a calibration held against poses that it may or may not have seen, or wanted poses against those that came."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.certify.claim import Claim
from calib.certify.held_out import Figures, HeldOut
from calib.certify.verdict import kept, verified
from calib.pose_figures import before_after, coverage
from calib.samples import Samples
from calib.scene import stage
from rig.design import Design
from rig.page.document import Link, Page, State, Verdict, write
from rig.page.figure import Series, panel, panels
from rig.page.parts import heading, paragraph, table
from rig.page.stage import scripts, view
from rig.pose import vector

FINE, FAR = 1.5, 3.0  # times the stated uncertainty: up to the first an error is as it should be, beyond the second it is not


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """samples; before, after : (n, 6) errors by the owner's model and corrected, m and rad; held : their figures; claim : of the calibration, or None
    same : numbers of frames that it was made from; driven : where poses were wanted, (figures of the errors, stated uncertainty (m, rad),
    errors (n, 6)), else None; unsolved : {frame number: why it has no pose}"""

    design: Design
    samples: Samples
    before: np.ndarray
    after: np.ndarray
    held: HeldOut
    claim: Claim | None
    same: Sequence[int]
    driven: tuple[Figures, tuple[float, float], np.ndarray] | None
    unsolved: dict[int, str]


def verified_page(path: Path | str, name: str, v: Verified, links: Sequence[Link] = ()) -> None:
    """Write the page. name : of the recording"""
    floor = f"The measured poses themselves are uncertain by {v.held.floor[0] * 1e3:.4f} mm and {v.held.floor[1] * 1e3:.4f} mrad."
    errors = {"owner's model": -v.before, "corrected": -v.after}
    parts = [paragraph(floor)] if np.isfinite(v.held.floor).all() else []
    if v.driven is not None:
        parts += [heading("Wanted poses against measured ones"), _driven(v.samples.frame, *v.driven)]
    parts += [heading("Before and after, pose by pose"), before_after(v.before, v.after, v.samples.frame), _figures(v.held),
              heading("In three dimensions"), *view(stage(v.design, v.samples.frame, v.samples.T_base_platform, v.samples.commanded, errors)),
              heading("Where it went"), coverage(vector(v.samples.T_base_platform))]
    if v.unsolved:
        parts += [heading("Frames without a pose"), table(("frame", "reason"), sorted(v.unsolved.items()))]
    write(path, Page("verify", f"Verification by {name}", judged(v), parts, to_do(v), links, scripts(parts)))


def judged(v: Verified) -> Verdict:
    """The verdict on a verification."""
    if v.driven is not None:
        figures, stated, _ = v.driven
        times = figures.position[0] / stated[0]
        state = State.GOOD if times <= FINE else State.CHECK if times <= FAR else State.BAD
        return Verdict(state, f"{figures.n} poses came within {figures.position[0] * 1e3:.4f} mm RMS of those wanted, {times:.2f} times the stated "
                              "standard uncertainty")
    if v.same:
        return Verdict(State.CHECK, f"no verdict: the calibration was made from {len(v.same)} of these frames")
    line = verified(v.held, v.claim)
    if v.claim is None or v.claim.after is None:
        return Verdict(State.GOOD if v.held.ratio[1] > 1 else State.BAD if v.held.ratio[2] < 1 else State.CHECK, line)
    return Verdict(State.GOOD if kept(v.held, v.claim) else State.BAD, line)


def to_do(v: Verified) -> list[str]:
    """What an owner does next with a verification."""
    state = judged(v).state
    if v.same and v.driven is None:
        return ["Take a recording that the calibration has not seen, and verify by that"]
    if state == State.BAD:
        return ["Ask what changed: `rig watch calibration.json REC`", "Ask what physics is left out: `rig diagnose REC --out found`"]
    return ["State what is kept, with what confidence: `rig certify calibration.json REC --out certificate.html`"]


def _driven(frames: np.ndarray, figures: Figures, stated: tuple[float, float], errors: np.ndarray) -> str:
    rows = [("position", *(f"{value * 1e3:.4f} mm" for value in (*figures.position, stated[0]))),
            ("rotation", *(f"{value * 1e3:.4f} mrad" for value in (*figures.rotation, stated[1])))]
    seen = [(part, label) for part, label in ((slice(0, 3), "off, mm"), (slice(3, 6), "off, mrad")) if np.isfinite(errors[:, part]).all()]
    drawn = (panel(label, ("frame", label), [Series(frames, np.linalg.norm(errors[:, part], axis=1) * 1e3)]) for part, label in seen)
    return table(("off the wanted pose", "RMS", "95 %", "max", "stated uncertainty"), rows[: len(seen)]) + panels(*drawn)


def _figures(held: HeldOut) -> str:
    rows = [(name, *(f"{value * 1e3:.4f}" if value == value else "-" for value in (*f.position, *f.rotation)))
            for name, f in (("owner's model", held.before), ("corrected", held.after))]
    return table(("pose error", "RMS, mm", "95 %, mm", "max, mm", "RMS, mrad", "95 %, mrad", "max, mrad"), rows)
