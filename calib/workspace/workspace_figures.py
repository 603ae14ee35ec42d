"""The workspace from above and from the side, one quantity of its cells after another."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calib.workspace import workspace_sentences
from calib.workspace.workspace_cells import Workspace
from rig.effects.framework.covariate import DRAWN
from rig.report.pages.html_elements import heading, note, paragraph
from rig.report.pages.plots import panel_row
from rig.report.pages.svg_elements import svg, text, text_within, tooltip

LEFT, WIDE, TALL = 6.0, 388.0, 300.0  # of a view


class Quantity(NamedTuple):
    """What is drawn of cells. name; title : a line above it; style : of its cells, as figure.css has it; values : of a
    Workspace's cells seen one behind the other, rows (c,) of each column of them -> a number, NaN for none, in the
    finest of the units
    units : [(name, how many of the finest it has)], finest first: that one is written in which the greatest has three
        digits"""

    name: str
    title: str
    style: str
    value: Callable[[Workspace, np.ndarray], float]
    units: Sequence[tuple[str, float]]


def _share(part: str, whole: str) -> Callable[[Workspace, np.ndarray], float]:
    def value(w: Workspace, rows: np.ndarray) -> float:
        of = getattr(w, whole)[rows].sum()
        return 100 * float(getattr(w, part)[rows].sum() / of) if of else np.nan

    return value


def _end(
    name: str, choose: Callable[[np.ndarray], float], scale: float, column: int | None = None
) -> Callable[[Workspace, np.ndarray], float]:
    def value(w: Workspace, rows: np.ndarray) -> float:
        values = getattr(w, name)[rows] if column is None else getattr(w, name)[rows, column]
        known = values[np.isfinite(values)]
        return scale * float(choose(known)) if len(known) else np.nan

    return value


LOST = Quantity(
    "lost",
    "poses that the owner's model reaches and the corrected machine does not, share of a cell's",
    "lost",
    _share("lost_in", "believed"),
    [("%", 1.0)],
)
GAINED = Quantity(
    "gained",
    "poses that the corrected machine reaches and the owner's model does not, share of a cell's",
    "gained",
    _share("gained_in", "reached"),
    [("%", 1.0)],
)
POSITION = Quantity(
    "position",
    "error bound (k = 2) of a corrected position, the greatest there",
    "",
    _end("bound", np.max, 1e6, 0),
    [("um", 1.0), ("mm", 1e3)],
)
ROTATION = Quantity(
    "rotation",
    "error bound (k = 2) of a corrected rotation, the greatest there",
    "",
    _end("bound", np.max, 1e6, 1),
    [("urad", 1.0), ("mrad", 1e3)],
)
SINGULAR = Quantity(
    "singular",
    "least singular value of the Jacobian, of the greatest, the least there (0 is singular)",
    "",
    _end("singular", np.min, 100.0),
    [("%", 1.0)],
)


def axis_margin_quantity(unit: str) -> Quantity:
    """The Quantity of the room to the axes' limits. unit : of an axis, m or rad."""
    scale, shown = DRAWN.get(unit, (1.0, unit))
    return Quantity(
        "room",
        "room to the nearest limit of an axis, the greatest there",
        "gained",
        _end("room", np.max, scale),
        [(shown, 1.0)],
    )


def cell_number_text(value: float) -> str:
    """A number as it stands in a cell: to whole ones, below ten to tenths."""
    return f"{value:.0f}" if abs(value) >= 9.95 or value == 0 else f"{value:.1f}"


def cell_views(w: Workspace, q: Quantity) -> tuple[str, str]:
    """(The unit, SVG) of a Quantity over the cells, from above (x, y) and, where they are not in one layer, from the
    side (x, z).
    """
    parts, height = [], 0.0
    span = w.index.max(axis=0) + 1
    planes = [(across, up, *_columns(w, q, across, up)) for across, up in (((0, 1),) if w.flat else ((0, 1), (0, 2)))]
    greatest = max((float(np.nanmax(found, initial=0.0)) for *_, found in planes))
    unit, per = next((one for one in q.units if greatest / one[1] < 999.5), q.units[-1])
    for across, up, columns, found in planes:
        scale = min(WIDE / span[across], TALL / span[up])
        base = height + 20 + scale * span[up]
        top = np.nanmax(found, initial=1e-300)
        for (i, j), value in zip(columns.tolist(), found.tolist()):
            box = (LEFT + scale * i, base - scale * (j + 1), scale, scale)
            opacity = 0.0 if value != value else 0.75 * max(value, 0.0) / top
            told = cell_number_text(value / per) if value == value else ""
            parts.append(
                f'<rect class="cell {q.style}" fill-opacity="{opacity:.2f}" x="{box[0]:.1f}" '
                f'y="{box[1]:.1f}" width="{scale:.1f}" '
                f'height="{scale:.1f}">{tooltip(f"{told} {unit}") if told else ""}</rect>'
            )
            parts.append(text_within(box, told, "small"))
        corner = [(w.origin[axis] * 1e3, (w.origin[axis] + span[axis] * w.size) * 1e3) for axis in (across, up)]
        parts += [
            text(LEFT, height + 14, f"{'xyz'[up]} up, {corner[1][0]:.0f} to {corner[1][1]:.0f} mm"),
            text(LEFT, base + 15, f"{'xyz'[across]} to the right, {corner[0][0]:.0f} to {corner[0][1]:.0f} mm"),
        ]
        height = base + 26
    return unit, svg(int(height) + 4, f"{q.title}, {unit}", parts)


def _columns(w: Workspace, q: Quantity, across: int, up: int) -> tuple[np.ndarray, np.ndarray]:
    """(Indices (c, 2) along two axes of cells seen one behind the other, the Quantity of each (c,))."""
    columns, at = np.unique(w.index[:, [across, up]], axis=0, return_inverse=True)
    return columns, np.array([q.value(w, np.flatnonzero(at.ravel() == k)) for k in range(len(columns))])


def titled_cells_html(w: Workspace, q: Quantity) -> list[str]:
    """HTML of a Quantity over the cells, with its name and what it is."""
    unit, drawn = cell_views(w, q)
    return [heading(q.name.capitalize(), 3), note(f"{q.title[0].upper()}{q.title[1:]}, {unit}"), drawn]


def workspace_section_html(w: Workspace | None, unit: str) -> list[str]:
    """HTML of what a calibration's page shows of its workspace; nothing of a calibration without. unit : of an axis, m
    or rad.
    """
    if w is None:
        return []
    quantities = (LOST, GAINED, POSITION) if w.lost is not None else (POSITION,)
    maps = ("<div>" + "".join(titled_cells_html(w, q)) + "</div>" for q in quantities)
    return [
        heading("The workspace"),
        *(paragraph(f"{line}.") for line in workspace_sentences.workspace_lines(w, unit)),
        panel_row(*maps),
    ]
