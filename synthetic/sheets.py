"""Cube nets and loose markers as sheets to print, true to scale, with a ruler on each (PDF by matplotlib)."""

import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from rig.design import Design, Marker, Target
from rig.errors import RigError
from rig.files import write_bytes
from vision.targets import marker_cells

PAPER = {"A4": (210, 297), "A3": (297, 420), "A2": (420, 594), "A1": (594, 841), "A0": (841, 1189)}  # mm
MARGIN, FOOT = 10.0, 22.0  # mm, at the edge of the sheet; below the net, for the ruler
TAB = 0.14  # of the edge, flaps to glue
# where each face lies in the net, in edges: the four sides from left to right with their tops (+z) up, +z above -y, whose right
# is its right (+x), and -z below +y, whose right (-x) is its right
NET = {"+x": (0, 1), "+y": (1, 1), "-x": (2, 1), "-y": (3, 1), "+z": (3, 2), "-z": (1, 0)}


def sheets(design: Design, path: str | Path, paper: str = "A4") -> list[str]:
    """Write a PDF with one sheet per target; returns a line of text for each.

    design : Design; paper : the smallest size to use. A net or a marker that is too large for it takes the next size. Raises
    RigError for an unknown paper, a target too large for A0, or a design without targets
    """
    if paper not in PAPER:
        raise RigError(f"--paper takes {', '.join(PAPER)}, not {paper!r}")
    if not design.targets:
        raise RigError("the rig has no targets to print")
    said = []
    buffer = io.BytesIO()
    with PdfPages(buffer) as pdf:
        for target in design.targets:
            for label, width, height, draw in _pages(target):
                name, page = _fitting(label, width, height, list(PAPER)[list(PAPER).index(paper) :])
                figure = Figure(figsize=(page[0] / 25.4, page[1] / 25.4))
                axes = figure.add_axes((0, 0, 1, 1))
                axes.set(xlim=(0, page[0]), ylim=(0, page[1]))
                axes.axis("off")
                draw(axes, (page[0] - width) / 2, FOOT + MARGIN + (page[1] - FOOT - 2 * MARGIN - height) / 2)
                _ruler(axes, page, label)
                pdf.savefig(figure)
                said.append(f"{label}: {name} {'landscape' if page[0] > page[1] else 'portrait'}")
    write_bytes(path, buffer.getvalue())
    return said


def _pages(target: Target) -> Iterator[Any]:
    if target.edge is not None and target.marker is not None:
        edge, side = target.edge * 1e3, target.marker * 1e3
        flap = TAB * edge
        yield (f"target {target.name}: cube of edge {edge:g} mm, markers {side:g} mm, {target.dictionary}",
               4 * edge + 2 * flap, 3 * edge + 2 * flap, lambda axes, x, y: _net(axes, x + flap, y + flap, target, (edge, side, flap)))
    for marker in target.listed:
        size = (marker.side + 2 * marker.margin) * 1e3
        yield (f"target {target.name}: marker {marker.id}, {marker.side * 1e3:g} mm, {target.dictionary}", size, size,
               lambda axes, x, y, marker=marker, size=size: _loose(axes, x, y, target, marker, size))


def _fitting(label: str, width: float, height: float, names: Iterable[str]) -> tuple[str, tuple[float, float]]:
    for name in names:
        for page in (PAPER[name], PAPER[name][::-1]):
            if width <= page[0] - 2 * MARGIN and height <= page[1] - 2 * MARGIN - FOOT:
                return name, page
    raise RigError(f"{label} is {width:.0f} x {height:.0f} mm on the sheet, too large for A0")


def _net(axes: Axes, x: float, y: float, target: Target, sizes: tuple[float, float, float]) -> None:
    """A cube's net from x, y; sizes : mm, of its edge, its markers' side and the flaps"""
    edge, marker, flap = sizes
    ids = dict(target.faces)
    cells = {place: face for face, place in NET.items()}
    for (i, j), face in cells.items():
        corner = np.array([x + i * edge, y + j * edge])
        axes.add_patch(Rectangle((corner[0], corner[1]), edge, edge, fill=False, lw=0.3, ec="0.6"))
        if face in ids:
            _marker(axes, corner + edge / 2, marker, target.dictionary, ids[face])
        axes.text(corner[0] + 0.03 * edge, corner[1] + 0.02 * edge, f"{target.name} {face}" + (f" id {ids[face]}" if face in ids else ""),
                  fontsize=max(3, min(7, edge / 9)), color="0.55", va="bottom")
    for i, j, side in ((0, 1, "l"), (0, 1, "t"), (1, 1, "t"), (2, 1, "t"), (0, 1, "b"), (2, 1, "b"), (3, 1, "b"), (3, 2, "t")):
        _flap(axes, np.array([x + i * edge, y + j * edge]), edge, flap, side)


def _flap(axes: Axes, corner: np.ndarray, edge: float, flap: float, side: str) -> None:
    first, second, away = {"l": ((0, 1), (0, 0), (-1, 0)), "t": ((1, 1), (0, 1), (0, 1)), "b": ((0, 0), (1, 0), (0, -1))}[side]
    a, b, out = corner + edge * np.array(first), corner + edge * np.array(second), flap * np.array(away)
    inward = flap * (b - a) / edge
    axes.add_patch(Polygon([a, a + out + inward, b + out - inward, b], closed=True, fill=False, lw=0.3, ec="0.7", ls=":"))


def _loose(axes: Axes, x: float, y: float, target: Target, marker: Marker, size: float) -> None:
    axes.add_patch(Rectangle((x, y), size, size, fill=False, lw=0.3, ec="0.6"))
    _marker(axes, np.array([x + size / 2, y + size / 2]), marker.side * 1e3, target.dictionary, marker.id)


def _marker(axes: Axes, middle: np.ndarray, side: float, dictionary: str, number: int) -> None:
    """Black square with its white cells, as vector shapes: one black square, so that no hairlines show between cells."""
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
                axes.add_patch(Rectangle((left + column * step, top - (row + 1) * step), run * step, step, fc="white", ec="none"))
            column += run + 1


def _ruler(axes: Axes, page: tuple[float, float], label: str) -> None:
    """A ruler of whole centimetres along the foot of the sheet."""
    length = min(100, 10 * int((page[0] - 2 * MARGIN) // 10))
    for mm in range(length + 1):
        tall = 5 if mm % 10 == 0 else 3.5 if mm % 5 == 0 else 2
        axes.plot([MARGIN + mm] * 2, [MARGIN, MARGIN + tall], color="black", lw=0.3)
    axes.plot([MARGIN, MARGIN + length], [MARGIN, MARGIN], color="black", lw=0.3)
    axes.text(MARGIN, MARGIN + 6.5, f"{label}.  The ruler is {length} mm long when printed at 100 %; if not, the markers are off by as much.",
              fontsize=7)
