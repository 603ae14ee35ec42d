"""Report of an investigation: a laboratory notebook in Markdown and an HTML page of the odds."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.experiment.investigation_folder import Look, Proposed
from rig.report.pages.html_elements import heading, list_html, note, paragraph, table
from rig.report.pages.page_and_svg_templates import Page, write_page
from rig.report.pages.plots import COLOURS, Series, plot_panel
from rig.report.verdict import LOOK, Evidence, Missing, Verdict, judge_evidence


def notebook_text(rig: str, looks: Sequence[Look], budget: float, end_reason: str, final_action: Sequence[str]) -> str:
    """Laboratory notebook of an investigation, as Markdown. rig : its name; budget : min"""
    out = [
        f"# What is the matter with {rig}",
        "",
        f"A budget of {budget:.0f} min of the rig's time; {minutes_spent(looks):.1f} min were taken so far.",
        "",
    ]
    for before, look in zip((None, *looks), looks):
        out += [*_tried(before, look), *_seen(before, look), ""]
    if end_reason:
        out += ["## The end", "", f"{end_reason[0].upper()}{end_reason[1:]}.", ""]
    return "\n".join(out + [f"- {line}" for line in final_action]).rstrip() + "\n"


def minutes_spent(looks: Sequence[Look]) -> float:
    """Minutes spent on all recordings so far."""
    return sum(look.minutes for look in looks)


def _next_experiment(look: Look) -> Proposed | None:
    """The experiment that follows a look, None where none would tell."""
    return look.proposed[0] if look.proposed else None


def _tried(before: Look | None, look: Look) -> list[str]:
    out = [f"## {look.number}. {look.recording}, {look.minutes:.1f} min", ""]
    experiment = _next_experiment(before) if before is not None else None
    if experiment is None:
        return [*out, "Tried: the first plan, to see what there is.", ""]
    out += [
        f"Tried: {experiment.plan}, {experiment.exposures} exposures; it was to settle the question with a "
        f"chance of {experiment.settles:.0%} "
        f"and to tell {experiment.bits:.2f} bits.",
        "",
    ]
    return out + [f"- the operator was asked, {text}" for text in experiment.asks] + ([""] if experiment.asks else [])


def _seen(before: Look | None, look: Look) -> list[str]:
    out = [f"- alone: {title}" for title in look.alone]
    for question in look.questions:
        out.append("- alike: " + "; ".join(f"{h.title} {h.odds:.2f}" for h in question))
    out += [f"- cannot be foretold: {text}" for text in look.unasked]
    out += [f"- {text}, in no catalogue" for text in look.unknown]
    if not out:
        out = ["- nothing is left out: recordings and model agree within the noise"]
    if before is not None:
        dropped = [title for title, odds in before.odds.items() if title not in look.odds and odds > 0]
        out += [
            f"- dropped: {title} (odds before {before.odds[title]:.2f}); with {look.recording} it explains "
            "less than 1 in 20 of what is left, "
            "or nothing"
            for title in dropped
        ]
        out += [f"- settled: {'no' if look.questions else 'yes'}"] if before.questions else []
    return ["Seen, of all recordings together:", "", *out]


def write_investigation_page(
    path: Path, rig: str, looks: Sequence[Look], budget: float, end_reason: str, final_action: Sequence[str]
) -> None:
    """Write an investigation's HTML page. Arguments as of `notebook_text`
    rig, budget, end_reason, final_action : as for the notebook
    """
    parts = [
        paragraph(f"{minutes_spent(looks):.1f} of {budget:.0f} min of the rig's time."),
        heading("Odds"),
        _odds_figure(looks),
        note(
            "Shares of what is thought of after each recording, of all recordings so far together; a name "
            "that nothing else explains as well "
            "stands at 1, one that was told apart at 0."
        ),
        heading("What was tried"),
        table(
            ("recording", "plan", "exposures", "min", "chance to settle, as stated", "settled"),
            [_row(before, look) for before, look in zip((None, *looks), looks)],
        ),
    ]
    if final_action:
        parts += [heading("And then"), list_html(final_action)]
    verdict = investigation_verdict(looks, end_reason)
    write_page(path, Page("investigate", f"What is the matter with {rig}", verdict, parts, verdict.next))


def investigation_verdict(looks: Sequence[Look], end_reason: str) -> Verdict:
    """Verdict of an investigation: good where nothing is left out, to be examined otherwise."""
    last = looks[-1]
    named = ", ".join(last.findings) or "; ".join(last.unknown) or "nothing is left out"
    left = list(last.doubts) or [
        *(f"the geometry alone leaves out {name}" for name in last.findings),
        *(f"nothing in the catalogue explains {text}" for text in last.unknown),
    ]
    missing = [
        *([] if end_reason else [Missing("it goes on")]),
        *([Missing("several explanations are alike")] if last.questions else []),
    ]
    steps = _recommended_actions(looks, end_reason)
    return judge_evidence(
        Evidence(
            f"{named}: {end_reason or 'it goes on'}",
            tuple(steps),
            unexplained=tuple(left),
            missing=tuple(missing),
            look=steps[0] if steps else LOOK,
        )
    )


def _recommended_actions(looks: Sequence[Look], ended: str) -> list[str]:
    """What an owner does next."""
    if not ended:
        return ["Go on with the same command and `--resume`"]
    if looks[-1].unasked:
        return [f"Make it possible to ask: {text}" for text in looks[-1].unasked]
    if looks[-1].questions:
        return [
            'Allow more: a longer `--budget`, or `[experiment] may = ["payload", "wait", "turn cube NAME"]` '
            "in rig.toml; then again with "
            "`--resume`"
        ]
    return (
        [f"Look at what each finding says to do: `diagnosis{looks[-1].number}/diagnosis.html`"]
        if looks[-1].findings
        else []
    )


def _row(before: Look | None, look: Look) -> tuple[str, ...]:
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


def _odds_figure(looks: Sequence[Look]) -> str:
    """Figure of the odds (0 to 1) of each hypothesis after each look."""
    titles = list(dict.fromkeys(title for look in looks for title in look.odds))
    at = np.array([float(look.number) for look in looks])
    series = []
    for n, title in enumerate(titles):
        odds = np.array([look.odds.get(title, 0.0) for look in looks])
        series += [Series(at, odds, title, "line", n % COLOURS), Series(at, odds, "", "dots", n % COLOURS)]
    if not series:
        return paragraph("Nothing was ever thought of: recordings and model agree within the noise.")
    return plot_panel("odds of each hypothesis", ("recording", "share"), series, limits=(0.0, 1.0))
