"""Physical effects of a calibration, and their compensation in commands.

Effects are stored with a calibration, and commands compensate them.

The one forward model of motion (rig.model.machine_motion_simulation) says what commands become, by their whole
history, the sensors and the pose. Sought are commands that become what the geometry asks for at every wanted pose: a
fixed point over the whole route at once, in which the step of an axis grows while it has no effect, as it has none
within a gap.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.machine_correction import AnyCorrection
from calib.correction.timed_command_sequence_and_pose_space_correction_map import Route
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import MOTION_STAGES, Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import Coordinate, fit_coordinates_of_effects
from rig.effects.framework.unmodelled_curve_and_formula_quantities import TIME
from rig.errors import NotConverged, RigError
from rig.formats.numbers_and_units import quantity_text
from rig.model import machine_motion_simulation as machine
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.base_and_link_tilt_sensors import GRAVITY, BaseTilt, has_gravity_sensor_channels
from rig.model.design import Actuator, Design, Platform
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.model.mechanisms.arm_kinematics_limits_and_loads import hand_pose_of_each_row
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Parallel, has_links, is_parallel
from rig.model.mechanisms.redundant_strut_best_six_legs_and_loop_closures import with_follower_struts_of
from rig.model.pose import exp
from rig.recording.recording_folder import Commands, Sensors, sensors_with_gravity

MOST_LEFT = 0.5  # share of what has no name that curves may leave of it
ANOTHER_DAY = 2.0  # K, standard deviation by which a room and its struts differ from one day to another


@dataclass(frozen=True, slots=True)
class Unknown:
    """What no catalogued effect explains. place; magnitude, in unit; depends_on : covariates; corrected : whether a
    smooth function over the configuration space takes it out
    by : covariates of the smooth curves that undo some of it, none without; held_out : its RMS on held-out poses
    without these curves and with them, noise taken off, in held_out_unit, m or rad."""

    place: str
    magnitude: float
    unit: str
    depends_on: tuple[str, ...]
    corrected: bool
    by: tuple[str, ...] = ()
    held_out: tuple[float, float] = (0.0, 0.0)
    held_out_unit: str = "m"

    @property
    def undone(self) -> bool:
        """Whether corrections take most of it out."""
        return self.corrected or (bool(self.by) and self.held_out[1] <= MOST_LEFT * self.held_out[0])

    def sentence(self) -> str:
        """What is undone of it, or why nothing is."""
        at = Place.parse(self.place)
        if self.by:
            before, after = self.held_out
            gained, whole = (quantity_text(v, self.held_out_unit) for v in (max(before - after, 0.0), before))
            sentence = f"a smooth curve undoes {gained} of {whole} (held out)"
            sentence += "; over time it holds within the recorded time only" if TIME in self.by else ""
            return f"unknown at {self.place}, by {' and '.join(self.by)}: {sentence}"
        if self.corrected:
            reason = "corrected as a smooth function of the configuration"
        elif at.kind in ("camera", "cameras", "marker", "markers", "target"):
            reason = "not corrected, as it changes what cameras see and no command undoes it"
        elif not at.is_axis:
            reason = "not corrected, as it belongs to no single axis"
        elif not self.depends_on:
            reason = "not corrected, as it is scatter that follows nothing recorded"
        else:
            reason = (
                "not corrected, as no smooth function of configuration, time, travel, history or a sensor reduces the "
                "held-out error"
            )
        return f"unknown at {self.place}: {reason}"


@dataclass(frozen=True, slots=True, eq=False)
class Physics:
    """effects : Effects found; own : (c, c) covariance of their coordinates
    (rig.effects.framework.effect_checks_and_fit_coordinates), in
    order; cross : (p, c) of the geometry's p parameters with these; gravity, actuator, platform : of the machine as its
    owner states them, which effects look at
    channels : {sensor channel: (median, standard deviation)} while all this was learnt; unknown : what has no name
    tilts : of the base, by which gravity turns."""

    effects: tuple[Effect, ...]
    own: Floats
    cross: Floats
    gravity: Floats
    actuator: Actuator
    platform: Platform
    channels: dict[str, tuple[float, float]]
    unknown: tuple[Unknown, ...] = ()
    tilts: tuple[BaseTilt, ...] = ()

    @property
    def coordinates(self) -> list[Coordinate]:
        """[Coordinate] of the effects' parameters, in the order of the covariance."""
        return fit_coordinates_of_effects(self.effects)

    def machine(self, mechanism: Parallel | Arm | Chain) -> Design:
        """Design of a mechanism with what effects look at besides; it has no cameras."""
        return Design("", self.gravity, mechanism, None, self.actuator, self.platform, (), (), tilts=self.tilts)

    def sensed(self, sensors: Sensors | None, t: Floats) -> tuple[Sensors, tuple[str, ...]]:
        """(Sensors with every channel that physics was learnt with, names of those that were missing and now stand at
        their median).

        t : (n,) s, the times at which they are asked for
        """
        recorded = Sensors(np.array([t[0], t[-1] + 1.0]), {}) if sensors is None else sensors
        follows = self._follows_tilts(recorded)
        missing = tuple(
            name for name in self.channels if name not in recorded.channels and not (follows and name in GRAVITY)
        )
        filled = {name: np.full(len(recorded.t), self.channels[name][0]) for name in missing}
        whole = replace(recorded, channels={**recorded.channels, **filled})
        return sensors_with_gravity(self.gravity, self.tilts, whole) if follows else whole, missing

    def _follows_tilts(self, sensors: Sensors) -> bool:
        """Whether gravity is worked out from tilts, which were logged when this was learnt or are now."""
        if not self.tilts or has_gravity_sensor_channels(sensors.channels):
            return False
        return {tilt.channel for tilt in self.tilts} <= {*self.channels, *sensors.channels}

    def displaced(self, sensors: Sensors, channel: str) -> Sensors:
        """Sensors with a channel by its `spread` beyond where it stands, and what follows it."""
        moved = {**sensors.channels, channel: sensors.channels[channel] + self.spread(channel)}
        if channel in {tilt.channel for tilt in self.tilts}:
            moved = {name: values for name, values in moved.items() if name not in GRAVITY}
            return sensors_with_gravity(self.gravity, self.tilts, replace(sensors, channels=moved))
        return replace(sensors, channels=moved)

    def spread(self, channel: str) -> float:
        """Standard deviation of a channel that nobody logs, as it was while this was learnt, and from day to day."""
        own = self.channels[channel][1]
        return float(np.hypot(own, ANOTHER_DAY)) if channel.endswith("temperature_C") else own

    def compensable_effects(self) -> tuple[Effect, ...]:
        """The effects of the machine's motion that it shows again, and that have a size, so that commands undo them."""
        return tuple(e for e in self._lasting_motion_effects() if not _has_no_size(e))

    def sizeless_effects(self) -> tuple[Effect, ...]:
        """Those like compensable effects, but of no size where the geometry is fitted with them: nothing is undone of
        them.
        """
        return tuple(e for e in self._lasting_motion_effects() if _has_no_size(e))

    def _lasting_motion_effects(self) -> tuple[Effect, ...]:
        """The effects of the machine's motion that it shows again."""
        return tuple(e for e in self.effects if e.lasting and e.stage in MOTION_STAGES)

    def scattering(self) -> tuple[Effect, ...]:
        """Those that it shows again, at no moment that anybody knows: what happened once is over."""
        return tuple(
            e
            for e in self.effects
            if not e.lasting and e.stage in MOTION_STAGES and not any(p.role == "moment" for p in e.parameters)
        )

    def with_effects(
        self, mechanism: Parallel | Arm | Chain, samples: Samples, commands: Commands, sensors: Sensors | None
    ) -> Samples:
        """Samples with what this physics says of their commands, which lasts; mechanism : fitted."""
        sensed, _ = self.sensed(sensors, samples.t)
        return samples_with_effects(self.machine(mechanism), samples, commands, self.compensable_effects(), sensed)


