"""HTML page of a blind campaign.

Score, verdict, confusion matrix and wrong answers; the same as a dict for JSON.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rig.array_and_json_types import Json
from rig.report.pages.html_and_svg_elements import (
    figures_with_caption_html,
    heading_html,
    note_html,
    paragraph_html,
    table_html,
)
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import Series, plot_panel_svg
from rig.report.verdict_refutations_and_result_display import Evidence, MissingEvidence, Verdict, judge_evidence
from synthetic import blind_diagnosis_score

if TYPE_CHECKING:
    from synthetic.blind_diagnosis_score import Case, Figure, Hidden

LOOK_AT = "Examine the wrong answers below, each in its folder: `diagnoses/NNNN/diagnosis.html`"
MORE = "Draw more cases: `rig simulate blind --season N --out DIR` with a longer season"
LINKS = 12  # to diagnoses that were not right
OUTCOMES = ("named and placed", "named", "allowed", "taken for another", "unknown", "nothing")


def campaign_dict(cases: list[Case]) -> Json:
    """Dict of a campaign for JSON.

    Verdict, figures, medians, by_effect, by_strength, confusion, cases.
    """
    return {
        "verdict": campaign_verdict(blind_diagnosis_score.campaign_rates_with_intervals(cases)).tree(),
        "figures": [asdict(f) for f in blind_diagnosis_score.campaign_rates_with_intervals(cases)],
        "medians": {
            name: None if math.isnan(value) else value
            for name, value in blind_diagnosis_score.campaign_medians(cases).items()
        },
        "by_effect": _rows(blind_diagnosis_score.detection_and_naming_shares_by_effect(cases)),
        "by_strength": _rows(blind_diagnosis_score.detection_and_naming_shares_by_strength(cases)),
        "confusion": blind_diagnosis_score.strong_effect_confusion_table(cases),
        "cases": [
            {
                "case": c.index,
                "kind": c.kind,
                "disturbance": c.disturbance,
                "failed": c.failed,
                "seconds": c.seconds,
                "ratio": None if math.isnan(c.ratio) else c.ratio,
                "unexplained": c.unexplained,
                "hidden": [
                    {"effect": h.effect, "place": h.place, "strength": h.strength, "outcome": _outcome(c, h)}
                    for h in c.hidden
                ],
                "found": [
                    {"effect": f.effect, "place": f.place, "alternatives": [list(a) for a in f.alternatives]}
                    for f in c.found
                ],
            }
            for c in cases
        ],
    }


def _outcome(case: Case, hidden: Hidden) -> str:
    """What became of a hidden effect: one of OUTCOMES."""
    found = case.match(hidden)
    if found is None:
        outcome = case.seen_as(hidden)
        return outcome if outcome in ("unknown", "nothing") else "taken for another"
    if found.effect != hidden.effect:
        return "allowed"
    return "named and placed" if found.place == hidden.place else "named"


def write_campaign_page(path: Path, settings: Json, cases: list[Case]) -> None:
    """Write the page of a campaign.

    Figures with intervals, by effect, by strength, confusion, wrong answers.
    """
    message = ", ".join(
        f"{name} {', '.join(map(str, value)) if isinstance(value, list) else value}"
        for name, value in settings.items()
        if value
    )
    parts = [
        paragraph_html(
            f"{len(cases)} blinded cases ({message}). Strength is an effect's signal-to-noise over all corners "
            "once cameras and geometry "
            f"have absorbed what they can; an effect is strong from {blind_diagnosis_score.STRONG:g} on. Intervals "
            "are Clopper and Pearson's, 95 %."
        ),
        table_html(
            ("what", "hits", "of", "share", "interval", "to reach"),
            [_figure(f) for f in blind_diagnosis_score.campaign_rates_with_intervals(cases)],
        ),
        table_html(
            ("median", ""),
            [
                (name, "not known" if math.isnan(value) else f"{value:.3g}")
                for name, value in blind_diagnosis_score.campaign_medians(cases).items()
            ],
        ),
        heading_html("By effect"),
        note_html("Strong ones, in cases with one or two."),
        _grouped(blind_diagnosis_score.detection_and_naming_shares_by_effect(cases), "effect"),
        heading_html("By strength"),
        _grouped(blind_diagnosis_score.detection_and_naming_shares_by_strength(cases), "signal-to-noise"),
    ]
    if any(c.hidden for c in cases):
        parts.append(
            figures_with_caption_html(
                _strengths(cases),
                "Each dot is a hidden effect: its outcome (a row each, in the order of the legend) against its "
                "signal-to-noise over all corners (no unit, as a power of ten). Good: strong effects, to the right, "
                "are named and placed. Bad: strong ones missed.",
            )
        )
    parts += [
        heading_html("Confusion matrix"),
        note_html("Rows: what was hidden. Columns: the name that it was given."),
        _confusion(blind_diagnosis_score.strong_effect_confusion_table(cases)),
        heading_html("Wrong answers"),
        _wrong(cases),
    ]
    links = [
        Link(f"Case {c.index}", f"diagnoses/{c.index:04d}/diagnosis.html")
        for c in cases
        if c.failed is None and not _right(c)
    ][:LINKS]
    verdict = campaign_verdict(blind_diagnosis_score.campaign_rates_with_intervals(cases))
    write_page(
        path,
        Page(
            "blind",
            "Blind cases",
            verdict,
            parts,
            list(dict.fromkeys([*verdict.next, *([LOOK_AT] if links else [])])),
            links,
        ),
    )


def campaign_verdict(figures: list[Figure]) -> Verdict:
    """Verdict on a campaign.

    It says which figures reach their goal, and which certainly do not.
    """
    requested = [f for f in figures if f.goal is not None and f.trials]
    missed = [f for f in requested if f.hits < (f.goal or 0) * f.trials]
    if not requested:
        return judge_evidence(
            Evidence("no figure is judged", missing=(MissingEvidence("no case provides a required figure", MORE),))
        )
    surely = [f for f in missed if f.high < (f.goal or 0)]
    few = [
        f for f in requested if f not in missed and f.low < (f.goal or 0) < 1
    ]  # of no number of cases is all surely reached
    missing = [MissingEvidence(f"{_figure_text(f)} falls short") for f in missed if f not in surely]
    missing += [MissingEvidence(f"too few cases to decide: {'; '.join(map(_figure_text, few))}", MORE)] if few else []
    reached = f"{len(requested) - len(missed)} of {len(requested)} figures reach their goals"
    return judge_evidence(
        Evidence(
            reached,
            missing=tuple(missing),
            refuted=tuple(f"{_figure_text(f)} falls short significantly" for f in surely),
            look=LOOK_AT,
        )
    )


def _figure_text(f: Figure) -> str:
    return f"{f.name} {f.hits} of {f.trials} ({f.low:.0%} to {f.high:.0%}, to reach {f.goal or 0:.0%})"


def _figure(f: Figure) -> tuple[object, ...]:
    goal = "" if f.goal is None else f"{f.goal:.0%}"
    return (
        f.name,
        f.hits,
        f.trials,
        *((f"{f.hits / f.trials:.1%}", f"{f.low:.1%} to {f.high:.1%}") if f.trials else ("", "")),
        goal,
    )


def _rows(groups: Sequence[tuple[str, Sequence[Figure], dict[str, int]]]) -> list[Json]:
    return [
        {"name": name, **{f.name: [f.hits, f.trials] for f in figures}, "taken_for": cases}
        for name, figures, cases in groups
    ]


def _grouped(groups: Sequence[tuple[str, Sequence[Figure], dict[str, int]]], heading: str) -> str:
    rows = [
        (
            name,
            figures[0].trials,
            *(f"{f.hits} of {f.trials}" if f.trials else "" for f in figures),
            ", ".join(
                f"{other} {count}" for other, count in sorted(cases.items(), key=lambda item: -item[1]) if other != name
            ),
        )
        for name, figures, cases in groups
    ]
    return table_html((heading, "times", "detected", "named", "placed", "intervals that cover", "taken for"), rows)


def _strengths(cases: list[Case]) -> str:
    """What became of every hidden effect, by its strength: a row for each outcome."""
    strengths = [
        (max(h.strength, 0.1), OUTCOMES.index(_outcome(c, h))) for c in cases if c.failed is None for h in c.hidden
    ]
    strength, became = (
        (np.array(column, float) for column in zip(*strengths)) if strengths else (np.zeros(0), np.zeros(0))
    )
    series = [
        Series(np.log10(strength[became == k]), np.full((became == k).sum(), len(OUTCOMES) - float(k)), name, colour=k)
        for k, name in enumerate(OUTCOMES)
    ]
    return plot_panel_svg(
        "outcome of each hidden effect",
        ("signal-to-noise, power of ten", ""),
        series,
        limits=(0.0, len(OUTCOMES) + 1.0),
    )


def _confusion(matrix: dict[str, dict[str, int]]) -> str:
    columns = sorted(
        {name for counts in matrix.values() for name in counts}, key=lambda name: (name in ("unknown", "nothing"), name)
    )
    return table_html(
        ("hidden", *(name.replace("_", " ") for name in columns)),
        [(name, *(counts.get(column, "") for column in columns)) for name, counts in sorted(matrix.items())],
    )


def _wrong(cases: list[Case]) -> str:
    rows = []
    for c in cases:
        hidden = (
            ", ".join(f"{h.effect} at {h.place} ({h.strength:.3g})" for h in c.hidden) or c.disturbance or "nothing"
        )
        found = ", ".join(f"{f.effect} at {f.place}" for f in c.found) or "nothing"
        if c.failed is not None or not _right(c):
            rows.append((c.index, hidden, c.failed or found))
    return table_html(("case", "hidden (strength)", "found"), rows) if rows else paragraph_html("There is none.")


def _right(c: Case) -> bool:
    """Whether a case was answered as it ought to be."""
    known = {
        "nothing": not c.found and not c.unexplained,
        "noise": not c.named,
        "foreign": c.unexplained and not c.named,
    }
    return bool(
        known.get(c.kind, all(_outcome(c, h) == OUTCOMES[0] for h in c.hidden) and len(c.named) == len(c.hidden))
    )
