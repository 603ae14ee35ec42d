"""Physics that was found to be left out of a geometry, kept with it so that commands can undo it: effects, how sure
they are, what they look at.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.samples.pose_samples import Samples
from rig.effects.framework.effect import MOTION_STAGES, Effect
from rig.effects.framework.fit_coordinates import Coordinate, coordinates_of
from rig.model import motion_simulation as machine
from rig.model.design import Actuator, Arm, Chain, Design, Platform
from rig.model.mechanism_kinds import Struts
from rig.model.pose import exp
from rig.recording.recording_folder import Commands, Sensors

ANOTHER_DAY = 2.0  # K, standard deviation by which a room and its struts differ from one day to another


@dataclass(frozen=True, slots=True)
class Unknown:
    """What nothing in the catalogue explains. place; magnitude, in unit; depends_on : covariates; corrected : whether a
    smooth function over the configuration space takes it out."""

    place: str
    magnitude: float
    unit: str
    depends_on: tuple[str, ...]
    corrected: bool


@dataclass(frozen=True, slots=True, eq=False)
class Physics:
    """effects : Effects found; own : (c, c) covariance of their coordinates (rig.effects.framework.fit_coordinates), in
    order; cross : (p, c) of the geometry's p parameters with these; gravity, actuator, platform : of the machine as its
    owner states them, which effects look at
    channels : {sensor channel: (median, standard deviation)} while all this was learnt; unknown : what has no name."""

    effects: tuple[Effect, ...]
    own: np.ndarray
    cross: np.ndarray
    gravity: np.ndarray
    actuator: Actuator
    platform: Platform
    channels: dict[str, tuple[float, float]]
    unknown: tuple[Unknown, ...] = ()

    @property
    def coordinates(self) -> list[Coordinate]:
        """[Coordinate] of the effects' parameters, in the order of the covariance."""
        return coordinates_of(self.effects)

    def machine(self, mechanism: Struts | Arm | Chain) -> Design:
        """Design of a mechanism with what effects look at besides; it has no cameras."""
        return Design("", self.gravity, mechanism, None, self.actuator, self.platform, (), ())

    def sensed(self, sensors: Sensors | None, t: np.ndarray) -> tuple[Sensors, tuple[str, ...]]:
        """(Sensors with every channel that physics was learnt with, names of those that were missing and now stand at
        their median).

        t : (n,) s, the times at which they are asked for
        """
        there = Sensors(np.array([t[0], t[-1] + 1.0]), {}) if sensors is None else sensors
        missing = tuple(name for name in self.channels if name not in there.channels)
        filled = {name: np.full(len(there.t), self.channels[name][0]) for name in missing}
        return Sensors(there.t, {**there.channels, **filled}), missing

    def spread(self, channel: str) -> float:
        """Standard deviation of a channel that nobody logs, as it was while this was learnt, and from day to day."""
        own = self.channels[channel][1]
        return float(np.hypot(own, ANOTHER_DAY)) if channel.endswith("temperature_C") else own

    def compensable_effects(self) -> tuple[Effect, ...]:
        """The effects of the machine's motion that it shows again, so that commands undo them."""
        return tuple(e for e in self.effects if e.lasting and e.stage in MOTION_STAGES)

    def scattering(self) -> tuple[Effect, ...]:
        """Those that it shows again, at no moment that anybody knows: what happened once is over."""
        return tuple(
            e
            for e in self.effects
            if not e.lasting and e.stage in MOTION_STAGES and not any(p.role == "moment" for p in e.parameters)
        )

    def with_effects(
        self, mechanism: Struts | Arm | Chain, samples: Samples, commands: Commands, sensors: Sensors | None
    ) -> Samples:
        """Samples with what this physics says of their commands, which lasts; mechanism : fitted."""
        there, _ = self.sensed(sensors, samples.t)
        return samples_with_effects(self.machine(mechanism), samples, commands, self.compensable_effects(), there)


def samples_with_effects(
    design: Design, samples: Samples, commands: Commands, effects: Sequence[Effect], sensors: Sensors | None
) -> Samples:
    """Samples with what effects do to their commands; what they do to an arm beyond its joints is taken off its
    poses.
    """
    t, T = samples.t, samples.T_base_platform
    if not isinstance(design.mechanism, Arm):
        return replace(
            samples, known=machine.effective_commands(design, commands, t, T, effects, sensors) - samples.commanded
        )
    values, sway = machine.effective_commands_and_sway(design, commands, t, T, effects, sensors)
    return replace(samples, known=values - samples.commanded, T_base_platform=T * exp(-sway) if sway.any() else T)
