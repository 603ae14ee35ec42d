"""The page of visits: whether a calibration still holds, since when it does not, and what may have changed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.certify.calibration_verdict import refutation_sentence
from calib.certify.claim_verification import Verification
from calib.drift.change_evidence import ALARM
from calib.drift.change_evidence import Verdict as Changes
from rig.report.pages.html_elements import heading, note, paragraph
from rig.report.pages.page_template import Link, Page, write_page
from rig.report.pages.plots import Series, bar_chart, panel_row, plot_panel
from rig.report.verdict import Evidence, Verdict, judge_evidence

SHOWN = 8  # suspects


@dataclass(frozen=True, slots=True, eq=False)
class Visit:
    """A visit of a name, what it says and that in lines; scale : of what measuring repeats to
    found : Verification of the calibration's claim by a first visit that disagrees with it, None of other visits"""

    name: str
    evidence: Changes
    lines: Sequence[str]
    scale: float
    found: Verification | None = None

    @property
    def allowed(self) -> bool:
        """Whether what a first visit disagrees by is within the claim, so that it may have been there when the
        calibration was made.
        """
        return self.found is not None and bool(self.found.parts) and not self.found.refutes


def write_visits_page(
    path: Path | str, calibration: str, visits: Sequence[Visit], verdict: Verdict, links: Sequence[Link] = ()
) -> None:
    """Write the page of visits, one at least, held against a calibration of a name, with its Verdict."""
    n = np.arange(1, len(visits) + 1)
    agree = np.array([np.sqrt(v.evidence.square / v.evidence.count / v.scale) for v in visits])
    later = np.array([np.exp(min(v.evidence.log_sum, 600.0)) if v.evidence.chance is None else np.nan for v in visits])
    drawn = [plot_panel("agreement", ("visit", "of what measuring repeats to"), [Series(n, agree)], level=1.0)]
    if np.isfinite(later).any():
        drawn.append(
            plot_panel(
                "evidence of a change", ("visit", "sum of likelihood ratios"), [Series(n, later)], log=True, level=ALARM
            )
        )
    last = visits[-1].evidence
    parts = [
        heading("Visit by visit"),
        note(f"The alarm is at a sum of {ALARM:g}, which quiet visits reach once in {ALARM:g} visits or more."),
        panel_row(*drawn),
    ]
    if last.alarm:
        shown = last.suspects[:SHOWN]
        parts += [
            heading("What may have changed"),
            bar_chart(
                "odds, were there a change", [one.name for one in shown], [("odds", [one.odds for one in shown], 3)], ""
            ),
        ]
    parts += [heading("In words"), *(paragraph(line.strip()) for visit in visits for line in visit.lines)]
    write_page(path, Page("watch", f"Visits to {calibration}", verdict, parts, verdict.next, links))


def last_visit_verdict(visits: Sequence[Visit], known: Evidence) -> Verdict:
    """The verdict of the last visit. known : Evidence of the calibration"""
    last, steps = visits[-1], recommended_actions(visits)
    if not last.evidence.alarm:
        return judge_evidence(
            replace(known, statement=f"the calibration holds at visit {len(visits)}, {last.name}", steps=tuple(steps))
        )
    statement = f"visit {len(visits)}, {last.name}"
    if last.allowed:
        return judge_evidence(
            replace(
                known,
                statement=statement,
                steps=(),
                unexplained=(first_visit_sentence(last), *known.unexplained),
                look=steps[0],
            )
        )
    beyond = () if last.found is None else (refutation_sentence(last.found),)
    return judge_evidence(
        replace(
            known, statement=statement, refuted=(alarm_sentence(last.evidence), *beyond, *known.refuted), look=steps[0]
        )
    )


def alarm_sentence(found: Changes) -> str:
    """What an alarm says, a sentence."""
    named = found.named
    return (
        f"something changed, likeliest {named.name}" if named is not None else "something changed, and it has no name"
    )


def first_visit_sentence(visit: Visit) -> str:
    """What a first visit says of a calibration whose claim it keeps, a sentence."""
    named = visit.evidence.named
    like = "" if named is None else f", likeliest {named.name}"
    return (
        f"the calibration leaves something out{like}, there from the beginning or since; its claim is not refuted by it"
    )


def recommended_actions(visits: Sequence[Visit]) -> list[str]:
    """What an owner does next."""
    steps = [line.strip().removeprefix("to do: ") for line in visits[-1].lines if line.strip().startswith("to do: ")]
    return steps or ["Nothing; visit again after the next warm-up, collision or service"]
