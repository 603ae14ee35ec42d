"""Outline figures of a rig and of an arm.

The parts are marked that a diagnosis points at.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.report.pose_and_effect_figures import closed_outline_sorted_by_angle
from rig.array_and_json_types import Floats
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera
from rig.model.mechanism_geometry_classes import Arm, Chain, Hexapod, Planar2
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms import mechanism_chain as chains
from rig.model.pose import transform_points
from rig.report.pages.html_and_svg_elements import WIDTH, list_html, svg_figure, svg_text, svg_tooltip
from rig.report.pages.svg_plots import figures_side_by_side_html
from vision.marker_corner_prediction import marker_map

AZIMUTH, ELEVATION = np.radians(-65), np.radians(24)  # from where the rig is looked at
MARKS = (3, 1, 4, 5, 2, 0)  # colours of the first, second, .. finding
PLAIN = -1
CAMERA_DISTANCE = 0.6  # of their distance at which cameras are drawn
MARGIN, HIGH = 24.0, 330.0  # units of a figure

Colour = Callable[..., int]
GHOSTS = 14  # other configurations, drawn faintly
VIEWS = (((0, 2), "from the side"), ((0, 1), "from above"))
FRAME, LEAST_FRAME = 0.3, 0.05  # axes of a frame, of the distance of base and platform; m, which that is at least
ARM_FIGURE_HEIGHT, ARM_MARGIN = 260.0, 24.0  # of a view, units of a figure


class Outline:
    """Lines, patches and words in space, gathered and then laid on a figure."""

    def __init__(self) -> None:
        self._shapes: list[tuple[Floats, str, int, str]] = []
        self._words: list[tuple[Floats, str, int]] = []

    def line(self, points: ArrayLike, colour: int, tooltip: str = "") -> None:
        """A line through points (n, 3) m. colour : of a finding, or PLAIN; tooltip : what it is"""
        self._shapes.append((_oblique_projection(np.asarray(points, float)), "outline", colour, tooltip))

    def patch(self, points: Floats, style: str, colour: int = PLAIN) -> None:
        """A filled polygon of points (n, 3) m. style : plate or patch"""
        self._shapes.append((_oblique_projection(points), style, colour, ""))

    def label(self, point: ArrayLike, words: str, colour: int) -> None:
        """Words at a point (3,) m."""
        self._words.append((_oblique_projection(np.asarray(point, float)), words, colour))

    def figure(self, title: str, more: list[tuple[str, int]]) -> str:
        """SVG of all of it. more : words with their colours, in a corner"""
        every = np.concatenate([points for points, _, _, _ in self._shapes])
        low, high = every.min(axis=0), every.max(axis=0)
        scale = min((WIDTH - 2 * MARGIN) / (high[0] - low[0]), HIGH / (high[1] - low[1]))
        tall = scale * (high[1] - low[1])

        def placed(points: Floats) -> Floats:
            across = WIDTH / 2 + scale * (points[..., 0] - (low[0] + high[0]) / 2)
            return np.stack([across, MARGIN + tall - scale * (points[..., 1] - low[1])], axis=-1)

        parts = []
        for points, style, colour, label in sorted(self._shapes, key=lambda s: (s[1] != "plate", s[2] != PLAIN)):
            d = (
                "M"
                + "L".join(f"{x:.1f} {y:.1f}" for x, y in placed(points).tolist())
                + ("Z" if style != "outline" else "")
            )
            marked = f" marked c{colour}" if colour != PLAIN else ""
            parts.append(f'<path class="{style}{marked}" d="{d}">{svg_tooltip(label) if label else ""}</path>')
        for point, words, colour in self._words:
            x, y = placed(point).tolist()
            parts.append(
                svg_text(x, y + 4, words, "middle", f"said over c{colour}" if colour != PLAIN else "small over")
            )
        parts += [svg_text(6, 16 + 17 * n, words, "start", f"said c{colour}") for n, (words, colour) in enumerate(more)]
        return svg_figure(int(tall + 2 * MARGIN), title, parts)


def rig_outline_figure(point: OperatingPoint, marked_places: list[str]) -> str:
    """Figure of the rig's outline, marked places in it.

    It is at the middle of its poses; the places are those of findings.
    """
    k, drawn = point, Outline()
    T, colour = k.T.mean(), _part_colours(marked_places)
    m = k.design.mechanism
    if isinstance(m, Hexapod):
        _hexapod(drawn, m, T, colour)
    elif isinstance(m, Planar2):
        _planar(drawn, m, T, colour)
    elif m.axes:
        _frames(drawn, T, colour)
    if k.design.targets:
        _targets(drawn, k, T, colour)
    for camera in k.design.cameras if k.seen is not None else ():
        _camera(drawn, camera, colour(str(Place("camera", camera.name)), "cameras"), T.translation)
    whole = [
        (place, MARKS[n % len(MARKS)])
        for n, place in enumerate(marked_places)
        if Place.parse(place).kind in ("rig", "clock", "cameras", "markers")
        or (Place.parse(place).is_axis and m.strut_joints is None)
    ]
    return drawn.figure(f"the rig in outline, marked: {', '.join(marked_places) or 'nothing'}", whole)


def _part_colours(places: list[str]) -> Colour:
    """A function from a part's place (and what takes it in) to its colour, PLAIN where nothing is the matter."""

    def colour(*names: str) -> int:
        return next((MARKS[n % len(MARKS)] for n, place in enumerate(places) if place in names), PLAIN)

    return colour


