"""Sheets to print, true to scale.

Cube nets and loose markers with rulers and a legend (PDF).
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.output_files import write_bytes
from rig.model.calibration_board_layout_and_description_parsing import Board
from rig.model.design import Design, Target
from synthetic.cube_nets_stl_rulers_and_assembly_page import (
    FOOT,
    LEFT,
    MARGIN,
    NET,
    SIDES,
    Piece,
    Placed,
    Size,
    arrange_cube_net_on_sheets,
    cube_stl_bytes_by_target,
    cut_line_matplotlib_style,
    draw_cube_assembly_page,
    draw_rulers_and_legend,
    fold_line_matplotlib_style,
    printable_paper_area,
)
from vision.marker_corner_prediction import marker_cells

PAPER = {
    "A4": (210.0, 297.0),
    "Letter": (215.9, 279.4),
    "A3": (297.0, 420.0),
    "Tabloid": (279.4, 431.8),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}  # mm


class Loose(NamedTuple):
    """A marker by itself, its lower left corner at x, y mm. side, size : mm, of the black square and of what is cut
    out
    """

    number: int
    side: float
    size: float
    x: float
    y: float


class Page(NamedTuple):
    """One sheet of a target. label : what stands on it; paper : (width, height) mm as it lies; size : of a net's faces,
    None for loose markers
    """

    target: Target
    label: str
    paper: tuple[float, float]
    size: Size | None
    placed: tuple[Placed, ...]
    loose: tuple[Loose, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PrintSheets:
    """Sheets of a design as written. design; lines : a text on each sheet, in their order"""

    design: Design
    lines: tuple[str, ...]

    def write_bodies(self, folder: Path, paper_thickness: float) -> int:
        """Write a binary STL file for each cube of the design, smaller by the paper (m) on each side; returns how many.

        Raises RigError where there is no cube, or nothing is left of one
        """
        found = cube_stl_bytes_by_target(self.design, paper_thickness)
        for name, data in found.items():
            write_bytes(folder / f"{name}.stl", data)
        return len(found)


def write_sheets(design: Design, path: str | Path, paper: str = "A4") -> PrintSheets:
    """Write a PDF with the sheets of all targets of a design and the assembly page.

    Raises RigError for an unknown paper, a face or a marker too large for it, or a design without targets
    """
    if paper not in PAPER:
        raise RigError(f"--paper takes {', '.join(PAPER)}, not {paper!r}")
    if not design.targets:
        raise RigError("the rig has no targets to print")
    pages = [page for target in design.targets for page in sheets_of_target(target, paper)]
    buffer = io.BytesIO()
    with PdfPages(buffer) as pdf:
        for page in pages:
            figure, axes = blank_sheet_figure_and_axes(page.paper)
            draw_sheet(axes, page)
            pdf.savefig(figure)
        figure, axes = blank_sheet_figure_and_axes(PAPER[paper])
        draw_cube_assembly_page(axes, design, PAPER[paper], len(pages))
        pdf.savefig(figure)
    write_bytes(path, buffer.getvalue())
    ways = [f"{page.label}: {paper} {'landscape' if page.paper[0] > page.paper[1] else 'portrait'}" for page in pages]
    return PrintSheets(design, (*ways, f"assembly: {paper} portrait"))


def sheets_of_target(target: Target, paper: str) -> list[Page]:
    """Sheets of a target on paper of one size.

    Raises RigError for a face or marker that is too large.
    """
    if target.board is not None:
        return [_of_board(target, target.board, paper)]
    return [*_of_net(target, paper), *_of_loose(target, paper)]


def blank_sheet_figure_and_axes(paper: tuple[float, float]) -> tuple[Figure, Axes]:
    """Blank sheet: (Figure, Axes in mm from the lower left corner).

    paper : (width, height) mm
    """
    figure = Figure(figsize=(paper[0] / 25.4, paper[1] / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, paper[0]), ylim=(0, paper[1]))
    axes.axis("off")
    return figure, axes


def draw_sheet(axes: Axes, page: Page) -> None:
    """Draw a sheet of nets or markers."""
    for one in page.placed:
        assert page.size is not None
        _piece(axes, np.array([LEFT + one.x, MARGIN + FOOT + one.y]), page.target, one.piece, page.size)
    if page.loose and page.target.board is not None:
        _draw_board_outline_and_black_squares(axes, page, page.target.board)
    for marker in page.loose:
        corner = np.array([LEFT + marker.x, MARGIN + FOOT + marker.y])
        if page.target.board is None:
            axes.add_patch(Rectangle((corner[0], corner[1]), marker.size, marker.size, fill=False, ec="black", lw=0.5))
        _marker(axes, corner + marker.size / 2, marker.side, page.target.dictionary, marker.number)
    draw_rulers_and_legend(axes, page.paper, page.label)


def _of_net(target: Target, paper: str) -> Iterator[Page]:
    if target.edge is None or target.marker is None:
        return
    edge, side = target.edge * 1e3, target.marker * 1e3
    try:
        size, found = arrange_cube_net_on_sheets(
            edge, printable_paper_area(PAPER[paper]), printable_paper_area(PAPER[paper][::-1])
        )
    except RigError as error:
        raise RigError(f"target {target.name}: {error}{_larger(edge, paper)}") from None
    for k, sheet in enumerate(found):
        label = (
            f"target {target.name}: cube of edge {edge:g} mm, markers {side:g} mm, {target.dictionary}, sheet "
            f"{k + 1} of {len(found)}"
        )
        loose = "" if size.flap else "; no flaps: glue the faces on a body"
        yield Page(target, label + loose, PAPER[paper][::-1] if sheet.turned else PAPER[paper], size, sheet.placed, ())


def _of_loose(target: Target, paper: str) -> Iterator[Page]:
    for marker in target.listed:
        size, room = (marker.side + 2 * marker.margin) * 1e3, printable_paper_area(PAPER[paper])
        if size > min(room):
            raise RigError(
                f"target {target.name}: marker {marker.id} is {size:.4g} mm with its white margin, larger "
                f"than the {room[0]:.0f} x "
                f"{room[1]:.0f} mm that can be printed on{_larger(size, paper)}"
            )
        label = f"target {target.name}: marker {marker.id}, {marker.side * 1e3:g} mm, {target.dictionary}"
        yield Page(
            target,
            label,
            PAPER[paper],
            None,
            (),
            (Loose(marker.id, marker.side * 1e3, size, (room[0] - size) / 2, (room[1] - size) / 2),),
        )


def _of_board(target: Target, board: Board, paper: str) -> Page:
    """The one sheet of a board, its margin about it, in the middle of the paper as it lies."""
    size = (np.array(board.size) + 2 * board.margin) * 1e3
    lying = [PAPER[paper], PAPER[paper][::-1]]
    fits = [one for one in lying if (size <= printable_paper_area(one)).all()]
    if not fits:
        raise RigError(
            f"target {target.name}: the board is {size[0]:.4g} x {size[1]:.4g} mm with its white margin, larger than "
            f"can be printed on {paper}{_larger(float(size.max()), paper)}"
        )
    label = (
        f"target {target.name}: {board.kind} board {board.columns}x{board.rows}, markers {board.side * 1e3:g} mm, "
        f"{board.pitch * 1e3:g} mm apart, {board.dictionary}, first {target.listed[0].id}"
    )
    cell = (board.side + 2 * board.margin) * 1e3
    corners = _on_sheet(board, board.places(), fits[0]) - cell / 2
    loose = [Loose(marker.id, board.side * 1e3, cell, *corner) for marker, corner in zip(target.listed, corners)]
    return Page(target, label, fits[0], None, (), tuple(loose))


def _on_sheet(board: Board, places: Floats, paper: tuple[float, float]) -> Floats:
    """Places (n, 2) m of a board in mm from the lower left of a sheet's usable area; the board is in its middle."""
    middle = (np.array(printable_paper_area(paper)) - np.array(board.size) * 1e3) / 2
    return board.in_board_frame(places)[:, :2] * 1e3 + middle


