"""Folder of an investigation, and its report.

Plans, recordings and diagnoses of each round; the report is a notebook and an HTML page.

The folder holds, for look n: planN.csv (what was to be done), recN (what was recorded), diagnosisN (what all recordings
so far say, and in its next.json what would tell more). Nothing else is kept, so whatever was interrupted goes on from
what is there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.diagnosis.report.diagnosis_json_entries import SCHEMA, UNKNOWN
from rig.formats import csv_and_parquet_tables_and_time_origin, json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import Entries
from rig.report.pages.html_and_svg_elements import (
    figures_with_caption_html,
    heading_html,
    list_html,
    paragraph_html,
    table_html,
)
from rig.report.pages.page_templates_and_index_page import Page, write_page
from rig.report.pages.svg_plots import COLOURS, Series, plot_panel_svg
from rig.report.verdict_refutations_and_result_display import (
    LOOK,
    Evidence,
    MissingEvidence,
    State,
    Verdict,
    judge_evidence,
)

SETTING_UP = 1.0  # min that a recording takes besides its plan


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """title; odds : share, 0..1."""

    title: str
    odds: float


@dataclass(frozen=True, slots=True)
class ProposedExperiment:
    """An experiment that was foretold. plan : its text; minutes; bits : expected; settles : chance that it settles all;
    asks : of an operator.
    """

    plan: str
    exposures: int
    minutes: float
    bits: float
    settles: float
    asks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class InvestigationRound:
    """What all recordings up to number `number` (from 1) say. recording : the last one's name; minutes : that it took
    findings : names with their places; alone : those of them that nothing else explains as well; unknown : what has no
        name, in words
    questions : of each finding that is not alone its hypotheses, the likeliest first; unasked : what cannot be
        foretold, in words
    proposed : experiments, the best first; doubts : what its diagnosis' verdict rests on, where that is not good, a
        sentence each
    """

    number: int
    recording: str
    minutes: float
    findings: tuple[str, ...]
    alone: tuple[str, ...]
    unknown: tuple[str, ...]
    questions: tuple[tuple[Hypothesis, ...], ...]
    unasked: tuple[str, ...]
    proposed: tuple[ProposedExperiment, ...]
    doubts: tuple[str, ...] = ()

    @property
    def odds(self) -> dict[str, float]:
        """{title: share} of everything that is still thought of; 1 for a name that is alone."""
        out = dict.fromkeys(self.alone, 1.0)
        for question in self.questions:
            out |= {h.title: max(h.odds, out.get(h.title, 0.0)) for h in question}
        return out


def plan_path(folder: Path, round_number: int) -> Path:
    """Path of a round's plan in an investigation's folder."""
    return folder / f"plan{round_number}.csv"


def recording_path(folder: Path, round_number: int) -> Path:
    """Path of a round's recording in an investigation's folder."""
    return folder / f"rec{round_number}"


def diagnosis_path(folder: Path, round_number: int) -> Path:
    """Path of a round's diagnosis in an investigation's folder."""
    return folder / f"diagnosis{round_number}"


def minutes_of_plan_file_with_setting_up(plan: Path) -> float:
    """Minutes that a plan takes, setting up included.

    Raises FileError for what is no table in time.
    """
    t = csv_and_parquet_tables_and_time_origin.read_csv_table(plan, ("frame", "t")).numbers("t")
    return float(t.max() - t.min()) / 60 + SETTING_UP


def read_investigation_rounds(folder: Path) -> list[InvestigationRound]:
    """Investigation rounds (recording and diagnosis each) read from an investigation's folder, in order."""
    out: list[InvestigationRound] = []
    while (diagnosis_path(folder, len(out) + 1) / "next.json").exists():
        out.append(_look(folder, len(out) + 1))
    return out


