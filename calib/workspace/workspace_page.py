"""HTML page of a workspace.

Sentences, figures of its cells, and verdict.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import SHORT, Workspace
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.parameters_covariates_and_marker_table import PLOT_UNITS
from rig.formats.numbers_and_units import number_text
from rig.report.pages.html_and_svg_elements import (
    figures_with_caption_html,
    heading_html,
    note_html,
    paragraph_html,
    svg_figure,
    svg_text,
    svg_text_or_empty_if_too_large,
    svg_tooltip,
    table_html,
)
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import figures_side_by_side_html
from rig.report.verdict_refutations_and_result_display import Evidence, MissingEvidence, Verdict, judge_evidence


def workspace_lines(workspace: Workspace, unit: str) -> list[str]:
    """Lines on a Workspace.

    Poses lost and gained, margin, singularities, error bound.
    unit : of the axes
    """
    first = (
        SHORT
        if workspace.lost is None or workspace.gained is None
        else (
            f"{workspace.lost * 100:.2f} % of the poses that the nominal model reaches are lost, "
            f"{workspace.gained * 100:.2f} % of those that the corrected machine "
            f"reaches are gained ({workspace.drawn} configurations of each, over the whole strokes)"
        )
    )
    known, inner = np.isfinite(workspace.bound[:, 0]), workspace.room > 0
    turned = f" and {_span(workspace.bound[known, 1] * 1e6)} urad" if workspace.turns else ""
    out = [
        f"workspace: {first}",
        f"{known.sum()} cells of {workspace.size * 1e3:.3g} mm: error bound (k = 2) "
        f"{_span(workspace.bound[known, 0] * 1e6)} "
        f"um{turned}; "
        f"singular values from {np.nanmin(workspace.singular):.3f} of the greatest",
    ]
    if inner.any():
        scale, shown = PLOT_UNITS.get(unit, (1.0, unit))
        out.append(
            f"{inner.sum()} cells have a margin to all limits, up to {np.nanmax(workspace.room) * scale:.4g} {shown}"
        )
    return out


def _span(values: Floats) -> str:
    low, high = number_text(values.min()), number_text(values.max())
    return low if low == high else f"{low} to {high}"


def certified_cell_promises_line(cell_promises: Floats) -> str:
    """Line on the promises (cells, 2) that a certificate makes in the cells."""
    known = np.isfinite(cell_promises[:, 0])
    if not known.any():
        return "the certificate's volume holds the middle of no cell"
    turns = cell_promises[known & np.isfinite(cell_promises[:, 1]), 1]
    return f"certified in {known.sum()} cells: position {_span(cell_promises[known, 0] * 1e6)} um" + (
        f", rotation {_span(turns * 1e6)} urad" if len(turns) else "; no rotation was measured"
    )


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
    value: Callable[[Workspace, Integers], float]
    units: Sequence[tuple[str, float]]


def _share(part: str, whole: str) -> Callable[[Workspace, Integers], float]:
    def value(w: Workspace, rows: Integers) -> float:
        of = getattr(w, whole)[rows].sum()
        return 100 * float(getattr(w, part)[rows].sum() / of) if of else np.nan

    return value


def _end(
    name: str, choose: Callable[[Floats], float], scale: float, column: int | None = None
) -> Callable[[Workspace, Integers], float]:
    def value(w: Workspace, rows: Integers) -> float:
        values = getattr(w, name)[rows] if column is None else getattr(w, name)[rows, column]
        known = values[np.isfinite(values)]
        return scale * float(choose(known)) if len(known) else np.nan

    return value


LOST = Quantity(
    "lost",
    "poses that the nominal model reaches and the corrected machine does not, share of a cell's",
    "lost",
    _share("lost_in", "believed"),
    [("%", 1.0)],
)
GAINED = Quantity(
    "gained",
    "poses that the corrected machine reaches and the nominal model does not, share of a cell's",
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


def workspace_map_quantity_of_axis_margin(unit: str) -> Quantity:
    """Workspace map's quantity of the axis margin.

    The greatest margin to the nearest axis limit in each cell.
    unit : of an axis, m or rad
    """
    scale, shown = PLOT_UNITS.get(unit, (1.0, unit))
    return Quantity(
        "room",
        "margin to the nearest limit of an axis, the greatest there",
        "gained",
        _end("room", np.max, scale),
        [(shown, 1.0)],
    )


def _cell_number_text(value: float) -> str:
    """A number as it stands in a cell: to whole ones, below ten to tenths."""
    return f"{value:.0f}" if abs(value) >= 9.95 or value == 0 else f"{value:.1f}"


def workspace_cell_views_unit_and_svg(workspace: Workspace, quantity: Quantity) -> tuple[str, str]:
    """Views (unit, SVG) of a quantity over the workspace cells.

    From above (x, y) and from the side (x, z).
    """
    parts, height = [], 0.0
    span = workspace.index.max(axis=0) + 1
    planes = [
        (across, up, *_columns(workspace, quantity, across, up))
        for across, up in (((0, 1),) if workspace.flat else ((0, 1), (0, 2)))
    ]
    greatest = max((float(np.nanmax(found, initial=0.0)) for *_, found in planes))
    unit, per = next((one for one in quantity.units if greatest / one[1] < 999.5), quantity.units[-1])
    for across, up, columns, found in planes:
        scale = min(WIDE / span[across], TALL / span[up])
        base = height + 20 + scale * span[up]
        top = np.nanmax(found, initial=1e-300)
        for (i, j), value in zip(columns.tolist(), found.tolist()):
            box = (LEFT + scale * i, base - scale * (j + 1), scale, scale)
            opacity = 0.0 if value != value else 0.75 * max(value, 0.0) / top
            cell_text = _cell_number_text(value / per) if value == value else ""
            parts.append(
                f'<rect class="cell {quantity.style}" fill-opacity="{opacity:.2f}" x="{box[0]:.1f}" '
                f'y="{box[1]:.1f}" width="{scale:.1f}" '
                f'height="{scale:.1f}">{svg_tooltip(f"{cell_text} {unit}") if cell_text else ""}</rect>'
            )
            parts.append(svg_text_or_empty_if_too_large(box, cell_text, "small"))
        corner = [
            (workspace.origin[axis] * 1e3, (workspace.origin[axis] + span[axis] * workspace.size) * 1e3)
            for axis in (across, up)
        ]
        parts += [
            svg_text(LEFT, height + 14, f"{'xyz'[up]} up, {corner[1][0]:.0f} to {corner[1][1]:.0f} mm"),
            svg_text(LEFT, base + 15, f"{'xyz'[across]} to the right, {corner[0][0]:.0f} to {corner[0][1]:.0f} mm"),
        ]
        height = base + 26
    return unit, svg_figure(int(height) + 4, f"{quantity.title}, {unit}", parts)


def _columns(w: Workspace, q: Quantity, across: int, up: int) -> tuple[Integers, Floats]:
    """(Indices (c, 2) along two axes of cells seen one behind the other, the Quantity of each (c,))."""
    columns, at = np.unique(w.index[:, [across, up]], axis=0, return_inverse=True)
    return columns, np.array([q.value(w, np.flatnonzero(at.ravel() == k)) for k in range(len(columns))])


def _titled_cells_html(workspace: Workspace, quantity: Quantity) -> list[str]:
    """HTML of a Quantity over the cells, with its name and what it is."""
    unit, drawn = workspace_cell_views_unit_and_svg(workspace, quantity)
    return [
        heading_html(quantity.name.capitalize(), 3),
        note_html(f"{quantity.title[0].upper()}{quantity.title[1:]}, {unit}"),
        drawn,
    ]


def workspace_section_html(workspace: Workspace | None, unit: str) -> list[str]:
    """HTML of the workspace section of a calibration's page.

    Empty without a workspace.
    unit : of an axis, m or rad.
    """
    if workspace is None:
        return []
    quantities = (LOST, GAINED, POSITION) if workspace.lost is not None else (POSITION,)
    maps = ("<div>" + "".join(_titled_cells_html(workspace, q)) + "</div>" for q in quantities)
    return [
        heading_html("The workspace"),
        figures_with_caption_html(
            figures_side_by_side_html(*maps),
            (
                "Cells of the workspace, seen from above and from the side; each map states its unit. Darker is more. "
                "Good: pale and even. Bad: dark cells where the machine is used."
            ),
        ),
        *(paragraph_html(f"{line}.") for line in workspace_lines(workspace, unit)),
    ]


NEAR_SINGULAR = 0.02  # of the greatest singular value, below which a place is near a singularity


def write_workspace_page(
    path: Path | str,
    name: str,
    workspace: Workspace,
    unit: str,
    margin_description: str,
    certified: Floats | None = None,
    links: Sequence[Link] = (),
) -> None:
    """Write the HTML page of a workspace.

    name : of the calibration; unit : of an axis, m or rad
    certified : (c, 2) m and rad that a certificate promises in each cell, NaN where none does, or None without one
    """
    quantities = [
        *((LOST, GAINED) if workspace.lost is not None else ()),
        POSITION,
        *((ROTATION,) if workspace.turns else ()),
        workspace_map_quantity_of_axis_margin(unit),
        SINGULAR,
    ]
    first, *rest = workspace_lines(workspace, unit)
    parts = [
        figures_with_caption_html(
            figures_side_by_side_html(
                *("<div>" + "".join(_titled_cells_html(workspace, q)) + "</div>" for q in quantities)
            ),
            f"Cells of {workspace.size * 1e3:.3g} mm, projected. Poses: all configurations of "
            "the strokes, all axes free of each "
            f"other; what depends on history, temperature and load is not in it. Room: of {margin_description}. Each "
            "map states its unit; darker is more. Good: no lost cell, and an even uncertainty. Bad: dark cells where "
            "the machine is used.",
        ),
        *(paragraph_html(f"{line}.") for line in rest),
    ]
    if certified is not None:
        known = np.flatnonzero(np.isfinite(certified[:, 0]))
        rows = [
            (
                *(f"{value * 1e3:.0f}" for value in workspace.centre[k]),
                f"{certified[k, 0] * 1e6:.1f}",
                "" if np.isnan(certified[k, 1]) else f"{certified[k, 1] * 1e6:.1f}",
                f"{workspace.bound[k, 0] * 1e6:.1f}",
            )
            for k in known
        ]
        parts += [
            heading_html("Certified bounds"),
            note_html(
                "From poses held out, in the cells whose centre lies in its volume; next to it the "
                "bound from the covariance of the calibration."
            ),
            table_html(("x, mm", "y, mm", "z, mm", "position, um", "rotation, urad", "bound, um"), rows),
        ]
    write_page(
        path,
        Page(
            "workspace",
            f"Workspace of {name}",
            workspace_verdict(workspace, first.removeprefix("workspace: ")),
            parts,
            _recommended_actions(workspace),
            links,
        ),
    )


def workspace_verdict(workspace: Workspace, summary: str) -> Verdict:
    """Verdict on a workspace.
    summary : what it comes to, in words
    """
    missing = [MissingEvidence("it comes near a singularity")] if np.nanmin(workspace.singular) < NEAR_SINGULAR else []
    missing += [MissingEvidence("poses are lost")] if workspace.lost else []
    return judge_evidence(Evidence(summary, missing=tuple(missing)))


def _recommended_actions(workspace: Workspace) -> list[str]:
    """What an owner does next with a map of the workspace."""
    lost = (
        ["Avoid wanted poses in cells where some are lost: `rig correct` refuses those that the machine cannot reach"]
        if workspace.lost
        else []
    )
    return [
        *lost,
        "Record more poses where the bound is greatest: `rig plan RIG.toml --for parameters --calibration "
        "calibration.json --out plan.csv`",
    ]
