"""HTML page of the visits that watch a calibration's drift, with the verdict on the last."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import refutation_sentence
from calib.certification.claim_verification import Verification
from calib.drift.machine_change_hypotheses_verdict_and_sentences import ALARM
from calib.drift.machine_change_hypotheses_verdict_and_sentences import Verdict as Changes
from rig.report.pages.html_and_svg_elements import figures_with_caption_html, heading_html, paragraph_html
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import Series, bar_chart_svg, figures_side_by_side_html, plot_panel_svg
from rig.report.verdict_refutations_and_result_display import Evidence, Verdict, judge_evidence

SHOWN = 8  # suspects


@dataclass(frozen=True, slots=True, eq=False)
class Visit:
    """A visit of a name, what it says and that in lines; scale : of the measurement repeatability
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
    """Write the HTML page of visits.

    They are one at least, compared with a calibration.
    """
    n = np.arange(1, len(visits) + 1)
    agree = np.array([np.sqrt(v.evidence.square / v.evidence.count / v.scale) for v in visits])
    later = np.array([np.exp(min(v.evidence.log_sum, 600.0)) if v.evidence.chance is None else np.nan for v in visits])
    drawn = [plot_panel_svg("agreement", ("visit", "of the measurement repeatability"), [Series(n, agree)], level=1.0)]
    if np.isfinite(later).any():
        drawn.append(
            plot_panel_svg(
                "evidence of a change", ("visit", "sum of likelihood ratios"), [Series(n, later)], log=True, level=ALARM
            )
        )
    last = visits[-1].evidence
    parts = [
        heading_html("Visit by visit"),
        figures_with_caption_html(
            figures_side_by_side_html(*drawn),
            "Agreement: deviation of each visit from the calibration over the measurement repeatability, which is 1. "
            f"Evidence: the alarm is at a sum of {ALARM:g}, which unchanged visits reach once in {ALARM:g} visits or "
            "more. Good: dots near 1, the sum low. Bad: a rise that stays.",
        ),
    ]
    if last.alarm:
        shown = last.suspects[:SHOWN]
        parts += [
            heading_html("Possible changes"),
            figures_with_caption_html(
                bar_chart_svg(
                    "odds, were there a change",
                    [one.name for one in shown],
                    [("odds", [one.odds for one in shown], 3)],
                    "",
                ),
                "Odds (0 to 1) that a part is the one that changed, the likeliest first. Good: one long bar. Bad: "
                "bars of like length; another visit has to separate them.",
            ),
        ]
    parts += [heading_html("In words"), *(paragraph_html(line.strip()) for visit in visits for line in visit.lines)]
    write_page(path, Page("watch", f"Visits to {calibration}", verdict, parts, verdict.next, links))


def last_visit_verdict(visits: Sequence[Visit], calibration_evidence: Evidence) -> Verdict:
    """Verdict of the last visit.
    calibration_evidence : Evidence of the calibration
    """
    last, steps = visits[-1], _recommended_actions(visits)
    if not last.evidence.alarm:
        return judge_evidence(
            replace(
                calibration_evidence,
                statement=f"the calibration is valid at visit {len(visits)}, {last.name}",
                steps=tuple(steps),
            )
        )
    statement = f"visit {len(visits)}, {last.name}"
    if last.allowed:
        return judge_evidence(
            replace(
                calibration_evidence,
                statement=statement,
                steps=(),
                unexplained=(sentence_on_effect_omitted_by_calibration(last), *calibration_evidence.unexplained),
                look=steps[0],
            )
        )
    beyond = () if last.found is None else (refutation_sentence(last.found),)
    return judge_evidence(
        replace(
            calibration_evidence,
            statement=statement,
            refuted=(change_alarm_sentence(last.evidence), *beyond, *calibration_evidence.refuted),
            look=steps[0],
        )
    )


def change_alarm_sentence(changes: Changes) -> str:
    """Sentence on a change alarm."""
    named = changes.named
    return (
        f"something changed, likeliest {named.name}" if named is not None else "something changed, and it has no name"
    )


def sentence_on_effect_omitted_by_calibration(visit: Visit) -> str:
    """Sentence on an effect that the calibration omits.

    A first visit shows it.
    Its claim not refuted by it.
    """
    named = visit.evidence.named
    like = "" if named is None else f", likeliest {named.name}"
    return f"the calibration omits an effect{like}, present from the beginning or since; its claim is not refuted by it"


def _recommended_actions(visits: Sequence[Visit]) -> list[str]:
    """What an owner does next."""
    steps = [line.strip().removeprefix("to do: ") for line in visits[-1].lines if line.strip().startswith("to do: ")]
    return steps or ["Nothing; visit again after the next warm-up, collision or service"]
