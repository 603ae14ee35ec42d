"""The score of a campaign of blind cases, as a tree for JSON and as a page."""

from __future__ import annotations

import html
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.html_page import page, table
from synthetic import score

if TYPE_CHECKING:
    from synthetic.score import Case, Figure, Hidden

OUTCOMES = ("named and placed", "named", "allowed", "taken for another", "unknown", "nothing")
COLOURS = ("tab:green", "tab:olive", "tab:cyan", "tab:red", "tab:orange", "black")


def tree(cases: list[Case]) -> dict:
    """{figures, medians, by_effect, by_strength, confusion, cases} of Cases."""
    return {"figures": [asdict(f) for f in score.figures(cases)],
            "medians": {name: None if math.isnan(value) else value for name, value in score.medians(cases).items()},
            "by_effect": _rows(score.by_effect(cases)), "by_strength": _rows(score.by_strength(cases)), "confusion": score.confusion(cases),
            "cases": [{"case": c.index, "kind": c.kind, "disturbance": c.disturbance, "failed": c.failed, "seconds": c.seconds,
                        "ratio": None if math.isnan(c.ratio) else c.ratio, "unexplained": c.unexplained,
                        "hidden": [{"effect": h.effect, "place": h.place, "strength": h.strength, "outcome": outcome(c, h)} for h in c.hidden],
                        "found": [{"effect": f.effect, "place": f.place, "alternatives": [list(a) for a in f.alternatives]} for f in c.found]}
                      for c in cases]}


def outcome(case: Case, hidden: Hidden) -> str:
    """What became of a hidden effect: one of OUTCOMES."""
    found = case.match(hidden)
    if found is None:
        taken = case.seen_as(hidden)
        return taken if taken in ("unknown", "nothing") else "taken for another"
    if found.effect != hidden.effect:
        return "allowed"
    return "named and placed" if found.place == hidden.place else "named"


def campaign_page(path: Path, settings: dict, cases: list[Case]) -> None:
    """Write the page of a campaign: figures with their intervals, by effect, by strength, the confusion matrix, and every wrong answer."""
    said = ", ".join(f"{name} {', '.join(map(str, value)) if isinstance(value, list) else value}" for name, value in settings.items() if value)
    parts = [f"<p>{len(cases)} blinded cases ({html.escape(said)}). Strength is an effect's signal-to-noise over all corners once cameras and "
             f"geometry have taken what they can; an effect is strong from {score.STRONG:g} on. Intervals are Clopper and Pearson's, 95 %.</p>",
             table(("what", "hits", "of", "share", "interval", "to reach"), [_figure(f) for f in score.figures(cases)]),
             table(("median", ""), [(name, f"{value:.3g}") for name, value in score.medians(cases).items()]),
             "<h2>By effect</h2><p class=note>Strong ones, in cases with one or two.</p>", _grouped(score.by_effect(cases), "effect"),
             "<h2>By strength</h2>", _grouped(score.by_strength(cases), "signal-to-noise")]
    if any(c.hidden for c in cases):
        parts.append(_strengths(cases))
    parts += ["<h2>What was taken for what</h2><p class=note>Rows: what was hidden. Columns: the name that it was given.</p>",
              _confusion(score.confusion(cases)), "<h2>Answers that were not right</h2>", _wrong(cases)]
    page(path, "Blind cases", parts)


def _figure(f: Figure) -> tuple:
    goal = "" if f.goal is None else f"{f.goal:.0%}"
    return (f.name, f.hits, f.trials, *((f"{f.hits / f.trials:.1%}", f"{f.low:.1%} to {f.high:.1%}") if f.trials else ("", "")), goal)


def _rows(groups: list) -> list[dict]:
    return [{"name": name, **{f.name: [f.hits, f.trials] for f in figures}, "taken_for": taken} for name, figures, taken in groups]


def _grouped(groups: list, heading: str) -> str:
    rows = [(name, figures[0].trials, *(f"{f.hits} of {f.trials}" if f.trials else "" for f in figures),
             ", ".join(f"{other} {count}" for other, count in sorted(taken.items(), key=lambda item: -item[1]) if other != name))
            for name, figures, taken in groups]
    return table((heading, "times", "detected", "named", "placed", "intervals that cover", "taken for"), rows)


def _strengths(cases: list[Case]) -> Any:
    from matplotlib.figure import Figure

    names = sorted({h.effect for c in cases for h in c.hidden})
    figure = Figure(figsize=(10, 1.2 + 0.24 * len(names)), layout="constrained")
    axes = figure.subplots()
    for label, colour in zip(OUTCOMES, COLOURS):
        points = [(max(h.strength, 0.1), names.index(h.effect)) for c in cases if c.failed is None for h in c.hidden if outcome(c, h) == label]
        at, height = zip(*points) if points else ((), ())
        axes.scatter(at, height, color=colour, s=18, label=label, alpha=0.8)
    axes.axvline(score.STRONG, color="grey", lw=0.8)
    axes.set(xscale="log", xlabel="signal-to-noise", yticks=range(len(names)), yticklabels=names)
    axes.legend(fontsize=8, ncols=len(OUTCOMES), loc="lower center", bbox_to_anchor=(0.4, 1))
    return figure


def _confusion(matrix: dict[str, dict[str, int]]) -> str:
    columns = sorted({name for counts in matrix.values() for name in counts}, key=lambda name: (name in ("unknown", "nothing"), name))
    return table(("hidden", *(name.replace("_", " ") for name in columns)),
                 [(name, *(counts.get(column, "") for column in columns)) for name, counts in sorted(matrix.items())])


def _wrong(cases: list[Case]) -> str:
    rows = []
    for c in cases:
        hidden = ", ".join(f"{h.effect} at {h.place} ({h.strength:.3g})" for h in c.hidden) or c.disturbance or "nothing"
        found = ", ".join(f"{f.effect} at {f.place}" for f in c.found) or "nothing"
        right = {"nothing": not c.found and not c.unexplained, "noise": not c.named, "foreign": c.unexplained and not c.named}.get(
            c.kind, all(outcome(c, h) == OUTCOMES[0] for h in c.hidden) and len(c.named) == len(c.hidden))
        if c.failed is not None or not right:
            rows.append((c.index, hidden, c.failed or found))
    return table(("case", "hidden (strength)", "found"), rows) if rows else "<p>There is none.</p>"