def _has_no_size(effect: Effect) -> bool:
    """Whether an effect changes nothing: every parameter that gives it its size is 0."""
    sizes = [c.read(effect) for c in fit_coordinates_of_effects((effect,)) if c.is_size]
    return bool(sizes) and not any(sizes)


def samples_with_effects(
    design: Design, samples: Samples, commands: Commands, effects: Sequence[Effect], sensors: Sensors | None
) -> Samples:
    """Samples with effects.

    They are applied to their commands, or taken off an arm's poses beyond its joints, in place of those that were
    before.
    """
    t, T = samples.t, samples.T_base_platform
    if is_parallel(design.mechanism):
        return replace(
            samples, known=machine.effective_commands(design, commands, t, T, effects, sensors) - samples.commanded
        )
    T = poses_with_predicted_rotations(design, samples)
    if samples.sway is not None:
        T = T * exp(samples.sway)
    values, sway = machine.effective_commands_and_sway(design, commands, t, T, effects, sensors, samples.hand)
    tilts = samples.tilts
    if tilts is not None:
        tilts = tilts.with_lean(machine.base_lean_rotation_vectors(design, commands, t, T, effects, sensors))
    if samples.sway is None and not sway.any():
        return replace(samples, known=values - samples.commanded, tilts=tilts)
    return replace(samples, known=values - samples.commanded, T_base_platform=T * exp(-sway), tilts=tilts, sway=sway)


