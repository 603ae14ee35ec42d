"""Physics not listed in the catalogue, and irregular corner noise.

Blind cases may hide both as unknown.

An effect out of the catalogue is one like any other, only that no diagnosis knows it; `random_unlisted_effect` makes
one of a plausible size. A disturbance changes nothing but the noise of corners: there, too, nothing may be named.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Markers, markers_with_replaced_columns
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera, Design
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod
from rig.model.pose import exp, transform_points
from rig.recording.corner_and_pose_csv_tables import Corners

WAVES = 4  # sinusoids of a smooth random course


@dataclass(frozen=True, slots=True)
class CablePull(Effect):
    """A cable from an anchor (3) m of the base frame pulls with tension N and spring N/m once it is tauter than slack
    m; the platform gives way by softness m/N and, about its origin, by softness / arm^2 rad/(N m)."""

    place: str
    anchor: tuple[float, ...]
    slack: float
    spring: float
    softness: float
    arm: float
    name: ClassVar = "cable_pull"
    stage: ClassVar = "structure"
    places: ClassVar = ("rig",)
    on_pose: ClassVar = True

    def deviation(self, motion: Motion) -> Floats:
        at = np.array([0.0, self.arm, 0.0])  # where the cable is tied, platform frame
        matrix = motion.poses().as_matrix()
        away = np.asarray(self.anchor) - (matrix[:, :3, :3] @ at + matrix[:, :3, 3])
        length = np.linalg.norm(away, axis=1, keepdims=True)
        force = self.spring * np.maximum(length - self.slack, 0) * away / length
        force = (np.swapaxes(matrix[:, :3, :3], 1, 2) @ force[..., None])[..., 0]
        give = np.concatenate([force, np.cross(at, force) / self.arm**2], axis=1) * self.softness
        return (hexapod.jacobian(motion.poses(), require_hexapod(motion.mechanism)) @ give[..., None])[..., 0]


@dataclass(frozen=True, slots=True)
class BendingStrut(Effect):
    """A strut sags sideways under its own weight and is the shorter, chord to arc, the flatter and the longer it is: by
    size m when level at its home length."""

    place: str
    size: float
    name: ClassVar = "bending_strut"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)
    on_pose: ClassVar = True

    def deviation(self, motion: Motion) -> Floats:
        matrix, m = motion.poses().as_matrix(), require_hexapod(motion.mechanism)
        struts = m.platform_joints @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3] - m.base_joints
        length = np.linalg.norm(struts, axis=2)
        level = 1 - (struts @ motion.gravity / np.linalg.norm(motion.gravity) / length) ** 2
        return -self.axes(motion.places) * self.size * level * (length / motion.home) ** 7


@dataclass(frozen=True, slots=True)
class WanderingBase(Effect):
    """The frame with the base joints wanders against the cubes on the base: course (WAVES * 8): amplitudes (6) m, rad,
    frequency Hz and phase of each wave."""

    place: str
    course: tuple[float, ...]
    name: ClassVar = "wandering_base"
    stage: ClassVar = "structure"
    places: ClassVar = ("rig",)
    on_pose: ClassVar = True

    def deviation(self, motion: Motion) -> Floats:
        moved = transform_points(exp(_course(self.course, motion.t, 6)), require_hexapod(motion.mechanism).base_joints)
        matrix, m = motion.poses().as_matrix(), require_hexapod(motion.mechanism)
        tips = m.platform_joints @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3]
        return np.linalg.norm(tips - m.base_joints, axis=2) - np.linalg.norm(tips - moved, axis=2)


@dataclass(frozen=True, slots=True)
class Crosstalk(Effect):
    """A strut takes a share of another's stroke, the more the farther out: its square over its reach m, with the sign
    of the stroke.
    """

    place: str
    other: int
    share: float
    reach: float
    name: ClassVar = "crosstalk"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)

    def deviation(self, motion: Motion) -> Floats:
        stroke = motion.stroke[:, [self.other - 1]]
        return self.axes(motion.places) * self.share * stroke * np.abs(stroke) / self.reach


@dataclass(frozen=True, slots=True)
class SlippingClutch(Effect):
    """A strut loses a share of every metre that it travels, whichever way."""

    place: str
    share: float
    name: ClassVar = "slipping_clutch"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)

    def deviation(self, motion: Motion) -> Floats:
        return -self.axes(motion.places) * self.share * motion.path.way


@dataclass(frozen=True, slots=True)
class Drag(Effect):
    """All struts fall back by factor (s^2/m) times the square of their speed."""

    place: str
    factor: float
    name: ClassVar = "drag"
    stage: ClassVar = "struts"
    places: ClassVar = ("rig",)

    def deviation(self, motion: Motion) -> Floats:
        speed = motion.path.speed
        return -self.factor * speed * np.abs(speed)


@dataclass(frozen=True, slots=True)
class BreathingLens(Effect):
    """A focal length comes and goes with no temperature: course (WAVES * 3): share, frequency Hz and phase of each
    wave.
    """

    place: str
    course: tuple[float, ...]
    name: ClassVar = "breathing_lens"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)

    def focal(self, camera: Camera, t: Floats, channel: Callable[..., Floats]) -> Floats:
        return 1 + _course(self.course, t, 1)[:, 0] * self.at(Place("camera", camera.name))


@dataclass(frozen=True, slots=True)
class SwayingTripod(Effect):
    """A mount sways, motion (6) m, rad, as the sine of time at a frequency (Hz)."""

    place: str
    motion: tuple[float, ...]
    frequency: float
    name: ClassVar = "swaying_tripod"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)

    def mount(self, camera: Camera, t: Floats, channel: Callable[..., Floats]) -> Floats:
        return (
            np.sin(2 * np.pi * self.frequency * t)[:, None]
            * np.asarray(self.motion)
            * self.at(Place("camera", camera.name))
        )


@dataclass(frozen=True, slots=True)
class UnevenPrint(Effect):
    """Every marker is printed in a size of its own: scales, one of each marker in the map's order."""

    place: str
    scales: tuple[float, ...]
    name: ClassVar = "uneven_print"
    stage: ClassVar = "targets"
    places: ClassVar = ("markers",)

    def attach(self, markers: Markers) -> Markers:
        return markers_with_replaced_columns(markers, side=markers.side * (1 + np.asarray(self.scales)))


