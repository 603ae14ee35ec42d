"""Image plane figures, and 3-D views, of pages.

Arrows, outlines, cells; the 3-D view of a rig is interactive.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from rig.array_and_json_types import Floats, Integers, Json
from rig.report.pages.html_and_svg_elements import (
    TEXT,
    WIDTH,
    escape_html,
    inline_html,
    note_html,
    svg_figure,
    svg_text,
    svg_tooltip,
)
from rig.report.pages.page_templates_and_index_page import read_page_stylesheet_or_script

TOP = TEXT + 11.0
Placed = Callable[[Floats], Floats]  # (n, 2) of the plane -> (n, 2) of the figure
MOST_DOTS_AND_ARROWS = 3000  # arrows that are drawn: of more, evenly chosen ones
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
    """Figure of the image plane with layers.

    caption : below; size : (width, height) px; dots : (n, 2) px, or None
    """
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
        d = "".join(f"M{a:.1f} {b:.1f}h.01" for a, b in placed(dots[:: -(-len(dots) // MOST_DOTS_AND_ARROWS)]).tolist())
        parts.append(f'<path class="specks" d="{d}"/>')
    parts.append(svg_text(4, TOP + tall + 17, caption))
    return svg_figure(int(TOP + tall + 24), f"{title}: {caption}", parts)


def image_patch_centres_and_means(uv: Floats, values: Floats, cell: float) -> tuple[Floats, Floats]:
    """Centres of square patches of uv (n, 2) >= 0, and means of values (n, k) in them.

    cell : a square's side, as uv
    Returns (centres (c, 2), means (c, k))
    """
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
        f'width="{right - left:.1f}" height="{bottom - top:.1f}">{svg_tooltip(f"{value:.4g} {cells.unit}")}</rect>'
        for (left, top, right, bottom), value in zip(ends.tolist(), cells.values.tolist())
        if value == value
    ]


def _arrows(arrows: Arrows, placed: Placed, scale: float) -> str:
    every = max(-(-len(arrows.at) // MOST_DOTS_AND_ARROWS), 1)
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


MOST_FRAMES = 240  # frames that are shown: of more, evenly chosen ones
DIGITS = 7  # of metres


@dataclass(frozen=True, slots=True, eq=False)
class DrawnEffect:
    """What an effect does. name; sizes : in words, the smallest first; shifts : (sizes, n, 6) tangent on the right (m,
    rad) of each frame's pose
    """

    name: str
    sizes: tuple[str, ...]
    shifts: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A rig at n frames. frames : (n,) numbers; poses : (n, 6) m and rotation vector (rad) of the platform
    fixed, moved : lines, {kind, points (k, 3) m, name}, in the base frame and in the platform's; base,
        platform : (struts, 3) m of the joints
    links : (n, joints, 3) m of an arm, or None; ends : (e, 3) m of the platform, where errors are drawn
    errors : {name: (n, 6) tangent on the right}, two at the most; effects; middle : (3,) m, and size m, of what is
        shown"""

    frames: Integers
    poses: Floats
    fixed: Sequence[Json]
    moved: Sequence[Json]
    middle: Sequence[float]
    size: float
    base: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    platform: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    links: Floats | None = None
    ends: Floats = field(default_factory=lambda: np.zeros((1, 3)))
    errors: dict[str, Floats] = field(default_factory=dict)
    effects: Sequence[DrawnEffect] = ()