def _oblique_projection(points: Floats) -> Floats:
    """(..., 2) m of points (..., 3) m seen from far away."""
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0])
    up = np.array([-np.sin(ELEVATION) * np.cos(AZIMUTH), -np.sin(ELEVATION) * np.sin(AZIMUTH), np.cos(ELEVATION)])
    return np.stack([points @ right, points @ up], axis=-1)


def _hexapod(drawn: Outline, m: Hexapod, T: RigidTransform, colour: Colour) -> None:
    tops = transform_points(T, m.platform_joints)
    for around in (np.array(closed_outline_sorted_by_angle(joints)) for joints in (m.base_joints, tops)):
        drawn.patch(around[:-1], "plate")
        drawn.line(around, colour("rig"))
    for i in range(len(m.axes)):
        c = colour(str(Place.axis("strut", i)), "rig")
        drawn.line([m.base_joints[i], tops[i]], c, str(Place.axis("strut", i)))
        drawn.label(0.62 * m.base_joints[i] + 0.38 * tops[i], str(i + 1), c)


def _planar(drawn: Outline, m: Planar2, T: RigidTransform, colour: Colour) -> None:
    for i, joint in enumerate(m.base_joints):
        c = colour(str(Place.axis("strut", i)), "rig")
        drawn.line([np.r_[joint, 0], T.translation], c, str(Place.axis("strut", i)))
        drawn.label((np.r_[joint, 0] + T.translation) / 2, str(i + 1), c)


def _frames(drawn: Outline, T: RigidTransform, colour: Colour) -> None:
    """The frames of base and platform, all that is known of the shape of a machine of a kinematics file."""
    size = FRAME * max(float(np.linalg.norm(T.translation)), LEAST_FRAME)
    drawn.line([np.zeros(3), T.translation], colour("rig"))
    for frame, name in ((RigidTransform.identity(), "base"), (T, "platform")):
        for k, axis in enumerate("xyz"):
            tip = frame.apply(size * np.eye(3)[k])
            drawn.line([frame.translation, tip], PLAIN, f"{name} {axis}")
            drawn.label(tip, axis, PLAIN)


def _targets(drawn: Outline, k: OperatingPoint, T: RigidTransform, colour: Colour) -> None:
    markers = marker_map(k.stated)
    base = np.where(markers.on_platform[:, None, None], transform_points(T, markers.corners), markers.corners)
    for n, quad in enumerate(base):
        drawn.line(
            quad[[0, 1, 2, 3, 0]],
            colour(str(Place("marker", str(markers.id[n]))), str(Place("target", markers.target[n])), "markers"),
            str(Place("marker", str(markers.id[n]))),
        )
        own = colour(str(Place("marker", str(markers.id[n]))))
        if own != PLAIN:
            drawn.patch(quad, "patch", own)
            drawn.label(quad.mean(axis=0), str(markers.id[n]), own)
    for target in k.stated.targets:
        mine = base[[name == target.name for name in markers.target]]
        top = mine.reshape(-1, 3)[mine[..., 2].argmax()]
        drawn.label(np.r_[mine.mean(axis=(0, 1))[:2], top[2]], target.name, colour(str(Place("target", target.name))))


