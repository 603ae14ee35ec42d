"""Cube nets in paper, and STL bodies.

Nets in pieces that fit a sheet, and bodies to print or mill.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.design import Design

# where each face lies in the net, in edges: the four sides from left to right with their tops (+z) up, +z above -y,
# whose right
# is its right (+x), and -z below +y, whose right (-x) is its right
NET = {"+x": (0, 1), "+y": (1, 1), "-x": (2, 1), "-y": (3, 1), "+z": (3, 2), "-z": (1, 0)}
# outward normal, right and up of each face as it lies in the net
FRAMES = {
    "+x": ("+x", "+y", "+z"),
    "+y": ("+y", "-x", "+z"),
    "-x": ("-x", "-y", "+z"),
    "-y": ("-y", "+x", "+z"),
    "+z": ("+z", "+x", "+y"),
    "-z": ("-z", "-x", "+y"),
}
PARTITIONS = (
    (("+x", "+y", "-x", "-y", "+z", "-z"),),
    (("+x", "+y", "-z"), ("-x", "-y", "+z")),
    (("+y", "-z"), ("-y", "+z"), ("+x",), ("-x",)),
    (("+x",), ("+y",), ("-x",), ("-y",), ("+z",), ("-z",)),
)
SIDES = {
    "l": (-1, 0),
    "t": (0, 1),
    "b": (0, -1),
    "r": (1, 0),
}  # of a face in the net; flaps sit by preference on the first
TAB, WIDEST = 0.14, 12.0  # flaps: of the edge; mm
GAP = 4.0  # mm between pieces


class Size(NamedTuple):
    """edge : mm; flap : mm, 0 where there are none"""

    edge: float
    flap: float


@dataclass(frozen=True, slots=True)
class Piece:
    """faces : names; flaps : (face, side) pairs; folds : (face, side) pairs where the next face hangs on, each once."""

    faces: tuple[str, ...]
    flaps: tuple[tuple[str, str], ...]
    folds: tuple[tuple[str, str], ...]

    def box(self, size: Size) -> tuple[float, float, float, float]:
        """(left, bottom, right, top) mm of what is cut out, in the net's own coordinates."""
        ends = [
            size.edge * np.array(NET[face]) + size.edge * np.array(corner)
            for face in self.faces
            for corner in ((0, 0), (1, 1))
        ]
        ends += [
            size.edge * (np.array(NET[face]) + 0.5) + (size.edge / 2 + size.flap) * np.array(SIDES[side])
            for face, side in self.flaps
        ]
        return (*np.min(ends, axis=0), *np.max(ends, axis=0))


class Placed(NamedTuple):
    """A piece on a sheet, its net's origin at x, y mm of the sheet's usable part."""

    piece: Piece
    x: float
    y: float


class Sheet(NamedTuple):
    """turned : whether it lies on its side (landscape)"""

    turned: bool
    placed: tuple[Placed, ...]


def net_pieces(groups: Sequence[Sequence[str]], flaps: bool = True) -> tuple[Piece, ...]:
    """Pieces of a net cut into groups of faces, with flaps to glue where faces are apart."""
    of = {face: k for k, group in enumerate(groups) for face in group}
    folds: list[list[tuple[str, str]]] = [[] for _ in groups]
    tabs: list[list[tuple[str, str]]] = [[] for _ in groups]
    meeting: dict[frozenset[tuple[float, ...]], list[tuple[str, str]]] = {}
    for face in NET:
        for side in SIDES:
            meeting.setdefault(_ends(face, side), []).append((face, side))
    for first, second in meeting.values():
        hang = np.array_equal(np.add(NET[first[0]], SIDES[first[1]]), NET[second[0]]) and of[first[0]] == of[second[0]]
        if hang:
            folds[of[first[0]]].append(first)
        elif flaps:
            face, side = min((first, second), key=lambda one: (one[0].endswith("z"), list(SIDES).index(one[1]), one[0]))
            tabs[of[face]].append((face, side))
    return tuple(Piece(tuple(group), tuple(tabs[k]), tuple(folds[k])) for k, group in enumerate(groups))


