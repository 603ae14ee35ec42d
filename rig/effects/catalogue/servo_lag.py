"""Servo lag: the drive follows its command with a first-order lag."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_parameters_and_covariates import Covariate, Parameter, travel_covariate
from rig.effects.framework.machine_motion_and_play import STEADY, Motion, Path, lagged_path

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
        own = self.axes(places) > 0
        turned = np.abs(np.diff(path.speeds[:, own], axis=0)).max(axis=1) > STEADY * np.abs(path.speeds).max()
        path = path.with_knots((path.t[:-1][turned, None] + AFTER * self.time_constant).ravel())
        return replace(
            path, lengths=np.where(self.axes(places) > 0, lagged_path(path, self.time_constant), path.lengths)
        )

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.speed, motion, "speed of the axis", "/s")
