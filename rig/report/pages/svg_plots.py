"""Plots as SVG.

Panels of dots, lines and intervals over two axis scales, and bar charts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.report.pages.html_and_svg_elements import (
    TEXT,
    escape_html,
    round_ticks,
    svg_figure,
    svg_text,
    svg_tooltip,
    text_width,
    wrap_text,
)

ROOM = 0.05  # of the range, on either side of the values


@dataclass(frozen=True)
class Scale:
    """Values low .. high at places start .. end of a figure; log : by their logarithm; whole : of whole numbers, as
    frames are.
    """

    low: float
    high: float
    start: float
    end: float
    log: bool = False
    whole: bool = False

    def at(self, values: Floats | Integers | float) -> Floats:
        """Places of values, any shape."""
        v = np.asarray(values, float)
        low, high = self.low, self.high
        if self.log:
            with np.errstate(divide="ignore"):
                v = np.log10(np.maximum(v, 0))
            low, high = math.log10(low), math.log10(high)
        return self.start + (self.end - self.start) * (v - low) / (high - low)

    @cached_property
    def ticks(self) -> list[float]:
        """Values at which ticks stand."""
        if not self.log:
            return [v for v in round_ticks(self.low, self.high) if v == round(v) or not self.whole]
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        wide = last - first > 2
        every = -(-(last - first) // 6)
        found = [
            k * 10.0**p
            for p in range(first, last + 1)
            if (p - first) % every == 0
            for k in ((1,) if wide else (1, 2, 5))
        ]
        return [v for v in found if self.low <= v * (1 + 1e-9) and v <= self.high * (1 + 1e-9)]

    def script_text(self) -> str:
        """For the page's script: low, high, start, end, and log where it is."""
        return f"{self.low:.6g} {self.high:.6g} {self.start:.1f} {self.end:.1f}" + (" log" if self.log else "")


def axis_scale_of_values(
    values: Floats,
    ends_on_figure: tuple[float, float],
    log: bool = False,
    limits: tuple[float, float] | None = None,
    are_whole_numbers: bool = False,
) -> Scale:
    """Scale of an axis for values (n,).

    For all finite ones.
    ends_on_figure : (2,); limits : replace the values' own; are_whole_numbers : whether values are whole numbers
    """
    known = np.asarray(values, float).ravel()
    known = known[np.isfinite(known) & ((known > 0) | (not log))]
    if limits is not None:
        low, high = limits
    elif not len(known):
        low, high = (0.1, 1.0) if log else (0.0, 1.0)
    else:
        low, high = float(known.min()), float(known.max())
        if log:
            low, high = low / 1.3, high * 1.3
        else:
            room = ROOM * (high - low) or 0.5 * abs(high) or 1.0
            low, high = low - room, high + room
    return Scale(low, high, *ends_on_figure, log, are_whole_numbers)


LEFT, RIGHT, BELOW = 52.0, 392.0, 24.0
HIGH = 190.0  # of a panel's drawing
MOST = 2500  # dots of a series that are drawn: of more, evenly chosen ones
COLOURS = 6  # that figure.css has


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """What is drawn of one kind. x, y : (n,) values, NaN where there is none; name : "" for none
    kind : dots, crosses, line, rings (with `half`, (n,) half of an interval); colour : 0 .. COLOURS - 1, or -1 for
        grey"""

    x: Floats | Integers
    y: Floats
    name: str = ""
    kind: str = "dots"
    colour: int = 0
    half: Floats | None = None


def figures_side_by_side_html(*figures: str) -> str:
    """HTML of figures side by side.

    Where there is room, else below each other.
    """
    return '<div class="panels">' + "".join(figures) + "</div>"


def plot_panel_svg(
    title: str,
    labels: tuple[str, str],
    series: Sequence[Series],
    log: bool = False,
    limits: tuple[float, float] | None = None,
    level: float | None = None,
    high: float = HIGH,
) -> str:
    """Plot panel of series as SVG.

    labels : (x, y) with units; log : of y; limits : of y, or None; level : y of a line
    """
    legend = [s for s in series if s.name]
    rows = _rows([s.name for s in legend])
    top = 19.0 + (TEXT + 7) + 18.0 * (max(row for row, _ in rows) + 1 if rows else 0)
    bottom = top + high
    halves = [s.half for s in series if s.half is not None]
    ys = (
        [s.y for s in series] + [s.y + sign * half for s in series if (half := s.half) is not None for sign in (-1, 1)]
        if halves
        else [s.y for s in series]
    )
    across = np.concatenate([s.x for s in series])
    x = axis_scale_of_values(across, (LEFT, RIGHT), are_whole_numbers=bool(np.all(across == np.round(across))))
    y = axis_scale_of_values(
        np.concatenate(ys + ([] if level is None else [np.array([level])])), (bottom, top), log, limits
    )
    parts = [svg_text(LEFT, 14, title, style="name"), *_legend(legend, rows, TEXT + 24.0), *_axes(x, y, labels)]
    if level is not None:
        parts.append(f'<path class="level" d="M{LEFT} {float(y.at(level)):.1f}H{RIGHT}"/>')
    parts += [_drawn(s, x, y) for s in series]
    attributes = f' data-x="{x.script_text()}" data-y="{y.script_text()}" data-labels="{escape_html("|".join(labels))}"'
    return svg_figure(
        int(bottom + BELOW + 17 * len(_below(labels[0]))), f"{title}: {labels[1]} over {labels[0]}", parts, attributes
    )