def poses_with_predicted_rotations(design: Design, samples: Samples) -> RigidTransform:
    """Poses (n,) of an arm's samples, with predicted rotations.

    Where positions alone were measured, the joints predict rotations.
    Else they are those measured.
    """
    T = samples.T_base_platform
    if samples.measured != "position":
        return T
    m = design.mechanism
    if has_links(m):
        predicted = hand_pose_of_each_row(samples.effective, m, samples.hand)
    else:
        predicted = mechanisms.kinematics_of(m).forward(samples.effective, m)
    return RigidTransform.from_components(T.translation, predicted.rotation)


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

    correction: AnyCorrection
    physics: Physics | None
    logged: Sensors | None
    effects: tuple[Effect, ...] = field(init=False)
    sensors: Sensors = field(init=False)
    missing: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        sensors, missing = (
            (self.logged or Sensors(np.zeros(1), {}), ())
            if self.physics is None
            else self.physics.sensed(self.logged, np.zeros(1))
        )
        for name, value in (
            ("sensors", sensors),
            ("missing", missing),
            ("effects", () if self.physics is None else self.physics.compensable_effects()),
        ):
            object.__setattr__(self, name, value)

    def effective(self, commands: Commands, t: Floats, T: RigidTransform) -> Floats:
        """(n, axes) m or rad that the fitted geometry gets of commands at times t (n,) s and poses T (n,)."""
        return self.reached(commands, t, T)[0]

    def reached(
        self,
        commands: Commands,
        t: Floats,
        T: RigidTransform,
        effects: tuple[Effect, ...] | None = None,
        sensors: Sensors | None = None,
    ) -> tuple[Floats, Floats]:
        """(the same, (n, 6) m and rad by which an arm's hand stands beyond that, which of struts counts as their
        length). effects, sensors : in place of its own
        """
        effects = self.effects if effects is None else effects
        lengths, sway = commands.at(t), np.zeros((len(t), 6))
        if self.physics is not None and effects:
            design = self.physics.machine(with_follower_struts_of(self.correction.fitted, None))
            sensed = sensors or self.sensors
            if is_parallel(design.mechanism):
                lengths = motion_simulation.effective_commands(design, commands, t, T, effects, sensed)
            else:
                lengths, sway = motion_simulation.effective_commands_and_sway(design, commands, t, T, effects, sensed)
        return lengths - self.correction.rho(lengths), sway


def compensated_commands_at_poses(machine: Machine, T: RigidTransform, route: Route, guess: Floats) -> Floats:
    """Commands (n, axes) m or rad at the poses T (n,) of a Route, with effects and their history compensated.

    guess : (n, axes), near

    Raises NotConverged with index, commands and residual of the poses for which none is found, to 1e-10 m or rad
    """
    t, commands, swayed = route.times, guess.copy(), np.zeros((len(guess), 6))
    goal = machine.correction.goal(T, guess)
    before, size = np.zeros_like(guess), np.ones_like(guess)
    for _ in range(ITERATIONS):
        lengths, sway = machine.reached(route.commands(commands), t, T)
        if np.abs(sway - swayed).max(initial=0.0) > SWAYED * TOLERANCE:
            goal, swayed = machine.correction.goal(T * exp(-sway), commands), sway
        left = goal - lengths
        if np.abs(left).max(initial=0.0) < TOLERANCE:
            return commands
        stuck = (np.abs(left) > STUCK * np.abs(before)) & (left * before > 0)
        size = np.where(stuck, 2 * size, 1.0)
        commands, before = commands + size * left, left
    worst = np.abs(left).max(axis=1)
    failed = np.flatnonzero(worst >= TOLERANCE)
    names = ", ".join(sorted({f"{e.name} at {e.place}" for e in machine.effects}))
    raise NotConverged(
        f"no commands were found for {len(failed)} of {len(worst)} poses, which leave {worst.max():.3g} "
        f"{mechanisms.travel_unit(machine.correction.fitted)} under {names}",
        failed,
        commands[failed],
        worst[failed],
    )


def travel_until_earlier_path_is_forgotten(machine: Machine) -> Floats:
    """Travel (axes,) until the earlier path is forgotten.

    Travel one way after which an axis' earlier path no longer matters.
    """
    places = mechanisms.axis_place_texts(machine.correction.fitted)
    return np.max([e.axes(places) * e.forgets() for e in machine.effects] or [np.zeros(len(places))], axis=0)


def command_uncertainty_from_unknown_history(
    machine: Machine, T: RigidTransform, route: Route, commands: Floats
) -> Floats:
    """Uncertainty (n, axes) of commands by the unknown history of motion before them.

    Half the change between a start approached from below and above.
    commands : (n, axes) at the poses
    """
    reach = travel_until_earlier_path_is_forgotten(machine)
    if not reach.any():
        return np.zeros_like(commands)
    own = route.commands(commands)
    ends = [
        Commands(np.r_[own.t[0] - LONG_AGO, own.t], np.vstack([route.start + side * reach, own.values]))
        for side in (-1.0, 1.0)
    ]
    return np.abs(machine.effective(ends[0], route.times, T) - machine.effective(ends[1], route.times, T)) / 2


def require_sensor_coverage(sensors: Sensors | None, t: Floats, display_time: Callable[[float], float]) -> None:
    """Raise RigError where poses at times t (n,) s lie outside the sensor log's coverage.
    One row alone states what does not change. display_time : from s to the owner's clock
    """
    if sensors is None or len(sensors.t) == 1:
        return
    apart = np.diff(sensors.t).max()
    outside = t[(t < sensors.t[0] - apart) | (t > sensors.t[-1] + apart)]
    if len(outside):
        raise RigError(
            f"the sensors' log runs from t = {display_time(sensors.t[0]):g} to {display_time(sensors.t[-1]):g} s, and "
            f"{len(outside)} poses are to be held "
            f"outside it, the first at {display_time(outside[0]):g} s; extend the log, or omit the sensors"
        )