def view_3d_html(scene: Scene) -> list[str]:
    """HTML of the 3-D view of a scene.

    Once in a page, which needs `view_3d_scripts_if_needed`.
    """
    chosen = np.arange(0, len(scene.frames), max(-(-len(scene.frames) // MOST_FRAMES), 1))
    data = json.dumps(_tree(scene, chosen), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    legend = [
        f'<span class="box {colour}"></span>{inline_html(name)}' for name, colour in zip([*scene.errors], ("c1", "c2"))
    ]
    legend += ['<span class="box c3"></span>what the effect does'] if scene.effects else []
    thinned = "" if len(chosen) == len(scene.frames) else f" Of {len(scene.frames)} frames {len(chosen)} are shown."
    enlarged = " Errors and effects are enlarged by the factor of the slider." if legend else ""
    return [
        note_html(f"Drag or use the arrow keys to turn, the wheel or + and - to zoom.{enlarged}{thinned}"),
        '<figure class="stage">'
        '<canvas id="stage-view" role="img" tabindex="0" aria-label="the rig in three dimensions; arrow keys '
        'turn it"></canvas>'
        f'<div class="controls">{_controls(scene, len(chosen))}</div>'
        + f"<figcaption>{' '.join([inline_html(_caption(scene)), *legend])}</figcaption>"
        + f'</figure><script type="application/json" id="stage-data">{data}</script>',
    ]


def _caption(scene: Scene) -> str:
    """What a scene shows, in words: of its parts those that it has."""
    kinds = {part["kind"] for part in (*scene.fixed, *scene.moved)}
    hand = "at the platform joints" if len(scene.ends) > 1 else "at the measured body"
    seen = {
        "numbered lines are the struts, outlines join the joints of base and platform": len(scene.base),
        "the bent line is the arm, from joint to joint": scene.links is not None,
        "the cross shows the axes of the measured body": not len(scene.platform),
        "squares are the markers": "face" in kinds,
        "named pyramids are the cameras, open to where they look": "camera" in kinds,
        f"coloured lines {hand} lead from a pose to where its error or the effect takes it": scene.errors
        or scene.effects,
    }
    parts = "; ".join(text for text, is_shown in seen.items() if is_shown)
    return f"The rig in the base frame at {len(scene.frames)} poses, one after another. {parts.capitalize()}."


def view_3d_scripts_if_needed(parts: Sequence[str]) -> tuple[str, ...]:
    """Scripts of the 3-D view, where a page's parts contain one.

    Else ().
    """
    return (
        (read_page_stylesheet_or_script("view3d.js") + read_page_stylesheet_or_script("stage.js"),)
        if any('id="stage-data"' in part for part in parts)
        else ()
    )


def _controls(stage: Scene, count: int) -> str:
    rows = [
        '<button id="stage-play" type="button">Play</button><input id="stage-frame" type="range" min="0" '
        f'max="{count - 1}" value="0" '
        f'aria-label="frame"><output id="stage-number"></output>'
    ]
    if stage.errors or stage.effects:
        rows.append(
            '<label for="stage-much">enlarged</label><input id="stage-much" type="range" min="0" max="4" '
            'step="0.05" value="2">'
            '<output id="stage-times"></output>'
        )
    if stage.effects:
        options = "".join(
            f'<option value="{k}">{inline_html(effect.name)}</option>' for k, effect in enumerate(stage.effects)
        )
        rows += [
            f'<label for="stage-effect">effect</label><select id="stage-effect">{options}<option '
            'value="-1">none</option></select><span></span>',
            '<label for="stage-size">its size</label><input id="stage-size" type="range" min="0" max="1" '
            'step="0.01" value="0.5">'
            '<output id="stage-said"></output>',
        ]
    return "".join(rows)


def _tree(stage: Scene, chosen: Integers) -> Json:
    """What the page's script reads, of the frames chosen (k,)."""

    def lines(parts: Sequence[Json]) -> list[Json]:
        return [{**part, "points": _short(part["points"])} for part in parts]

    errors = [
        {
            "name": name,
            "of": [_short(np.nan_to_num(row), 9) if np.isfinite(row[:3]).all() else None for row in of[chosen]],
        }
        for name, of in stage.errors.items()
    ]
    return {
        "frames": stage.frames[chosen].tolist(),
        "poses": _short(stage.poses[chosen]),
        "fixed": lines(stage.fixed),
        "moved": lines(stage.moved),
        "middle": _short(stage.middle),
        "size": stage.size,
        "base": _short(stage.base),
        "platform": _short(stage.platform),
        "links": None if stage.links is None else _short(stage.links[chosen]),
        "ends": _short(stage.ends),
        "errors": errors,
        "effects": [
            {"name": e.name, "sizes": list(e.sizes), "shifts": [_short(one[chosen], 9) for one in e.shifts]}
            for e in stage.effects
        ],
    }


def _short(values: object, digits: int = DIGITS) -> list[object]:
    return np.round(np.asarray(values, float), digits).tolist()