def _camera(drawn: Outline, camera: Camera, colour: int, middle: Floats) -> None:
    half = np.array([camera.width / 2 / camera.matrix[0, 0], camera.height / 2 / camera.matrix[1, 1]])
    away = CAMERA_DISTANCE * (camera.pose.translation - middle)
    ends = (
        0.12
        * np.linalg.norm(away)
        * np.array([[x * half[0], y * half[1], 1] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    )
    tip, ends = middle + away, middle + away + ends @ camera.pose.rotation.as_matrix().T
    drawn.line(ends[[0, 1, 2, 3, 0]], colour, camera.name)
    for end in ends:
        drawn.line([tip, end], colour, camera.name)
    drawn.label(tip, camera.name, colour)


def arm_outline_figures(arm: Arm | Chain, q: Floats, marked_joints: dict[int, dict[str, float]]) -> str:
    """Figures of the outline of an Arm, or a Chain, over its configurations q (n, joints) rad or m.

    marked_joints : {joint: {effect: RMS in rad or, of what slides, m}} of what was found
    """
    at, joints = _points(q, arm)
    typical = int(np.argmin(((q - np.median(q, axis=0)) ** 2).sum(axis=1)))
    ghosts = np.linspace(0, len(q) - 1, GHOSTS).astype(int)
    places, units = mechanisms.axis_place_texts(arm), mechanisms.axis_units(arm)
    labels = {
        j: f"{places[j]}: "
        + ", ".join(f"{name} {size * 1e3:.3f} m{units[j]}" for name, size in marked_joints[j].items())
        for j in sorted(marked_joints)
    }
    largest = max((max(found.values()) for found in marked_joints.values()), default=1.0)
    marks = [
        Mark(place, max(marked_joints[j].values()) / largest if j in marked_joints else None, labels.get(j, place))
        for j, place in enumerate(places)
    ]
    views = [
        _view(title, at[ghosts][:, :, [a, b]], at[typical][:, [a, b]], joints[typical][:, [a, b]], marks)
        for (a, b), title in VIEWS
    ]
    return figures_side_by_side_html(*views) + (list_html(labels.values()) if labels else "")


class Mark(NamedTuple):
    """How a joint is drawn. place : its own; size : of what was found there, 0 to 1, None for nothing; tooltip."""

    place: str
    size: float | None
    tooltip: str


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

    def placed(outline: Floats) -> list[list[float]]:
        return np.stack(
            [
                ARM_MARGIN + scale * (outline[:, 0] - low[0]),
                20 + ARM_FIGURE_HEIGHT - ARM_MARGIN - scale * (outline[:, 1] - low[1]),
            ],
            axis=1,
        ).tolist()

    def drawn(outline: Floats, style: str) -> str:
        return f'<path class="{style}" d="M' + "L".join(f"{x:.1f} {y:.1f}" for x, y in placed(outline)) + '"/>'

    parts = [svg_text(4, 14, title, style="name"), *(drawn(ghost, "tick") for ghost in ghosts), drawn(points, "link")]
    for j, (mark, (x, y)) in enumerate(zip(marks, placed(joints))):
        parts += [
            f'<circle class="joint{"" if mark.size is None else " marked"}" cx="{x:.1f}" cy="{y:.1f}" '
            f'r="{8 + 5 * (mark.size or 0.0):.1f}">'
            f"{svg_tooltip(mark.tooltip)}</circle>",
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
        origins = mechanism.joint_frames(q, arm).before[..., :3, 3]
        back = arm.base.rotation.as_matrix()
        line = (mechanism.link_points(q, arm) - arm.base.translation) @ back
        return line, (origins - arm.base.translation) @ back
    outline: list[Floats] = []
    joints: list[Floats] = []
    below = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for (stage, own), T in zip(chains.stages_and_values(q, arm), chains.stage_transforms(q, arm)):
        if isinstance(stage, Arm):
            links = mechanism.single_hand_arm_link_frames(own, stage)[..., :3, 3]
            outline, joints = [*outline, _in(below, links)], [*joints, _in(below, links[:, : len(stage.joints)])]
        else:  # a strut is marked at its foot
            feet, _ = chains.KINDS[stage.kind].strut_ends(T, stage)
            joints.append(_in(below, np.broadcast_to(feet, (len(q), *feet.shape))))
        below = below @ T.as_matrix()
        outline.append(below[:, None, :3, 3])
    return np.concatenate(outline, axis=1), np.concatenate(joints, axis=1)


def _in(matrix: Floats, points: Floats) -> Floats:
    """Points (n, k, 3) of a body that stands at (n, 4, 4), in the base."""
    return points @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3]