def _course(course: tuple[float, ...], t: Floats, size: int) -> Floats:
    """(n, size) a sum of waves at times t (n,) s; course : size amplitudes, frequency (Hz) and phase of each."""
    out = np.zeros((len(t), size))
    for *amplitude, frequency, phase in np.reshape(course, (-1, size + 2)):
        out += np.sin(2 * np.pi * frequency * t + phase)[:, None] * amplitude
    return out


def random_unlisted_effect(design: Design, duration: float, rng: np.random.Generator) -> Effect:
    """Unlisted effect (not in the catalogue) drawn at random, of a plausible size.

    Raises RigError for a rig that lacks what it needs.
    """
    m = require_hexapod(design.mechanism)
    radius, stroke = float(np.linalg.norm(m.base_joints, axis=1).mean()), float(np.ptp(m.strut_range, axis=1).mean())
    strut = str(Place("strut", str(rng.integers(1, 7))))
    camera = str(Place("camera", design.cameras[rng.integers(len(design.cameras))].name))

    def waves(size: int, scale: float) -> tuple[float, ...]:
        rows = [
            np.r_[scale / np.sqrt(WAVES) * rng.normal(size=size), rng.uniform(1.5, 8) / duration, rng.uniform(0, 6.28)]
            for _ in range(WAVES)
        ]
        return tuple(np.concatenate(rows).tolist())

    name = OUT_OF_CATALOGUE[rng.integers(len(OUT_OF_CATALOGUE))]
    if name is CablePull:
        anchor = radius * np.array([rng.uniform(-1.5, 1.5), rng.uniform(-1.5, 1.5), rng.uniform(2.5, 4)])
        length = float(np.linalg.norm(anchor - m.home.translation))
        return CablePull(
            "rig",
            tuple(anchor.tolist()),
            length * rng.uniform(0.9, 1.0),
            _log(rng, 2e-5, 5e-4) / (0.1 * length) / 1e-6,
            1e-6,
            radius * 0.5,
        )
    if name is BendingStrut:
        return BendingStrut(strut, _log(rng, 1e-4, 2e-3))
    if name is WanderingBase:
        return WanderingBase("rig", waves(6, _log(rng, 5e-6, 1e-4)))
    if name is Crosstalk:
        return Crosstalk(
            strut,
            int((int(strut[-1]) + rng.integers(1, 6) - 1) % 6 + 1),
            rng.choice([-1, 1]) * _log(rng, 2e-4, 4e-3),
            0.5 * stroke,
        )
    if name is SlippingClutch:
        return SlippingClutch(strut, _log(rng, 2e-5, 3e-4) / (100 * stroke))
    if name is Drag:
        if design.actuator.max_speed is None:
            raise RigError("drag takes [actuator] max_speed in rig.toml")
        return Drag("rig", _log(rng, 1e-5, 2e-4) / (design.actuator.max_speed / 4) ** 2)
    if name is BreathingLens:
        return BreathingLens(camera, waves(1, _log(rng, 2e-5, 5e-4)))
    if name is SwayingTripod:
        motion = rng.normal(size=6) * _log(rng, 2e-5, 5e-4)
        return SwayingTripod(camera, tuple(motion.tolist()), 1 / rng.uniform(30, 300))
    return UnevenPrint(
        "markers", tuple((_log(rng, 3e-4, 5e-3) * rng.normal(size=sum(len(t.ids) for t in design.targets))).tolist())
    )


