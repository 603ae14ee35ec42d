"""The workspace from above and from the side, one quantity of its cells after another."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from calib.workspace import words
from calib.workspace.cells import Workspace
from rig.effects.covariate import DRAWN
from rig.page.figure import panels
from rig.page.parts import heading, note, paragraph
from rig.page.svg import hover, svg, text

LEFT, WIDE, TALL = 6.0, 388.0, 300.0  # of a view


class Quantity(NamedTuple):
    """What is drawn of cells. name; title : a line above it; style : of its cells, as document.css has it; values : of a Workspace's cells seen
    one behind the other, rows (c,) of each column of them -> a number, NaN for none; written : that number in a cell"""

    name: str
    title: str
    style: str
    value: Callable[[Workspace, np.ndarray], float]
    written: Callable[[float], str]


def _share(part: str, whole: str) -> Callable[[Workspace, np.ndarray], float]:
    def value(w: Workspace, rows: np.ndarray) -> float:
        of = getattr(w, whole)[rows].sum()
        return float(getattr(w, part)[rows].sum() / of) if of else np.nan

    return value


def _end(name: str, choose: Callable[[np.ndarray], float], column: int | None = None) -> Callable[[Workspace, np.ndarray], float]:
    def value(w: Workspace, rows: np.ndarray) -> float:
        values = getattr(w, name)[rows] if column is None else getattr(w, name)[rows, column]
        known = values[np.isfinite(values)]
        return float(choose(known)) if len(known) else np.nan

    return value


def _percent(value: float) -> str:
    return "0" if value == 0 else f"{value * 100:.0f}" if value >= 0.1 else f"{value * 100:.1f}"


LOST = Quantity("lost", "lost: poses that the owner's model reaches and the corrected machine does not, % of a cell's", "lost",
                _share("lost_in", "believed"), _percent)
GAINED = Quantity("gained", "gained: poses that the corrected machine reaches and the owner's model does not, % of a cell's", "gained",
                  _share("gained_in", "reached"), _percent)
POSITION = Quantity("position", "error bound (k = 2) of a corrected position, um, the greatest there", "", _end("bound", np.max, 0),
                    lambda value: f"{value * 1e6:.3g}")
ROTATION = Quantity("rotation", "error bound (k = 2) of a corrected rotation, urad, the greatest there", "", _end("bound", np.max, 1),
                    lambda value: f"{value * 1e6:.3g}")
SINGULAR = Quantity("singular", "least over greatest singular value of the Jacobian, the least there (0 is singular)", "", _end("singular", np.min),
                    lambda value: f"{value:.2f}")


def room(unit: str) -> Quantity:
    """The Quantity of the room to the axes' limits. unit : of an axis, m or rad."""
    scale, shown = DRAWN.get(unit, (1.0, unit))
    return Quantity("room", f"room to the nearest limit of an axis, {shown}", "gained", _end("room", np.max), lambda value: f"{value * scale:.3g}")


def views(w: Workspace, q: Quantity) -> str:
    """SVG of a Quantity over the cells, from above (x, y) and, where they are not in one layer, from the side (x, z)."""
    parts, height = [], 0.0
    span = w.index.max(axis=0) + 1
    for across, up in ((0, 1),) if w.flat else ((0, 1), (0, 2)):
        scale = min(WIDE / span[across], TALL / span[up])
        base = height + 20 + scale * span[up]
        columns, at = np.unique(w.index[:, [across, up]], axis=0, return_inverse=True)
        found = np.array([q.value(w, np.flatnonzero(at.ravel() == k)) for k in range(len(columns))])
        top = np.nanmax(found, initial=1e-300)
        for (i, j), value in zip(columns.tolist(), found.tolist()):
            x, y = LEFT + scale * i, base - scale * (j + 1)
            opacity = 0.0 if value != value else 0.75 * max(value, 0.0) / top
            parts.append(f'<rect class="cell {q.style}" fill-opacity="{opacity:.2f}" x="{x:.1f}" y="{y:.1f}" width="{scale:.1f}" '
                         f'height="{scale:.1f}">{hover(q.written(value)) if value == value else ""}</rect>')
            parts.append(text(x + scale / 2, y + scale / 2 + 3, q.written(value) if value == value else "", "middle", "small"))
        corner = [(w.origin[axis] * 1e3, (w.origin[axis] + span[axis] * w.size) * 1e3) for axis in (across, up)]
        parts += [text(LEFT, height + 14, f"{'xyz'[up]} up, {corner[1][0]:.0f} to {corner[1][1]:.0f} mm"),
                  text(LEFT, base + 15, f"{'xyz'[across]} to the right, {corner[0][0]:.0f} to {corner[0][1]:.0f} mm")]
        height = base + 26
    return svg(int(height) + 4, q.title, parts)


def titled(w: Workspace, q: Quantity) -> list[str]:
    """HTML of a Quantity over the cells, with its title."""
    return [note(q.title), views(w, q)]


def section(w: Workspace | None, unit: str) -> list[str]:
    """HTML of what a calibration's page shows of its workspace; nothing of a calibration without. unit : of an axis, m or rad."""
    if w is None:
        return []
    quantities = (LOST, GAINED, POSITION) if w.lost is not None else (POSITION,)
    maps = ("<div>" + "".join(titled(w, q)) + "</div>" for q in quantities)
    return [heading("The workspace"), *(paragraph(f"{line}.") for line in words.lines(w, unit)), panels(*maps)]
