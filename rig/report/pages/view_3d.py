"""Interactive 3-D view of a rig in a page: poses frame by frame, errors enlarged, effects at several sizes."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rig.arrays import Floats, Integers
from rig.formats.json_tree import Json
from rig.report.pages.html_elements import inline_html, note
from rig.report.pages.page_and_svg_templates import read_asset

MOST = 240  # frames that are shown: of more, evenly chosen ones
DIGITS = 7  # of metres


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
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
    effects: Sequence[Effect] = ()


def view_3d_html(scene: Scene) -> list[str]:
    """HTML of the 3-D view of a scene, once in a page, which needs `view_scripts`."""
    chosen = np.arange(0, len(scene.frames), max(-(-len(scene.frames) // MOST), 1))
    data = json.dumps(_tree(scene, chosen), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    told = [
        f'<span class="box {colour}"></span>{inline_html(name)}' for name, colour in zip([*scene.errors], ("c1", "c2"))
    ]
    told += ['<span class="box c3"></span>what the effect does'] if scene.effects else []
    thinned = "" if len(chosen) == len(scene.frames) else f" Of {len(scene.frames)} frames {len(chosen)} are shown."
    enlarged = " Errors and effects are as many times as large as the slider says." if told else ""
    return [
        note(f"Drag or use the arrow keys to turn, the wheel or + and - to come nearer.{enlarged}{thinned}"),
        '<figure class="stage">'
        '<canvas id="stage-view" role="img" tabindex="0" aria-label="the rig in three dimensions; arrow keys '
        'turn it"></canvas>'
        f'<div class="controls">{_controls(scene, len(chosen))}</div>'
        + (f"<figcaption>{' '.join(told)}</figcaption>" if told else "")
        + f'</figure><script type="application/json" id="stage-data">{data}</script>',
    ]


def view_scripts(parts: Sequence[str]) -> tuple[str, ...]:
    """Scripts of the 3-D view, where a page's parts contain one; else ()."""
    return (
        (read_asset("view3d.js") + read_asset("stage.js"),) if any('id="stage-data"' in part for part in parts) else ()
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
