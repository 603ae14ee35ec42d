"""Commands that give wanted poses of a machine whose physics is known: what it does by itself is undone, whatever
effect it comes from.

The one forward model of motion (rig.model.motion_simulation) says what commands become, by their whole history, the
sensors and the pose. Sought are commands that become what the geometry asks for at every wanted pose: a fixed point
over the whole route at once, in which the step of an axis grows while it has no effect, as it has none within a gap.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correct.correction import Correction
from calib.correct.physics import Physics
from calib.correct.pose_route import Route
from rig.effects.framework.effect import Effect
from rig.errors import NotConverged, RigError
from rig.model import mechanisms, motion_simulation
from rig.model.design import Arm
from rig.model.pose import exp
from rig.recording.recording_folder import Commands, Sensors

ITERATIONS = 300
TOLERANCE = 1e-10  # m or rad, to which commands are written
SWAYED = 0.1  # of the tolerance, by which a hand may stand elsewhere before its joints are sought anew
STUCK = 0.5  # of the last step; an axis that is left with more than this, on the same side, takes twice the step next
LONG_AGO = 1e6  # s before a route, when the axes may have come to its start from either side


@dataclass(frozen=True, slots=True, eq=False)
class Machine:
    """A corrected machine under sensors. correction : Correction; physics : Physics or None; logged : Sensors or None
    effects : the Effects that act, those of the physics that commands undo; sensors : Sensors with the channels that
    nobody logged, `missing`, at their median"""

    correction: Correction[Any, Any]
    physics: Physics | None
    logged: Sensors | None
    effects: tuple[Effect, ...] = field(init=False)
    sensors: Sensors = field(init=False)
    missing: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        there, missing = (
            (self.logged or Sensors(np.zeros(1), {}), ())
            if self.physics is None
            else self.physics.sensed(self.logged, np.zeros(1))
        )
        for name, value in (
            ("sensors", there),
            ("missing", missing),
            ("effects", () if self.physics is None else self.physics.compensable_effects()),
        ):
            object.__setattr__(self, name, value)

    def effective(
        self,
        commands: Commands,
        t: np.ndarray,
        T: RigidTransform,
        effects: tuple[Effect, ...] | None = None,
        sensors: Sensors | None = None,
    ) -> np.ndarray:
        """(n, axes) m or rad that the fitted geometry gets of commands at times t (n,) s and poses T (n,). effects,
        sensors : in place of its own
        """
        return self.reached(commands, t, T, effects, sensors)[0]

    def reached(
        self,
        commands: Commands,
        t: np.ndarray,
        T: RigidTransform,
        effects: tuple[Effect, ...] | None = None,
        sensors: Sensors | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(the same, (n, 6) m and rad by which an arm's hand stands beyond that, which of struts counts as their
        length).
        """
        effects = self.effects if effects is None else effects
        lengths, sway = commands.at(t), np.zeros((len(t), 6))
        if self.physics is not None and effects:
            design, sensed = self.physics.machine(self.correction.fitted), sensors or self.sensors
            if isinstance(design.mechanism, Arm):
                lengths, sway = motion_simulation.effective_commands_and_sway(design, commands, t, T, effects, sensed)
            else:
                lengths = motion_simulation.effective_commands(design, commands, t, T, effects, sensed)
        return lengths - self.correction.rho(lengths), sway


def commands_at_poses(of: Machine, T: RigidTransform, route: Route, guess: np.ndarray) -> np.ndarray:
    """(n, axes) m or rad to command at the poses T (n,) of a Route, each row's history that of the rows before.
    guess : (n, axes), near

    Raises NotConverged with index, commands and residual of the poses for which none is found, to 1e-10 m or rad
    """
    t, commands, swayed = route.times, guess.copy(), np.zeros((len(guess), 6))
    goal = of.correction.goal(T, guess)
    before, size = np.zeros_like(guess), np.ones_like(guess)
    for _ in range(ITERATIONS):
        lengths, sway = of.reached(route.commands(commands), t, T)
        if np.abs(sway - swayed).max(initial=0.0) > SWAYED * TOLERANCE:
            goal, swayed = of.correction.goal(T * exp(-sway), commands), sway
        left = goal - lengths
        if np.abs(left).max(initial=0.0) < TOLERANCE:
            return commands
        stuck = (np.abs(left) > STUCK * np.abs(before)) & (left * before > 0)
        size = np.where(stuck, 2 * size, 1.0)
        commands, before = commands + size * left, left
    worst = np.abs(left).max(axis=1)
    failed = np.flatnonzero(worst >= TOLERANCE)
    names = ", ".join(sorted({f"{e.name} at {e.place}" for e in of.effects}))
    raise NotConverged(
        f"no commands were found for {len(failed)} of {len(worst)} poses, which leave {worst.max():.3g} "
        f"{mechanisms.travel_unit(of.correction.fitted)} under {names}",
        failed,
        commands[failed],
        worst[failed],
    )


def path_memory_length(of: Machine) -> np.ndarray:
    """(axes,) m or rad that each axis must travel one way until it no longer matters how it came to the start."""
    places = mechanisms.axis_places(of.correction.fitted)
    return np.max([e.axes(places) * e.forgets() for e in of.effects] or [np.zeros(len(places))], axis=0)


def unknown_history_uncertainty(of: Machine, T: RigidTransform, route: Route, commands: np.ndarray) -> np.ndarray:
    """(n, axes) m or rad, half of what it changes whether the axes came to the start of a Route from below or from
    above: nobody knows which.

    commands : (n, axes) at the poses
    """
    reach = path_memory_length(of)
    if not reach.any():
        return np.zeros_like(commands)
    own = route.commands(commands)
    ends = [
        Commands(np.r_[own.t[0] - LONG_AGO, own.t], np.vstack([route.start + side * reach, own.values]))
        for side in (-1.0, 1.0)
    ]
    return np.abs(of.effective(ends[0], route.times, T) - of.effective(ends[1], route.times, T)) / 2


def require_sensor_coverage(sensors: Sensors | None, t: np.ndarray, show: Callable[[float], float]) -> None:
    """Raise RigError where poses are held at times t (n,) s farther outside a log than its rows are apart: nobody knows
    what is then.
    One row alone states what does not change. show : from s to the owner's clock"""
    if sensors is None or len(sensors.t) == 1:
        return
    apart = np.diff(sensors.t).max()
    outside = t[(t < sensors.t[0] - apart) | (t > sensors.t[-1] + apart)]
    if len(outside):
        raise RigError(
            f"the sensors' log runs from t = {show(sensors.t[0]):g} to {show(sensors.t[-1]):g} s, and "
            f"{len(outside)} poses are to be held "
            f"outside it, the first at {show(outside[0]):g} s; log on, or leave the sensors out"
        )
