"""Servo lag: the drive follows its command with a first-order lag."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.compute.numba_kernels_and_lazy_exports import njit
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_parameters_and_covariates import Covariate, Parameter, travel_covariate
from rig.effects.framework.machine_motion_and_play import Motion, Path

AFTER = np.array([0.25, 0.5, 1, 2, 4, 8])  # time constants after a change of speed at which the path gets a knot


@dataclass(frozen=True, slots=True)
class ServoLag(Effect):
    """The axes follow y with y' = (command - y) / time_constant, exactly for a command that is linear between knots."""

    place: str
    time_constant: float = 0.0
    name: ClassVar = "servo_lag"
    stage: ClassVar = "command"
    places: ClassVar = ("axis", "rig")
    parameters: ClassVar = (Parameter("time_constant", "s", (0, 1), (1e-3, 5e-2), role="size"),)
    moving: ClassVar = True
    experiment: ClassVar = (
        "expose soon after reversals at full speed (plan zigzag), or time the cameras by an external clock: "
        "all {axis}s alike is also a time offset"
    )
    action: ClassVar = "Raise the drive's gain or feed its speed forward; poses at rest are not touched."

    def follow(self, path: Path, places: tuple[str, ...]) -> Path:
        if self.time_constant <= 0:
            return path
        path = path.with_knots((path.t[:, None] + AFTER * self.time_constant).ravel())
        return replace(
            path, lengths=np.where(self.axes(places) > 0, lagged_path(path, self.time_constant), path.lengths)
        )

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.speed, motion, "speed of the axis", "/s")


def lagged_path(path: Path, time_constant: float) -> Floats:
    """Path lagged by a first-order lag of a time constant, (m, axes) m or rad at its knots."""
    return path.walked(lambda t, lengths: first_order_lag(t, lengths, time_constant))


def first_order_lag(t: Floats, x: Floats, time_constant: float) -> Floats:
    """First-order lag (m, axes) of x (m, axes), linear between knots t (m,); it starts at rest, y = x."""
    return _lag(np.ascontiguousarray(t, dtype=float), np.ascontiguousarray(x, dtype=float), float(time_constant))


@njit(cache=True)
def _lag(t: Floats, x: Floats, time_constant: float) -> Floats:
    out = np.empty_like(x)
    out[0] = x[0]
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        fade = np.exp(-dt / time_constant)
        for i in range(x.shape[1]):
            behind = (x[k, i] - x[k - 1, i]) / dt * time_constant if dt > 0 else 0.0
            out[k, i] = x[k, i] - behind + (out[k - 1, i] - x[k - 1, i] + behind) * fade
    return out