def _look(folder: Path, number: int) -> InvestigationRound:
    at = diagnosis_path(folder, number)
    found, after = (
        json_toml_and_yaml_loading.load_json(at / "diagnosis.json", "diagnosis", SCHEMA),
        json_toml_and_yaml_loading.load_json(at / "next.json", "list of experiments", "next/1"),
    )
    findings = [f for f in found.tables("findings") if f.text("effect") != UNKNOWN]
    unknown = [f for f in found.tables("findings") if f.text("effect") == UNKNOWN]
    questions = tuple(
        tuple(
            sorted(
                (Hypothesis(h.text("title"), h.number("odds")) for h in q.tables("hypotheses")), key=lambda h: -h.odds
            )
        )
        for q in after.tables("questions")
    )
    doubtful = {q.text("finding") for q in after.tables("questions")}
    proposed = tuple(
        ProposedExperiment(
            e.text("plan"),
            e.whole("exposures", 1),
            e.number("minutes"),
            e.number("bits"),
            e.number("settles"),
            e.texts("asks"),
        )
        for e in after.tables("experiments")
    )
    unasked = tuple(text for q in after.tables("questions") for text in q.texts("unasked"))
    verdict = found.table("verdict")
    doubts = () if verdict.text("state") == State.GOOD else verdict.texts("rests_on")
    return InvestigationRound(
        number,
        recording_path(folder, number).name,
        minutes_of_plan_file_with_setting_up(plan_path(folder, number)),
        tuple(map(_title, findings)),
        tuple(title for title in map(_title, findings) if title not in doubtful),
        tuple(f"something at {f.text('place')}" + _of(f) for f in unknown),
        questions,
        unasked,
        proposed,
        doubts,
    )


def _title(finding: Entries) -> str:
    return f"{finding.text('effect').replace('_', ' ')} at {finding.text('place')}"


def _of(finding: Entries) -> str:
    """On what something without a name depends, in words."""
    names = finding.table("parameters").table("depends_on").texts("value")
    return f", correlated with {' and '.join(names)}" if names else ""


def investigation_notebook_markdown(
    rig: str, rounds: Sequence[InvestigationRound], budget: float, end_reason: str, final_action: Sequence[str]
) -> str:
    """Laboratory notebook of an investigation, as Markdown.

    rig : its name; budget : min
    """
    out = [
        f"# Investigation of {rig}",
        "",
        f"A budget of {budget:.0f} min of the rig's time; "
        f"{recording_minutes_spent(rounds):.1f} min have been used so far.",
        "",
    ]
    for before, look in zip((None, *rounds), rounds):
        out += [*_tried(before, look), *_seen(before, look), ""]
    if end_reason:
        out += ["## The end", "", f"{end_reason[0].upper()}{end_reason[1:]}.", ""]
    return "\n".join(out + [f"- {line}" for line in final_action]).rstrip() + "\n"


def recording_minutes_spent(rounds: Sequence[InvestigationRound]) -> float:
    """Minutes spent on the recordings of all rounds so far."""
    return sum(look.minutes for look in rounds)


def _next_experiment(look: InvestigationRound) -> ProposedExperiment | None:
    """The experiment that follows a look, None where none would tell."""
    return look.proposed[0] if look.proposed else None


def _tried(before: InvestigationRound | None, look: InvestigationRound) -> list[str]:
    out = [f"## {look.number}. {look.recording}, {look.minutes:.1f} min", ""]
    experiment = _next_experiment(before) if before is not None else None
    if experiment is None:
        return [*out, "Tried: the initial plan, without a hypothesis.", ""]
    out += [
        f"Tried: {experiment.plan}, {experiment.exposures} exposures; expected to settle the question with a "
        f"chance of {experiment.settles:.0%} "
        f"and to yield {experiment.bits:.2f} bits.",
        "",
    ]
    return out + [f"- request to the operator: {text}" for text in experiment.asks] + ([""] if experiment.asks else [])


def _seen(before: InvestigationRound | None, look: InvestigationRound) -> list[str]:
    out = [f"- alone: {title}" for title in look.alone]
    for question in look.questions:
        out.append("- ambiguous: " + "; ".join(f"{h.title} {h.odds:.2f}" for h in question))
    out += [f"- cannot be predicted: {text}" for text in look.unasked]
    out += [f"- {text}, in no catalogue" for text in look.unknown]
    if not out:
        out = ["- nothing is unmodelled: recordings and model agree within the noise"]
    if before is not None:
        dropped = [title for title, odds in before.odds.items() if title not in look.odds and odds > 0]
        out += [
            f"- dropped: {title} (odds before {before.odds[title]:.2f}); with {look.recording} it explains "
            "less than 1 in 20 of the residual, "
            "or nothing"
            for title in dropped
        ]
        out += [f"- settled: {'no' if look.questions else 'yes'}"] if before.questions else []
    return ["Result from all recordings combined:", "", *out]


