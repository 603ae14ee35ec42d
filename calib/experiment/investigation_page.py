"""An investigation's page: the odds of each hypothesis falling and rising, look by look, then what was tried and at
which stated chance.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.experiment.investigation_folder import Look
from calib.experiment.laboratory_notebook import minutes_spent, next_experiment
from rig.report.pages.html_elements import heading, list_html, note, paragraph, table
from rig.report.pages.page_template import Page, write_page
from rig.report.pages.plots import COLOURS, Series, plot_panel
from rig.report.verdict import LOOK, Evidence, Missing, Verdict, judge_evidence


def write_investigation_page(
    path: Path, rig: str, looks: Sequence[Look], budget: float, ended: str, after: Sequence[str]
) -> None:
    """Write the page. rig, budget, ended, after : as for the notebook"""
    parts = [
        paragraph(f"{minutes_spent(looks):.1f} of {budget:.0f} min of the rig's time."),
        heading("Odds"),
        odds_figure(looks),
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
    if after:
        parts += [heading("And then"), list_html(after)]
    verdict = investigation_verdict(looks, ended)
    write_page(path, Page("investigate", f"What is the matter with {rig}", verdict, parts, verdict.next))


def investigation_verdict(looks: Sequence[Look], ended: str) -> Verdict:
    """The verdict: good where nothing is left out, to be looked at where something is, has no name or cannot be told
    from something else.
    """
    last = looks[-1]
    named = ", ".join(last.findings) or "; ".join(last.unknown) or "nothing is left out"
    left = list(last.doubts) or [
        *(f"the geometry alone leaves out {name}" for name in last.findings),
        *(f"nothing in the catalogue explains {text}" for text in last.unknown),
    ]
    missing = [
        *([] if ended else [Missing("it goes on")]),
        *([Missing("several explanations are alike")] if last.questions else []),
    ]
    steps = recommended_actions(looks, ended)
    return judge_evidence(
        Evidence(
            f"{named}: {ended or 'it goes on'}",
            tuple(steps),
            unexplained=tuple(left),
            missing=tuple(missing),
            look=steps[0] if steps else LOOK,
        )
    )


def recommended_actions(looks: Sequence[Look], ended: str) -> list[str]:
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
    experiment = next_experiment(before) if before is not None else None
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


def odds_figure(looks: Sequence[Look]) -> str:
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