OUT_OF_CATALOGUE = (
    CablePull,
    BendingStrut,
    WanderingBase,
    Crosstalk,
    SlippingClutch,
    Drag,
    BreathingLens,
    SwayingTripod,
    UnevenPrint,
)


def _add_air_shimmer(corners: Corners, design: Design, noise: float, rng: np.random.Generator) -> Corners:
    """Every picture is warped a little by the air, smoothly over the image and anew from frame to frame: 1 to 4 times
    the noise.
    """
    size = noise * rng.uniform(1, 4)
    uv = corners.uv.copy()
    camera = np.array(corners.camera)
    for c in design.cameras:
        rows = np.flatnonzero(camera == c.name)
        x = (uv[rows] - [c.width / 2, c.height / 2]) / (c.width / 2)
        basis = np.stack(
            [np.cos(i * x[:, 0] + 1.7 * i) * np.cos(j * x[:, 1] + 0.9 * j) for i in range(3) for j in range(3)], axis=1
        )
        warps = size / 3 * rng.normal(size=(corners.frame.max() + 1, 9, 2))
        uv[rows] += np.einsum("nk,nkc->nc", basis, warps[corners.frame[rows]])
    return replace(corners, uv=uv)


def _add_outliers(corners: Corners, design: Design, noise: float, rng: np.random.Generator) -> Corners:
    """Up to one corner in thirty lies somewhere else, by 1 to 30 px."""
    wrong = rng.random(len(corners.uv)) < rng.uniform(0.005, 0.03)
    direction = rng.normal(size=corners.uv.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return replace(
        corners, uv=corners.uv + wrong[:, None] * direction * np.exp(rng.uniform(0, np.log(30), (len(wrong), 1)))
    )


def _add_uneven_noise(corners: Corners, design: Design, noise: float, rng: np.random.Generator) -> Corners:
    """Noise grows towards the edges of the image, threefold, and one camera is twice as noisy as the others."""
    radius = np.linalg.norm(corners.uv - np.median(corners.uv, axis=0), axis=1) / 600
    worse = np.where(np.array(corners.camera) == design.cameras[rng.integers(len(design.cameras))].name, 2.0, 1.0)
    extra = noise * np.sqrt((1 + 2 * np.minimum(radius, 1)) ** 2 * worse**2 - 1)
    return replace(corners, uv=corners.uv + extra[:, None] * rng.normal(size=corners.uv.shape))


def _add_heavy_tailed_noise(corners: Corners, design: Design, noise: float, rng: np.random.Generator) -> Corners:
    """Noise has the tails of Student's t with three degrees of freedom."""
    return replace(corners, uv=corners.uv + noise * rng.standard_t(3, size=corners.uv.shape))


def _add_shaken_frames(corners: Corners, design: Design, noise: float, rng: np.random.Generator) -> Corners:
    """One frame in fifteen was shaken: all its corners are five times as noisy."""
    shaken = rng.random(corners.frame.max() + 1) < 1 / 15
    return replace(
        corners, uv=corners.uv + 5 * noise * shaken[corners.frame][:, None] * rng.normal(size=corners.uv.shape)
    )


DISTURBANCES = (_add_air_shimmer, _add_outliers, _add_uneven_noise, _add_heavy_tailed_noise, _add_shaken_frames)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
