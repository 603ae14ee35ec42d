"""Servo lag: the drive follows its command with a first-order lag."""

from dataclasses import dataclass
from typing import ClassVar

from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import lagged_path
from rig.effects.framework.machine_motion_and_play import Motion, Path
from rig.effects.framework.parameters_covariates_and_marker_table import Covariate, Parameter, travel_covariate


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
        return path if self.time_constant <= 0 else lagged_path(path, self.time_constant, self.axes(places) > 0)

    def covariate(self, motion: Motion) -> Covariate:
        return travel_covariate(motion.path.speed, motion, "speed of the axis", "/s")