def _draw_board_outline_and_black_squares(axes: Axes, page: Page, board: Board) -> None:
    origin, side = np.array([LEFT, MARGIN + FOOT]), board.pitch * 1e3
    outline = np.array([[0.0, board.size[1]]]) + board.margin * np.array([[-1, 1]])
    low, (width, height) = _on_sheet(board, outline, page.paper)[0] + origin, np.array(board.size) + 2 * board.margin
    axes.add_patch(Rectangle((low[0], low[1]), width * 1e3, height * 1e3, fill=False, ec="black", lw=0.5))
    for x, y in _on_sheet(board, board.black_squares(), page.paper) + origin - side / 2:
        axes.add_patch(Rectangle((x, y), side, side, fc="black", ec="none"))


def _larger(size: float, paper: str) -> str:
    """Which paper would do for what is `size` mm wide and high, as the end of a sentence."""
    fits = [name for name, sides in PAPER.items() if size <= min(printable_paper_area(sides))]
    return f"; it fits --paper {fits[0]}" if fits else "; no paper is large enough"


def _piece(axes: Axes, origin: Floats, target: Target, piece: Piece, size: Size) -> None:
    """A piece of a cube's net. origin : (2,) mm, of the net's coordinates; target : a cube"""
    ids, edge = dict(target.faces), size.edge
    for face in piece.faces:
        corner = origin + edge * np.array(NET[face])
        if face in ids and target.marker is not None:
            _marker(axes, corner + edge / 2, target.marker * 1e3, target.dictionary, ids[face])
        axes.text(
            corner[0] + 0.03 * edge,
            corner[1] + 0.02 * edge,
            f"{target.name} {face}" + (f" id {ids[face]}" if face in ids else ""),
            fontsize=max(3, min(7, edge / 9)),
            color="0.55",
            va="bottom",
        )
        for side in SIDES:
            a, b = _side(corner, edge, side)
            if (face, side) in piece.flaps:
                _flap(axes, a, b, size.flap * np.array(SIDES[side]))
            elif (face, side) in piece.folds:
                axes.plot(*zip(a, b), **fold_line_matplotlib_style())
            elif tuple(np.add(NET[face], SIDES[side])) not in {NET[other] for other in piece.faces}:
                axes.plot(*zip(a, b), **cut_line_matplotlib_style())


