"""Cube nets and STL bodies, rulers of printed sheets, and the assembly page.

Nets come in pieces that fit a sheet; bodies are to print or mill. The page shows how cubes are assembled and where they
stand.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.model.design import Design, Target

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


def cube_net_pieces(groups: Sequence[Sequence[str]], flaps: bool = True) -> tuple[Piece, ...]:
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


def arrange_cube_net_on_sheets(
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
            sheets = _packed(cube_net_pieces(groups, flap > 0), size, (upright_area, sideways_area))
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
        pieces = {one.piece for one in placed}
        left = [piece for piece in left if piece not in pieces]
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


def cube_stl_bytes_by_target(design: Design, paper_thickness: float) -> dict[str, bytes]:
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


MARGIN, LEFT, FOOT = (
    10.0,
    17.0,
    20.0,
)  # mm: at the edges; at the left, with its ruler; above the lower margin, for ruler, legend and label
RULER = 100  # mm, of each ruler


def printable_paper_area(paper: tuple[float, float]) -> tuple[float, float]:
    """Usable area (width, height) mm of a sheet of paper (width, height) mm."""
    return paper[0] - LEFT - MARGIN, paper[1] - FOOT - 2 * MARGIN


def cut_line_matplotlib_style() -> Json:
    """Line style of a cut line, as matplotlib arguments."""
    return {"color": "black", "lw": 0.5, "ls": "-"}


def fold_line_matplotlib_style() -> Json:
    """Line style of a fold line, as matplotlib arguments."""
    return {"color": "0.45", "lw": 0.5, "ls": (0, (4, 3))}


def draw_rulers_and_legend(axes: Axes, paper: tuple[float, float], label: str) -> None:
    """Draw the rulers and the legend of a sheet.

    Its label is drawn too.
    paper : (width, height) mm
    """
    for along in (0, 1):
        start = (LEFT, MARGIN) if along == 0 else (MARGIN, MARGIN + FOOT)
        _ruler(axes, start, along)
    x, y = LEFT + RULER + 6, MARGIN + 2
    for text, style in (("cut", cut_line_matplotlib_style()), ("fold", fold_line_matplotlib_style())):
        axes.plot([x, x + 10], [y, y], **style)
        axes.text(x + 11.5, y, text, fontsize=7, va="center")
        x += 21
    axes.add_patch(Rectangle((x, y - 1.5), 8, 3, fc="0.93", ec="none"))
    axes.text(x + 9.5, y, "glue", fontsize=7, va="center")
    axes.text(LEFT, MARGIN + 13.5, label, fontsize=7)
    axes.text(
        LEFT,
        MARGIN + 9.5,
        f"Both rulers are {RULER} mm long when printed at 100 %; if not, the markers deviate by the same factor: "
        "measure them, or rig print check.",
        fontsize=6,
    )


def _ruler(axes: Axes, start: tuple[float, float], along: int) -> None:
    """A ruler of whole centimetres from start (mm), to the right (along 0) or upwards (1)."""
    for mm in range(RULER + 1):
        tall = 5 if mm % 10 == 0 else 3.5 if mm % 5 == 0 else 2
        at = (start[0] + mm, start[1]) if along == 0 else (start[0], start[1] + mm)
        axes.plot(*zip(at, (at[0], at[1] + tall) if along == 0 else (at[0] + tall, at[1])), color="black", lw=0.3)
    last = (start[0] + RULER, start[1]) if along == 0 else (start[0], start[1] + RULER)
    axes.plot(*zip(start, last), color="black", lw=0.3)


BODIES = ("base", "platform")
STEPS = (
    "1. Print all sheets at 100 %, without fitting to the page. Measure both rulers and some markers with a "
    "caliper, or photograph a sheet and "
    "run rig print check; write the measured side into rig.toml.",
    "2. Cut along the full black lines, flaps (grey) included. Score the dashed lines with a blunt blade, "
    "and fold them back by "
    "90 degrees, the print outside.",
    "3. Glue flap by flap under the face that bears no flap at that edge; names on the faces meet as on this "
    "page. A cube on several sheets is "
    "assembled likewise: its faces' names (+x, +y, -x, -y, then +z on top and -z below) say what "
    "is adjacent to what.",
    "4. More accurate than paper alone: wrap the net around a solid body (rig print --stl writes one for each "
    "cube). Faces must be flat and "
    "markers without bubbles.",
    "5. Fix each cube as in the views below: +x along its arrow, the named face up. Some "
    "millimetres are uncritical: `rig measure` "
    "estimates the true poses; a turned or exchanged face does matter.",
)


def draw_cube_assembly_page(plot_axes: Axes, design: Design, paper: tuple[float, float], count: int) -> None:
    """Draw the assembly page of a design's cubes.

    paper : (width, height) mm; count : sheets before it
    """
    width, top = paper[0] - 2 * MARGIN, paper[1] - MARGIN
    plot_axes.text(
        MARGIN, top, f"{design.name}: {len(design.targets)} targets on {count} sheets", fontsize=12, va="top"
    )
    y = top - 9
    for step in STEPS:
        lines = textwrap.wrap(step, int(width / 1.52))
        plot_axes.text(MARGIN, y, "\n".join(lines), fontsize=7.5, va="top", linespacing=1.3)
        y -= 3.6 * len(lines) + 2
    bodies = [body for body in BODIES if any(target.body == body for target in design.targets)]
    bodies += sorted({target.body for target in design.targets} - set(BODIES))
    high = (y - MARGIN) / len(bodies)
    for k, body in enumerate(bodies):
        _body(plot_axes, design, body, (MARGIN, y - (k + 1) * high, width, high - 4))


def _body(axes: Axes, design: Design, body: str, frame: tuple[float, float, float, float]) -> None:
    """One body from above, +x of its frame to the right. frame : (left, bottom, width, height) mm on the sheet"""
    left, bottom, width, height = frame
    targets = [target for target in design.targets if target.body == body]
    joints = getattr(design.mechanism, {"base": "base_joints", "platform": "platform_joints"}.get(body, ""), None)
    outlines = [target_outline_from_above(target) for target in targets]
    points = np.concatenate([*outlines, np.zeros((1, 2)), *([] if joints is None else [np.asarray(joints)[:, :2]])])
    low, span = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-3)
    scale = min((width - 20) / span[0], (height - 22) / span[1])
    origin = np.array([left + width / 2, bottom + (height - 8) / 2]) - scale * (low + span / 2)
    axes.text(
        left,
        bottom + height - 4,
        f"{body}, from above (+z of its frame towards you), 1 : {1e3 / scale:.2g}",
        fontsize=9,
    )
    for axis, name in enumerate("xy"):
        end = origin + 12 * np.eye(2)[axis]
        axes.annotate("", end, origin, arrowprops={"arrowstyle": "->", "color": "0.4", "lw": 0.8})
        axes.text(
            end[0] + 2 * (axis == 0), end[1] + 2 * (axis == 1), name, fontsize=7, color="0.4", ha="center", va="center"
        )
    for number, joint in enumerate([] if joints is None else np.asarray(joints)[:, :2]):
        place = origin + scale * joint
        axes.plot(*place, "o", ms=3, mfc="none", mec="0.4", mew=0.6)
        axes.text(place[0] + 1.5, place[1] + 1.5, f"joint {number + 1}", fontsize=6, color="0.4")
    for target, shape in zip(targets, outlines):
        _target(axes, target, origin + scale * shape)


def _target(axes: Axes, target: Target, shape: Floats) -> None:
    """A target where its outline (n, 2) mm lies: name, what is up, and a cube's +x."""
    middle = shape.mean(axis=0)
    axes.add_patch(Polygon(shape, closed=True, fill=False, ec="black", lw=0.8))
    text = target.name
    if target.pose is not None:
        turn = target.pose.rotation.as_matrix()
        edge, along = np.linalg.norm(shape[1] - shape[0]), turn[:2, 0]
        if np.linalg.norm(along) > 0.1:
            axes.annotate(
                "+x",
                middle + 0.5 * edge * along,
                middle + (0.5 * edge + 9) * along,
                color="tab:red",
                fontsize=7,
                ha="center",
                va="center",
                arrowprops={"arrowstyle": "<-", "color": "tab:red", "lw": 0.8},
            )
        up = int(np.abs(turn[2]).argmax())
        text += f"\n{'+' if turn[2, up] > 0 else '-'}{'xyz'[up]} up\nz = {target.pose.translation[2] * 1e3:.0f} mm"
    axes.text(
        middle[0],
        middle[1],
        text,
        fontsize=6.5,
        ha="center",
        va="center",
        bbox={"boxstyle": "square,pad=0", "fc": "white", "ec": "none"},
    )


def target_outline_from_above(target: Target) -> Floats:
    """Outline (n, 2) m of a target from above in its body's frame."""
    if target.edge is not None and target.pose is not None:
        turn = target.pose.rotation.as_matrix()
        up = int(np.abs(turn[2]).argmax())
        a, b = (axis for axis in range(3) if axis != up)
        corners = np.zeros((4, 3))
        corners[:, [a, b]] = target.edge / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return target.pose.apply(corners)[:, :2]
    poses = RigidTransform.concatenate([marker.T_body_marker for marker in target.listed])
    half = max(marker.side for marker in target.listed) / 2
    places = poses.translation[:, :2]
    low, high = places.min(axis=0) - half, places.max(axis=0) + half
    return np.array([low, (high[0], low[1]), high, (low[0], high[1])])