def bar_chart_svg(
    title: str,
    names: Sequence[str],
    groups: Sequence[tuple[str, Sequence[float], int]],
    unit: str,
    marked: Sequence[str] = (),
) -> str:
    """Horizontal bar chart as SVG.

    A bar per name and group.
    groups : (name, values in unit, colour); marked : bold names
    """
    rows = _rows([g[0] for g in groups])
    top = 10.0 + TEXT + 7 + 18.0 * (max(row for row, _ in rows) + 1)
    deep = 12 * len(groups) + 8
    most = max([v for _, values, _ in groups for v in values if np.isfinite(v)], default=0.0) or 1.0
    left = 16 + min(160.0, 1.1 * max([text_width(n, TEXT) for n in names], default=1.0))
    named = f"{title}, {unit}" if unit else title
    parts = [
        svg_text(4, 14, named, style="name"),
        *_legend([Series(np.zeros(0), np.zeros(0), g[0], "bars", g[2]) for g in groups], rows, TEXT + 24.0),
    ]
    for k, name in enumerate(names):
        at = top + deep * k
        parts.append(svg_text(left - 8, at + 6 * len(groups) + 4, name, "end", "name" if name in marked else ""))
        for row, (group, values, colour) in enumerate(groups):
            long = (RIGHT - 60 - left) * values[k] / most if np.isfinite(values[k]) else 0.0
            parts.append(
                f'<rect class="fill {_colour(colour)}" x="{left:.1f}" y="{at + 12 * row:.1f}" '
                f'width="{long:.1f}" height="10">'
                f"{svg_tooltip(f'{name}, {group}: {values[k]:.4g} {unit}')}</rect>"
            )
            parts.append(
                svg_text(
                    left + long + 4,
                    at + 12 * row + 9,
                    _plain(values[k]) if np.isfinite(values[k]) else "",
                    style="small",
                )
            )
    return svg_figure(int(top + deep * len(names) + 4), f"{title}, {unit}", parts)


def _plain(value: float) -> str:
    """Three digits, all of those before the point."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _axes(x: Scale, y: Scale, labels: tuple[str, str]) -> list[str]:
    bottom, top = y.start, y.end
    parts = [f'<path class="axis" d="M{LEFT} {top:.1f}V{bottom:.1f}H{RIGHT}"/>']
    for v in x.ticks:
        parts += [
            f'<path class="tick" d="M{float(x.at(v)):.1f} {top:.1f}V{bottom:.1f}"/>',
            svg_text(float(x.at(v)), bottom + 16, f"{v:g}", "middle"),
        ]
    for v in y.ticks:
        parts += [
            f'<path class="tick" d="M{LEFT} {float(y.at(v)):.1f}H{RIGHT}"/>',
            svg_text(LEFT - 5, float(y.at(v)) + 4, f"{v:g}", "end"),
        ]
    below = [
        svg_text((LEFT + RIGHT) / 2, bottom + 33 + 17 * k, line, "middle") for k, line in enumerate(_below(labels[0]))
    ]
    return [*parts, *below, svg_text(4, top - 9, labels[1])]


def _below(label: str) -> list[str]:
    """Lines of a label below an axis."""
    return wrap_text(label, TEXT, RIGHT - LEFT)


def _rows(names: Sequence[str]) -> list[tuple[int, float]]:
    """[(row, place)] of a legend's names, as many in a row as fit."""
    places, row, at = [], 0, LEFT
    for name in names:
        room = 32 + text_width(name, TEXT)
        if at > LEFT and at + room > RIGHT:
            row, at = row + 1, LEFT
        places.append((row, at))
        at += room
    return places


def _legend(series: Sequence[Series], rows: Sequence[tuple[int, float]], top: float) -> list[str]:
    parts = []
    for s, (row, at) in zip(series, rows):
        y = top + 18 * row - 8
        parts += [
            f'<path class="{_style(s)}" d="M{at + 7:.1f} {y - 4:.1f}h0.01"/>'
            if s.kind != "bars"
            else f'<rect class="{_style(s)}" x="{at + 2:.1f}" y="{y - 9:.1f}" width="10" height="10"/>',
            svg_text(at + 18, y, s.name),
        ]
        if s.kind == "line":
            parts[-2] = f'<path class="{_style(s)}" d="M{at:.1f} {y - 4:.1f}h14"/>'
    return parts


def _style(s: Series) -> str:
    return f"{'fill' if s.kind == 'bars' else s.kind} {_colour(s.colour)}"


def _colour(number: int) -> str:
    return "grey" if number < 0 else f"c{number % COLOURS}"


def _drawn(s: Series, x: Scale, y: Scale) -> str:
    known = np.flatnonzero(np.isfinite(s.x) & np.isfinite(s.y) & ((s.y > 0) | (not y.log)))
    every = -(-len(known) // MOST) if s.kind != "line" else 1
    known = known[:: max(every, 1)]
    at = np.stack([x.at(s.x[known]), np.clip(y.at(s.y[known]), y.end, y.start)], axis=1)
    name = f' data-name="{escape_html(s.name)}"' if s.name else ""
    if s.kind == "line":
        d = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in at.tolist()) if len(at) else ""
        return f'<path class="{_style(s)}"{name} d="{d}"/>'
    d = "".join(f"M{a:.1f} {b:.1f}h.01" for a, b in at.tolist())
    drawn = ""
    if s.half is not None:
        ends = np.clip(np.stack([y.at((s.y - s.half)[known]), y.at((s.y + s.half)[known])], axis=1), y.end, y.start)
        drawn = (
            f'<path class="whisker{_style(s).removeprefix(s.kind)}" d="'
            + "".join(f"M{a:.1f} {low:.1f}V{high:.1f}" for (a, _), (low, high) in zip(at.tolist(), ends.tolist()))
            + '"/>'
        )
    return drawn + f'<path class="{_style(s)} valued"{name} d="{d}"/>'