def _side(corner: Floats, edge: float, side: str) -> tuple[Floats, Floats]:
    """The two ends (2,) mm of a face's side, the face's lower left corner (2,) mm given."""
    first, second = {"l": ((0, 1), (0, 0)), "t": ((1, 1), (0, 1)), "b": ((0, 0), (1, 0)), "r": ((1, 0), (1, 1))}[side]
    return corner + edge * np.array(first), corner + edge * np.array(second)


def _flap(axes: Axes, a: Floats, b: Floats, out: Floats) -> None:
    """A flap to glue on the side from a to b (2,) mm, that reaches out (2,) mm: folded at the side, cut around."""
    inward = np.linalg.norm(out) * (b - a) / np.linalg.norm(b - a)
    ends = [a, a + out + inward, b + out - inward, b]
    axes.add_patch(Polygon(ends, closed=True, fc="0.93", ec="none", zorder=0.5))
    axes.plot(*zip(*ends), **cut_line_matplotlib_style())
    axes.plot(*zip(a, b), **fold_line_matplotlib_style())


def _marker(axes: Axes, middle: Floats, side: float, dictionary: str, number: int) -> None:
    """Black square with its white cells, as vector shapes: one black square, so that no hairlines show between
    cells.
    """
    cells = marker_cells(dictionary, number)[1:-1, 1:-1]
    n = len(cells)
    step = side / n
    left, top = middle + np.array([-side / 2, side / 2])
    axes.add_patch(Rectangle((left, top - side), side, side, fc="black", ec="none"))
    for row in range(n):
        column = 0
        while column < n:
            run = 0
            while column + run < n and cells[row, column + run] > 0.5:
                run += 1
            if run:
                axes.add_patch(
                    Rectangle((left + column * step, top - (row + 1) * step), run * step, step, fc="white", ec="none")
                )
            column += run + 1
