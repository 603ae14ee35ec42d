"""The rig in outline, with the parts that a diagnosis points at marked."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import RigidTransform

from calib.diagnose.problems.platform.operating_point import OperatingPoint
from rig.design import Camera, Hexapod, Planar2
from rig.pose import transform_points
from vision.targets import marker_map

AZIMUTH, ELEVATION = np.radians(-65), np.radians(24)  # from where the rig is looked at
MARKS = ("crimson", "darkorange", "purple", "teal", "saddlebrown", "deeppink")  # of the first, second, .. finding
PLAIN = "0.55"
CAMERA_DISTANCE = 0.6  # of their distance at which cameras are drawn


def schematic(point: OperatingPoint, places: list[str]) -> Figure:
    """Figure of the rig at the middle of its poses. point : OperatingPoint; places : of the findings, in their order"""
    k = point
    figure = Figure(figsize=(7.5, 5.2), layout="constrained")
    axes = figure.subplots()
    T = k.T.mean()
    colour = _colours(places)
    m = k.design.mechanism
    if isinstance(m, Hexapod):
        _hexapod(axes, m, T, colour)
    elif isinstance(m, Planar2):
        _planar(axes, m, T, colour)
    if k.design.targets:
        _targets(axes, k, T, colour)
    for camera in k.design.cameras if k.seen is not None else ():
        _camera(axes, camera, colour(f"camera {camera.name}", "cameras"), T.translation)
    for n, place in enumerate(places):
        if place.split(" ")[0] in ("rig", "clock", "cameras", "markers"):
            axes.text(0.01, 0.99 - 0.05 * n, place, color=MARKS[n % len(MARKS)], transform=axes.transAxes, va="top", fontweight="bold",
                      bbox={"boxstyle": "round", "fc": "white", "ec": MARKS[n % len(MARKS)]})
    axes.set_aspect("equal")
    axes.axis("off")
    return figure


def _colours(places: list[str]) -> Callable[..., str]:
    """A function from a part's place (and what takes it in) to its colour, PLAIN where nothing is the matter."""
    def colour(*names: str) -> str:
        return next((MARKS[n % len(MARKS)] for n, place in enumerate(places) if place in names), PLAIN)

    return colour


def _flat(points: np.ndarray) -> np.ndarray:
    """(..., 2) of points (..., 3) seen from far away."""
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0])
    up = np.array([-np.sin(ELEVATION) * np.cos(AZIMUTH), -np.sin(ELEVATION) * np.sin(AZIMUTH), np.cos(ELEVATION)])
    return np.stack([points @ right, points @ up], axis=-1)


def _line(axes: Axes, points: Any, colour: str, **more: Any) -> None:
    marked = colour != PLAIN
    axes.plot(*_flat(np.asarray(points, float)).T, **{"color": colour, "lw": 4 if marked else 1.2, "zorder": 3 if marked else 2, **more})


def _label(axes: Axes, point: np.ndarray, text: str, colour: str) -> None:
    axes.annotate(text, tuple(_flat(np.asarray(point, float))), color="black" if colour == PLAIN else colour, fontsize=8, ha="center", va="center",
                  fontweight="normal" if colour == PLAIN else "bold", zorder=5, bbox={"fc": "white", "ec": "none", "pad": 0.6, "alpha": 0.8})


def _hexapod(axes: Axes, m: Hexapod, T: RigidTransform, colour: Callable[..., str]) -> None:
    tops = transform_points(T, m.platform_joints)
    for joints, name in ((m.base_joints, "base"), (tops, "platform")):
        around = np.argsort(np.arctan2(*(joints - joints.mean(axis=0))[:, 1::-1].T))
        _line(axes, joints[np.r_[around, around[0]]], colour("rig"), lw=1.6)
        axes.fill(*_flat(joints[around]).T, color="0.85" if name == "platform" else "0.92", zorder=1)
    for i in range(6):
        c = colour(f"strut {i + 1}", "rig")
        _line(axes, [m.base_joints[i], tops[i]], c)
        _label(axes, 0.62 * m.base_joints[i] + 0.38 * tops[i], str(i + 1), c)


def _planar(axes: Axes, m: Planar2, T: RigidTransform, colour: Callable[..., str]) -> None:
    for i, joint in enumerate(m.base_joints):
        c = colour(f"strut {i + 1}", "rig")
        _line(axes, [np.r_[joint, 0], T.translation], c)
        _label(axes, (np.r_[joint, 0] + T.translation) / 2, str(i + 1), c)


def _targets(axes: Axes, k: OperatingPoint, T: RigidTransform, colour: Callable[..., str]) -> None:
    markers = marker_map(k.stated)
    base = np.where(markers.on_platform[:, None, None], transform_points(T, markers.corners), markers.corners)
    for n, quad in enumerate(base):
        c = colour(f"marker {markers.id[n]}", f"target {markers.target[n]}", "markers")
        _line(axes, quad[[0, 1, 2, 3, 0]], c, lw=2.5 if c != PLAIN else 0.6)
        if colour(f"marker {markers.id[n]}") != PLAIN:
            axes.fill(*_flat(quad).T, color=c, zorder=4)
            _label(axes, quad.mean(axis=0), str(markers.id[n]), c)
    for target in k.stated.targets:
        own = base[[name == target.name for name in markers.target]]
        top = own.reshape(-1, 3)[own[..., 2].argmax()]
        _label(axes, np.r_[own.mean(axis=(0, 1))[:2], top[2]], target.name, colour(f"target {target.name}"))


def _camera(axes: Axes, camera: Camera, colour: str, middle: np.ndarray) -> None:
    half = np.array([camera.width / 2 / camera.matrix[0, 0], camera.height / 2 / camera.matrix[1, 1]])
    away = CAMERA_DISTANCE * (camera.pose.translation - middle)
    ends = 0.12 * np.linalg.norm(away) * np.array([[x * half[0], y * half[1], 1] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    tip, ends = middle + away, middle + away + ends @ camera.pose.rotation.as_matrix().T
    _line(axes, ends[[0, 1, 2, 3, 0]], colour, lw=2.2 if colour != PLAIN else 1)
    for end in ends:
        _line(axes, [tip, end], colour, lw=2.2 if colour != PLAIN else 1)
    _label(axes, tip, camera.name, colour)
