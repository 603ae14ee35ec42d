"""The page of learning on-line: how far each pose was off what was expected, what jumped, how well the geometry is
known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.certify.calibration_evidence import ALONE, OfCalibrations, confound_sentences
from calib.samples.confounded_conditions import Confounds
from rig.report.pages.html_elements import heading, list_html, note, paragraph
from rig.report.pages.page_template import Link, Page, write_page
from rig.report.pages.plots import Series, plot_panel
from rig.report.verdict import AGREES, Evidence, Missing, Verdict, judge_evidence

MANY = 6  # changes beyond which they are not believed to be steps
ASK = "Determine what acts on the struts or the measurement: `rig diagnose REC --out found`"


@dataclass(frozen=True, slots=True, eq=False)
class OnlineResult:
    """What poses taught. frames : (n,) their numbers; innovations : (n, 6) whitened, N(0, I) where nothing is wrong;
    source : of the poses
    said : a line for each change; dropped : numbers of frames left out; known : m RMS of joints and zeros, or None;
        moved : m RMS from rig.toml
    returning : struts that go back and forth, a sentence each; confounds : of the recording, or None
    calibrations : OfCalibrations made from it: what they leave out, these poses teach no better"""

    frames: np.ndarray
    innovations: np.ndarray
    source: str
    said: Sequence[str]
    dropped: Sequence[int]
    known: float | None
    moved: float
    returning: Sequence[str] = ()
    confounds: Confounds | None = None
    calibrations: OfCalibrations = ALONE


def write_online_page(path: Path | str, name: str, learnt: OnlineResult, links: Sequence[Link] = ()) -> None:
    """Write the page of what a recording of a name taught."""
    sizes = np.sqrt((learnt.innovations**2).mean(axis=1))
    parts = [
        paragraph(
            f"{len(learnt.frames)} poses from {learnt.source}, learnt one at a time. Joints and zeros moved by "
            f"{learnt.moved * 1e3:.4f} mm RMS from rig.toml."
        )
    ]
    if learnt.said:
        parts += [heading("What jumped"), list_html(learnt.said)]
    parts += [
        heading("How well each pose was expected"),
        note(
            "Off what the poses before it let expect, in standard deviations, RMS over the six axes: 1 where "
            "nothing is left to learn."
        ),
        plot_panel("innovation", ("frame", "standard deviations"), [Series(learnt.frames, sizes)], log=True, level=1.0),
    ]
    if learnt.dropped:
        parts += [
            heading("Left out"),
            paragraph(f"Frames {', '.join(map(str, learnt.dropped))}: their poses agree with no other."),
        ]
    verdict = online_verdict(learnt)
    write_page(path, Page("online", f"Learning from {name}", verdict, parts, verdict.next, links))


def online_verdict(learnt: OnlineResult) -> Verdict:
    """The verdict on what was learnt."""
    last = learnt.innovations[-max(len(learnt.innovations) // 4, 1) :]
    off = float(np.sqrt(np.mean(last**2)))
    known = "" if learnt.known is None else f"; joints and zeros are known to {learnt.known * 1e3:.4f} mm RMS"
    changes = f"{len(learnt.said)} change{'s' * (len(learnt.said) != 1)}" if learnt.said else "nothing jumped"
    why = f"{changes}, the last poses off what was expected by {off:.2f} standard deviations{known}"
    unexplained = [*learnt.returning, *learnt.calibrations.unexplained]
    if len(learnt.said) > MANY:
        unexplained.append("these are no few steps, something acts that the geometry lacks")
    if off > AGREES:
        unexplained.append(f"the last poses are {off:.3g} times as far off as expected")
    missing = [Missing("something jumped", recommended_actions(learnt)[0])] if learnt.said else []
    missing += [Missing("poses were left out")] if learnt.dropped else []
    return judge_evidence(
        Evidence(
            why,
            tuple(recommended_actions(learnt)),
            unexplained=tuple(unexplained),
            confounds=confound_sentences(learnt.confounds),
            missing=tuple(missing),
            refuted=learnt.calibrations.refuted,
            look=ASK,
        )
    )


def recommended_actions(learnt: OnlineResult) -> list[str]:
    """What an owner does next with what was learnt."""
    if len(learnt.said) > MANY or learnt.returning:
        return [ASK]
    if learnt.said:
        return [
            "Look at the struts named below for missed steps or a slipped joint, at cameras and base for a "
            "knock; home, and record again"
        ]
    return ["Go on with the next recording and the same `--state`"]