def write_investigation_page(
    path: Path,
    rig: str,
    rounds: Sequence[InvestigationRound],
    budget: float,
    end_reason: str,
    final_action: Sequence[str],
) -> None:
    """Write an investigation's HTML page.

    rig, budget, end_reason, final_action : as of `investigation_notebook_markdown`
    """
    parts = [
        heading_html("Odds"),
        figures_with_caption_html(
            _odds_figure(rounds),
            "Odds of the hypotheses considered after each recording, from all recordings so far; a hypothesis with no "
            "equally good alternative is at 1, one that was excluded at 0. Good: one line ends at 1. Bad: lines that "
            "stay between.",
        ),
        heading_html("Experiments"),
        paragraph_html(f"{recording_minutes_spent(rounds):.1f} of {budget:.0f} min of the rig's time."),
        table_html(
            ("recording", "plan", "exposures", "min", "predicted chance to settle", "settled"),
            [_row(before, look) for before, look in zip((None, *rounds), rounds)],
        ),
    ]
    if final_action:
        parts += [heading_html("And then"), list_html(final_action)]
    verdict = investigation_verdict(rounds, end_reason)
    write_page(path, Page("investigate", f"Investigation of {rig}", verdict, parts, verdict.next))


def investigation_verdict(rounds: Sequence[InvestigationRound], end_reason: str) -> Verdict:
    """Verdict of an investigation.

    Good where nothing is unmodelled, to be examined otherwise.
    """
    last = rounds[-1]
    named = ", ".join(last.findings) or "; ".join(last.unknown) or "nothing is unmodelled"
    left = list(last.doubts) or [
        *(f"the geometry alone omits {name}" for name in last.findings),
        *(f"no catalogued effect explains {text}" for text in last.unknown),
    ]
    missing = [
        *([] if end_reason else [MissingEvidence("it goes on")]),
        *([MissingEvidence("the explanation is ambiguous")] if last.questions else []),
    ]
    steps = _recommended_actions(rounds, end_reason)
    return judge_evidence(
        Evidence(
            f"{named}: {end_reason or 'it goes on'}",
            tuple(steps),
            unexplained=tuple(left),
            missing=tuple(missing),
            look=steps[0] if steps else LOOK,
        )
    )


def _recommended_actions(looks: Sequence[InvestigationRound], ended: str) -> list[str]:
    """What an owner does next."""
    if not ended:
        return ["Continue with the same command and `--resume`"]
    if looks[-1].unasked:
        return [f"Make it testable: {text}" for text in looks[-1].unasked]
    if looks[-1].questions:
        return [
            'Allow more: a longer `--budget`, or `[experiment] may = ["payload", "wait", "turn cube NAME"]` '
            "in rig.toml; then repeat with "
            "`--resume`"
        ]
    return (
        [f"See the actions listed for each finding: `diagnosis{looks[-1].number}/diagnosis.html`"]
        if looks[-1].findings
        else []
    )


def _row(before: InvestigationRound | None, look: InvestigationRound) -> tuple[str, ...]:
    experiment = _next_experiment(before) if before is not None else None
    if experiment is None:
        return look.recording, "the first plan", "", f"{look.minutes:.1f}", "", ""
    return (
        look.recording,
        experiment.plan,
        str(experiment.exposures),
        f"{look.minutes:.1f}",
        f"{experiment.settles:.0%}",
        "no" if look.questions else "yes",
    )


def _odds_figure(looks: Sequence[InvestigationRound]) -> str:
    """Figure of the odds (0 to 1) of each hypothesis after each look."""
    titles = list(dict.fromkeys(title for look in looks for title in look.odds))
    at = np.array([float(look.number) for look in looks])
    series = []
    for n, title in enumerate(titles):
        odds = np.array([look.odds.get(title, 0.0) for look in looks])
        series += [Series(at, odds, title, "line", n % COLOURS), Series(at, odds, "", "dots", n % COLOURS)]
    if not series:
        return paragraph_html("No hypothesis was considered: recordings and model agree within the noise.")
    return plot_panel_svg("odds of each hypothesis", ("recording", "share"), series, limits=(0.0, 1.0))