def arrange_net(
    edge: float, upright_area: tuple[float, float], sideways_area: tuple[float, float]
) -> tuple[Size, tuple[Sheet, ...]]:
    """Arrangement of a cube's net on the fewest sheets, in the fewest pieces.

    edge : mm
    upright_area, sideways_area : (width, height) mm of a sheet that stands upright, and on its side

    Faces too large for their flaps come without, to be glued on a body. Raises RigError for a face larger than the
    sheet
    """
    best = None
    for flap in (min(TAB * edge, WIDEST), 0.0):
        size = Size(edge, flap)
        for groups in PARTITIONS if flap else PARTITIONS[-1:]:
            sheets = _packed(net_pieces(groups, flap > 0), size, (upright_area, sideways_area))
            if sheets is not None and (best is None or len(sheets) < len(best[1])):
                best = size, sheets
        if best is not None:
            return best
    raise RigError(
        f"a face of {edge:.4g} mm is larger than the {upright_area[0]:.0f} x {upright_area[1]:.0f} mm that "
        "can be printed on"
    )


def _packed(
    found: Sequence[Piece], size: Size, rooms: tuple[tuple[float, float], tuple[float, float]]
) -> tuple[Sheet, ...] | None:
    """Sheets filled in turn, each lying as it takes more of what is left; None where a piece fits neither way."""
    left, sheets = list(found), []
    while left:
        upright, turned = (_filled(left, size, room) for room in rooms)
        placed = turned if len(turned) > len(upright) else upright
        if not placed:
            return None
        sheets.append(Sheet(placed is turned, placed))
        taken = {one.piece for one in placed}
        left = [piece for piece in left if piece not in taken]
    return tuple(sheets)


def _filled(left: Sequence[Piece], size: Size, usable: tuple[float, float]) -> tuple[Placed, ...]:
    """The first of the pieces that fit one sheet, in rows from its bottom."""
    placed: list[Placed] = []
    x = y = tall = 0.0
    for piece in left:
        x0, y0, x1, y1 = piece.box(size)
        wide, high = x1 - x0, y1 - y0
        if placed and x + wide > usable[0]:
            x, y, tall = 0.0, y + tall + GAP, 0.0
        if x + wide > usable[0] or y + high > usable[1]:
            break
        placed.append(Placed(piece, x - x0, y - y0))
        x, tall = x + wide + GAP, max(tall, high)
    return tuple(placed)


def _ends(face: str, side: str) -> frozenset[tuple[float, ...]]:
    """The two corners of a cube of edge 2 between which a side of a face lies."""
    normal, right, up = (_axis(name) for name in FRAMES[face])
    dx, dy = SIDES[side]
    middle, along = normal + dx * right + dy * up, up if dx else right
    return frozenset(tuple((middle + s * along).tolist()) for s in (-1.0, 1.0))


def _axis(name: str) -> Floats:
    """(3,) unit vector of "+x" and the like."""
    return (1.0 if name[0] == "+" else -1.0) * np.eye(3)["xyz".index(name[1])]


def cube_stl_files(design: Design, paper_thickness: float) -> dict[str, bytes]:
    """Binary STL files {target's name: bytes} of the design's cubes.

    Smaller by the paper glued around them.
    Raises RigError where there is no cube, or nothing is left of one
    """
    import trimesh

    found = {}
    for target in design.targets:
        if target.edge is None:
            continue
        edge = target.edge - 2 * paper_thickness
        if not 0 <= paper_thickness < target.edge / 2:
            raise RigError(
                f"target {target.name}: nothing of its {target.edge * 1e3:g} mm is left between sheets of "
                f"{paper_thickness * 1e3:g} mm"
            )
        found[target.name] = trimesh.creation.box(extents=np.full(3, edge * 1e3)).export(file_type="stl")
    if not found:
        raise RigError("the rig has no cubes; loose markers have no body to print")
    return found
