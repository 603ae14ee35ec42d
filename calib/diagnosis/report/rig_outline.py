"""The rig in outline, with the parts that a diagnosis points at marked."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from calib.diagnosis.problems.platform.operating_point import OperatingPoint
from calib.report.pose_figures import closed_outline
from rig.arrays import Floats
from rig.effects.framework.place import Place
from rig.model.design import Camera
from rig.model.mechanism_geometry import Hexapod, Planar2
from rig.model.pose import transform_points
from rig.report.pages.svg_elements import WIDTH, svg_figure, svg_text, tooltip
from vision.targets import marker_map

AZIMUTH, ELEVATION = np.radians(-65), np.radians(24)  # from where the rig is looked at
MARKS = (3, 1, 4, 5, 2, 0)  # colours of the first, second, .. finding
PLAIN = -1
CAMERA_DISTANCE = 0.6  # of their distance at which cameras are drawn
MARGIN, HIGH = 24.0, 330.0  # units of a figure

Colour = Callable[..., int]


class Outline:
    """Lines, patches and words in space, gathered and then laid on a figure."""

    def __init__(self) -> None:
        self._shapes: list[tuple[Floats, str, int, str]] = []
        self._words: list[tuple[Floats, str, int]] = []

    def line(self, points: ArrayLike, colour: int, said: str = "") -> None:
        """A line through points (n, 3) m. colour : of a finding, or PLAIN; said : what it is"""
        self._shapes.append((_oblique_projection(np.asarray(points, float)), "outline", colour, said))

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
        for points, style, colour, said in sorted(self._shapes, key=lambda s: (s[1] != "plate", s[2] != PLAIN)):
            d = (
                "M"
                + "L".join(f"{x:.1f} {y:.1f}" for x, y in placed(points).tolist())
                + ("Z" if style != "outline" else "")
            )
            marked = f" marked c{colour}" if colour != PLAIN else ""
            parts.append(f'<path class="{style}{marked}" d="{d}">{tooltip(said) if said else ""}</path>')
        for point, words, colour in self._words:
            x, y = placed(point).tolist()
            parts.append(
                svg_text(x, y + 4, words, "middle", f"said over c{colour}" if colour != PLAIN else "small over")
            )
        parts += [svg_text(6, 16 + 17 * n, words, "start", f"said c{colour}") for n, (words, colour) in enumerate(more)]
        return svg_figure(int(tall + 2 * MARGIN), title, parts)


def rig_outline_figure(point: OperatingPoint, places: list[str]) -> str:
    """Figure of the rig's outline at the middle of its poses, places of findings marked."""
    k, drawn = point, Outline()
    T, colour = k.T.mean(), _part_colours(places)
    m = k.design.mechanism
    if isinstance(m, Hexapod):
        _hexapod(drawn, m, T, colour)
    elif isinstance(m, Planar2):
        _planar(drawn, m, T, colour)
    if k.design.targets:
        _targets(drawn, k, T, colour)
    for camera in k.design.cameras if k.seen is not None else ():
        _camera(drawn, camera, colour(str(Place("camera", camera.name)), "cameras"), T.translation)
    whole = [
        (place, MARKS[n % len(MARKS)])
        for n, place in enumerate(places)
        if Place.parse(place).kind in ("rig", "clock", "cameras", "markers")
    ]
    return drawn.figure(f"the rig in outline, marked: {', '.join(places) or 'nothing'}", whole)


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
    for around in (np.array(closed_outline(joints)) for joints in (m.base_joints, tops)):
        drawn.patch(around[:-1], "plate")
        drawn.line(around, colour("rig"))
    for i in range(6):
        c = colour(str(Place.axis("strut", i)), "rig")
        drawn.line([m.base_joints[i], tops[i]], c, str(Place.axis("strut", i)))
        drawn.label(0.62 * m.base_joints[i] + 0.38 * tops[i], str(i + 1), c)


def _planar(drawn: Outline, m: Planar2, T: RigidTransform, colour: Colour) -> None:
    for i, joint in enumerate(m.base_joints):
        c = colour(str(Place.axis("strut", i)), "rig")
        drawn.line([np.r_[joint, 0], T.translation], c, str(Place.axis("strut", i)))
        drawn.label((np.r_[joint, 0] + T.translation) / 2, str(i + 1), c)


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
