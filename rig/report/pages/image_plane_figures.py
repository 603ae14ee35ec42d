"""Figures of the image plane: arrows, outlines, dots, and grid cells shaded by value."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rig.arrays import Floats
from rig.report.pages.svg_elements import TEXT, WIDTH, escape_html, svg_figure, svg_text, tooltip

TOP = TEXT + 11.0
Placed = Callable[[Floats], Floats]  # (n, 2) of the plane -> (n, 2) of the figure
MOST = 3000  # arrows that are drawn: of more, evenly chosen ones
MARKED = 0.25  # of a diagonal, drawn from an outline's first corner
FEWEST = 5  # values of a patch that is drawn


@dataclass(frozen=True, slots=True, eq=False)
class Arrows:
    """at : (n, 2) in the plane's own units; by : (n, 2) values in `unit`, drawn so many times `enlarged`; colour : as
    of a figure's Series
    """

    at: Floats
    by: Floats
    enlarged: float
    unit: str
    colour: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """centre : (n, 2) of square cells of `size`, both in the plane's own units; values : (n,) in `unit`, shown by their
    shade
    """

    centre: Floats
    values: Floats
    size: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """corners : (n, 4, 2) of outlines, in the plane's own units, the first of which is marked; colour : as of a
    figure's Series, -1 for grey
    """

    corners: Floats
    colour: int = -1


def image_plane_figure(
    title: str,
    caption: str,
    size: tuple[float, float],
    layers: Sequence[Arrows | Cells | Quads],
    dots: Floats | None = None,
) -> str:
    """Figure of the image plane with layers. caption : below; size : (width, height) px; dots : (n, 2) px, or None"""
    width, height = size
    scale = (WIDTH - 8) / width
    tall = scale * height
    parts = [
        svg_text(4, 14, title, style="name"),
        f'<rect class="frame" x="4" y="{TOP:.1f}" width="{WIDTH - 8}" height="{tall:.1f}"/>',
    ]

    def placed(points: Floats) -> Floats:
        return points * scale + [4 + scale / 2, TOP + scale / 2]

    for layer in layers:
        if isinstance(layer, Cells):
            parts += _cells(layer, placed, scale, TOP + tall)
        else:
            parts.append(_quads(layer, placed) if isinstance(layer, Quads) else _arrows(layer, placed, scale))
    if dots is not None and len(dots):
        d = "".join(f"M{a:.1f} {b:.1f}h.01" for a, b in placed(dots[:: -(-len(dots) // MOST)]).tolist())
        parts.append(f'<path class="specks" d="{d}"/>')
    parts.append(svg_text(4, TOP + tall + 17, caption))
    return svg_figure(int(TOP + tall + 24), f"{title}: {caption}", parts)


def patch_means(uv: Floats, values: Floats, cell: float) -> tuple[Floats, Floats]:
    """Patch means (centres (c, 2), means (c, k)) of values (n, k) at uv (n, 2) >= 0. cell : a square's side, as uv"""
    keys, index, count = np.unique((uv // cell).astype(int) @ [1, 1000], return_inverse=True, return_counts=True)
    centre = np.stack([keys % 1000, keys // 1000], axis=1) * cell + cell / 2
    total = np.zeros((len(keys), values.shape[1]))
    np.add.at(total, index, values)
    enough = count >= FEWEST
    return centre[enough], total[enough] / count[enough, None]


def _cells(cells: Cells, placed: Placed, scale: float, below: float) -> list[str]:
    """Squares, as much of them as lies within the frame, which ends so far below."""
    greatest = float(np.nanmax(cells.values, initial=1e-300))
    at, half = placed(cells.centre), cells.size * scale / 2
    ends = np.clip(np.hstack([at - half, at + half]), [4, TOP, 4, TOP], [WIDTH - 4, below, WIDTH - 4, below])
    return [
        f'<rect class="shade" fill-opacity="{0.08 + 0.72 * max(value, 0.0) / greatest:.2f}" x="{left:.1f}" '
        f'y="{top:.1f}" '
        f'width="{right - left:.1f}" height="{bottom - top:.1f}">{tooltip(f"{value:.4g} {cells.unit}")}</rect>'
        for (left, top, right, bottom), value in zip(ends.tolist(), cells.values.tolist())
        if value == value
    ]


def _arrows(arrows: Arrows, placed: Placed, scale: float) -> str:
    every = max(-(-len(arrows.at) // MOST), 1)
    at, by = placed(arrows.at[::every]), arrows.by[::every] * arrows.enlarged * scale
    d = "".join(f"M{x:.1f} {y:.1f}l{u:.1f} {v:.1f}" for (x, y), (u, v) in zip(at.tolist(), by.tolist()))
    return (
        f'<path class="arrows c{arrows.colour} valued" data-unit="{escape_html(arrows.unit)}" '
        f'data-enlarged="{arrows.enlarged * scale:.6g}" '
        f'd="{d}"/>'
    )


def _quads(quads: Quads, placed: Placed) -> str:
    inward = quads.corners[:, :1] + MARKED * (quads.corners[:, 2:3] - quads.corners[:, :1])
    d = "".join(
        "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in corners) + f"ZL{x:.1f} {y:.1f}"
        for *corners, (x, y) in placed(np.concatenate([quads.corners, inward], axis=1)).tolist()
    )
    return f'<path class="line {"grey" if quads.colour < 0 else f"c{quads.colour}"}" d="{d}"/>'
