"""The arm, or the chain of mechanisms, in outline, as it stood in the recording, with the joints marked that a
diagnosis points at.
"""

from typing import NamedTuple

import numpy as np

from rig.arrays import Floats
from rig.model import mechanisms
from rig.model.mechanism_geometry import Arm, Chain
from rig.model.mechanisms import arm as mechanism
from rig.model.mechanisms import chain as chains
from rig.report.pages.html_elements import list_html
from rig.report.pages.plots import panel_row
from rig.report.pages.svg_elements import WIDTH, svg_figure, svg_text, tooltip

GHOSTS = 14  # other configurations, drawn faintly
VIEWS = (((0, 2), "from the side"), ((0, 1), "from above"))
ARM_FIGURE_HEIGHT, ARM_MARGIN = 260.0, 24.0  # of a view, units of a figure


def arm_outline_figures(arm: Arm | Chain, q: Floats, marked_joints: dict[int, dict[str, float]]) -> str:
    """Figures of an Arm, or a Chain, over its configurations q (n, joints) rad or m.

    marked_joints : {joint: {effect: RMS in rad or, of what slides, m}} of what was found
    """
    at, joints = _points(q, arm)
    typical = int(np.argmin(((q - np.median(q, axis=0)) ** 2).sum(axis=1)))
    ghosts = np.linspace(0, len(q) - 1, GHOSTS).astype(int)
    places, units = mechanisms.axis_places(arm), mechanisms.axis_units(arm)
    said = {
        j: f"{places[j]}: "
        + ", ".join(f"{name} {size * 1e3:.3f} m{units[j]}" for name, size in marked_joints[j].items())
        for j in sorted(marked_joints)
    }
    largest = max((max(found.values()) for found in marked_joints.values()), default=1.0)
    marks = [
        Mark(place, max(marked_joints[j].values()) / largest if j in marked_joints else None, said.get(j, place))
        for j, place in enumerate(places)
    ]
    views = [
        _view(title, at[ghosts][:, :, [a, b]], at[typical][:, [a, b]], joints[typical][:, [a, b]], marks)
        for (a, b), title in VIEWS
    ]
    return panel_row(*views) + (list_html(said.values()) if said else "")


class Mark(NamedTuple):
    """How a joint is drawn. place : its own; size : of what was found there, 0 to 1, None for nothing; said : of it."""

    place: str
    size: float | None
    said: str


def _view(title: str, ghosts: Floats, points: Floats, joints: Floats, marks: list[Mark]) -> str:
    """One view. ghosts : (g, k, 2) m; points : (k, 2) m of the configuration drawn in full; joints : (joints, 2) m of
    it
    """
    every = np.concatenate([ghosts.reshape(-1, 2), points, joints])
    low, high = every.min(axis=0), every.max(axis=0)
    scale = min(
        (WIDTH - 2 * ARM_MARGIN) / max(high[0] - low[0], 1e-9),
        (ARM_FIGURE_HEIGHT - 2 * ARM_MARGIN) / max(high[1] - low[1], 1e-9),
    )

    def placed(way: Floats) -> list[list[float]]:
        return np.stack(
            [
                ARM_MARGIN + scale * (way[:, 0] - low[0]),
                20 + ARM_FIGURE_HEIGHT - ARM_MARGIN - scale * (way[:, 1] - low[1]),
            ],
            axis=1,
        ).tolist()

    def drawn(way: Floats, style: str) -> str:
        return f'<path class="{style}" d="M' + "L".join(f"{x:.1f} {y:.1f}" for x, y in placed(way)) + '"/>'

    parts = [svg_text(4, 14, title, style="name"), *(drawn(ghost, "tick") for ghost in ghosts), drawn(points, "link")]
    for j, (mark, (x, y)) in enumerate(zip(marks, placed(joints))):
        parts += [
            f'<circle class="joint{"" if mark.size is None else " marked"}" cx="{x:.1f}" cy="{y:.1f}" '
            f'r="{8 + 5 * (mark.size or 0.0):.1f}">'
            f"{tooltip(mark.said)}</circle>",
            svg_text(x, y + 4, str(j + 1), "middle", "within"),
        ]
    return svg_figure(
        int(ARM_FIGURE_HEIGHT) + 24,
        f"the machine {title}, marked: {', '.join(mark.place for mark in marks if mark.size is not None) or 'nothing'}",
        parts,
    )


def _points(q: Floats, arm: Arm | Chain) -> tuple[Floats, Floats]:
    """((n, k, 3) m points of the outline, (n, joints, 3) m where the joints are), seen in the machine's own base,
    whatever stands where.
    """
    if isinstance(arm, Arm):
        at = (mechanism.frames(q, arm)[..., :3, 3] - arm.base.translation) @ arm.base.rotation.as_matrix()
        return at, at[:, : len(arm.joints)]
    outline: list[Floats] = []
    joints: list[Floats] = []
    below = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for (stage, own), T in zip(chains.stages_and_values(q, arm), chains.stage_transforms(q, arm)):
        if isinstance(stage, Arm):
            links = mechanism.frames(own, stage)[..., :3, 3]
            outline, joints = [*outline, _in(below, links)], [*joints, _in(below, links[:, : len(stage.joints)])]
        else:  # a strut is marked at its foot
            feet, _ = chains.KINDS[stage.kind].ends(T, stage)
            joints.append(_in(below, np.broadcast_to(feet, (len(q), *feet.shape))))
        below = below @ T.as_matrix()
        outline.append(below[:, None, :3, 3])
    return np.concatenate(outline, axis=1), np.concatenate(joints, axis=1)


def _in(matrix: Floats, points: Floats) -> Floats:
    """Points (n, k, 3) of a body that stands at (n, 4, 4), in the base."""
    return points @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3]
