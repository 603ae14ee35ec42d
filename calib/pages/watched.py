"""The page of visits: whether a calibration still holds, since when it does not, and what may have changed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.drift.evidence import ALARM, Verdict as Evidence
from rig.judgement import State, Verdict
from rig.page.document import Link, Page, write
from rig.page.figure import Series, bars, panel, panels
from rig.page.parts import heading, note, paragraph

SHOWN = 8  # suspects


@dataclass(frozen=True, slots=True, eq=False)
class Visit:
    """A visit of a name, what it says and that in lines; scale : of what measuring repeats to"""

    name: str
    evidence: Evidence
    lines: Sequence[str]
    scale: float


def watched_page(path: Path | str, calibration: str, visits: Sequence[Visit], links: Sequence[Link] = ()) -> None:
    """Write the page of visits, one at least, held against a calibration of a name."""
    n = np.arange(1, len(visits) + 1)
    agree = np.array([np.sqrt(v.evidence.square / v.evidence.count / v.scale) for v in visits])
    later = np.array([np.exp(min(v.evidence.log_sum, 600.0)) if v.evidence.chance is None else np.nan for v in visits])
    drawn = [panel("agreement", ("visit", "of what measuring repeats to"), [Series(n, agree)], level=1.0)]
    if np.isfinite(later).any():
        drawn.append(panel("evidence of a change", ("visit", "sum of likelihood ratios"), [Series(n, later)], log=True, level=ALARM))
    last = visits[-1].evidence
    parts = [heading("Visit by visit"), note(f"The alarm is at a sum of {ALARM:g}, which quiet visits reach once in {ALARM:g} visits or more."),
             panels(*drawn)]
    if last.alarm:
        shown = last.suspects[:SHOWN]
        parts += [heading("What may have changed"), bars("odds, were there a change", [one.name for one in shown],
                                                        [("odds", [one.odds for one in shown], 3)], "")]
    parts += [heading("In words"), *(paragraph(line.strip()) for visit in visits for line in visit.lines)]
    steps = [line.strip().removeprefix("to do: ") for line in visits[-1].lines if line.strip().startswith("to do: ")]
    steps = steps or ["Nothing; visit again after the next warm-up, collision or service"]
    write(path, Page("watch", f"Visits to {calibration}", judged(visits), parts, steps, links))


def judged(visits: Sequence[Visit]) -> Verdict:
    """The verdict of the last visit."""
    last = visits[-1]
    if not last.evidence.alarm:
        return Verdict(State.GOOD, f"the calibration holds at visit {len(visits)}, {last.name}")
    named = last.evidence.named
    return Verdict(State.BAD, f"something changed, likeliest {named.name}" if named is not None else "something changed, and it has no name")
