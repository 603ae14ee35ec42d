"""Commands for wanted poses through a calibration.

With approaches and the covariance of each pose.

Also poses to command a controller that takes poses: it computes strut lengths by its own nominal geometry, that of
rig.toml, so what is commanded is the nominal forward kinematics of the corrected lengths, in its frames and about its
pivot point.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Responses
from calib.correction.physical_effects_of_calibration_and_their_compensation import (
    Machine,
    Physics,
    command_uncertainty_from_unknown_history,
    compensated_commands_at_poses,
    travel_until_earlier_path_is_forgotten,
)
from calib.correction.timed_command_sequence_and_pose_space_correction_map import (
    Pace,
    Route,
    timed_route,
    untimed_route,
)
from calib.models.machine_parameters_and_file_entries import corrected_pose_covariance
from rig.array_and_json_types import Booleans, Floats
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import PoseFrames
from rig.effects.framework.effect_base_class import Effect
from rig.errors import NotConverged, Unreachable
from rig.model import mechanisms
from rig.model.machine_motion_simulation import motion_of_commands
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, require_hexapod
from rig.model.mechanisms.redundant_strut_best_six_legs_and_loop_closures import with_follower_struts_of
from rig.planning.recording_plan import SPEED, UNSTATED_SPEED
from rig.recording.recording_folder import Sensors

BEYOND = 1.2  # times what an axis remembers that an approach goes
ANY_TIME, GOLDEN = 60.0, 0.5 * (np.sqrt(5) - 1)  # s over which moments are spread, evenly and without a period


@dataclass(frozen=True, slots=True, eq=False)
class RouteCommands:
    """values : (n, axes) m or rad to command at the wanted poses; route : Route; T_base_platform : (n,) poses that come
    of them by the calibration, those wanted but for an arm of too few joints; covariance : (n, 6, 6) of these (m, rad,
    on the right), None for commands that were given;
    missing : sensor channels that nobody logged, whose spread is in it; uncovered : (what, number of poses) of what was
    learnt where these are not, whose usual size is in it."""

    values: Floats
    route: Route
    T_base_platform: RigidTransform
    covariance: Floats | None
    missing: tuple[str, ...]
    uncovered: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Spread:
    """covariance : (n, 6, 6) of poses; responses : Responses there; missing : channels that nobody logged and that
    change something; uncovered : as of RouteCommands
    """

    covariance: Floats
    responses: Responses
    missing: tuple[str, ...]
    uncovered: tuple[tuple[str, int], ...]


def pace_with_hold_times(calibration: Calibration, hold_times: Floats, sensors: Sensors | None) -> Pace:
    """Pace of a route whose poses are held at the hold times (n,) s."""
    top = calibration.physics.actuator.max_speed if calibration.physics is not None else None
    unstated = min(UNSTATED_SPEED[unit] for unit in mechanisms.axis_units(calibration.correction.nominal))
    begin = float(sensors.t[0]) if sensors is not None and len(sensors.t) > 1 else None
    return Pace(hold_times, begin, SPEED * top if top else unstated, top)


def commands_along_route(
    calibration: Calibration,
    T: RigidTransform,
    start: Floats,
    pace: Pace | None = None,
    sensors: Sensors | None = None,
    approach: str = "auto",
    commands_to_keep: Floats | None = None,
) -> RouteCommands:
    """Commands (RouteCommands) along a route of wanted poses T (n,), in their order.

    start : (axes,) m or rad, where the axes stand; pace : Pace, when the poses are held, or None: each until all has
        come to rest
    sensors : Sensors over that time, or None; approach : "auto" where it makes a pose surer, "always" or "never";
        without a pace there is none
    commands_to_keep : (n, axes) m or rad to command at the poses as they are, for comparison, or None
    Raises Unreachable for poses that come too soon, NotConverged where no commands are found; limits are for
        `require_commands_in_axis_ranges` to check
    """
    of = Machine(calibration.correction, calibration.physics, sensors)
    plain = calibration.correction.inverse_without_physics(T) if commands_to_keep is None else commands_to_keep
    T = calibration.correction.reached_poses(T, plain)
    route = untimed_route(plain, start) if pace is None else timed_route(pace, plain, start)
    if commands_to_keep is not None:
        return RouteCommands(commands_to_keep, route, T, None, ())
    values = compensated_commands_at_poses(of, T, route, plain) if of.effects else plain
    if calibration.physics is None:
        return RouteCommands(values, route, T, corrected_pose_covariance(calibration, T, values), ())
    base = _covariance(calibration, calibration.physics, of, T, (route, values))
    if pace is not None and approach != "never" and travel_until_earlier_path_is_forgotten(of).any():
        sure = _axes(base.covariance, base.responses.back) if approach == "auto" else None
        found = _approached(of, T, route, values, pace, sure)
        if found is not route:
            route, values = found, compensated_commands_at_poses(of, T, found, values)
            base = _covariance(calibration, calibration.physics, of, T, (route, values))
    doubt = (
        command_uncertainty_from_unknown_history(of, T, route, values) ** 2 / 3
    )  # anywhere between the two, as likely here as there
    forgotten = np.einsum("nij,nj,nkj->nik", base.responses.axes, doubt, base.responses.axes)
    return RouteCommands(values, route, T, base.covariance + forgotten, base.missing, base.uncovered)


def _approached(of: Machine, T: RigidTransform, route: Route, values: Floats, pace: Pace, sure: Floats | None) -> Route:
    """The Route with approaches. sure : (n, axes) m^2, variances that forgotten ways must exceed to be worth one; None:
    to every pose
    """
    n, (low, high) = len(values), mechanisms.kinematics_of(of.correction.nominal).travel_ranges(of.correction.nominal).T
    wanted, room = (
        BEYOND * travel_until_earlier_path_is_forgotten(of),
        values - BEYOND * travel_until_earlier_path_is_forgotten(of) >= low,
    )
    side = np.where(room, -wanted, np.where(values + wanted <= high, wanted, 0.0))
    possible = _exists(of, T, values + side)
    reach, refused = np.zeros_like(values), ~possible
    for _ in range(2 * n):
        if sure is None:
            due = ~refused & ~reach.any(axis=1)
        else:
            unsure = command_uncertainty_from_unknown_history(of, T, route, values) ** 2 / 3 > sure
            due = (unsure & (side != 0) & (reach == 0)).any(axis=1) & ~refused
            due &= np.arange(n) == (np.argmax(due) if due.any() else -1)  # what one forgets, those after it need not
        if not due.any():
            break
        approach = np.where(due[:, None], side if sure is None else np.where(unsure, side, 0.0), reach)
        try:
            route, reach = timed_route(pace, values, route.start, approach), approach
        except Unreachable as error:
            refused[np.intersect1d(error.index, np.flatnonzero(due))] = True
    return route


def _exists(of: Machine, T: RigidTransform, values: Floats) -> Booleans:
    """(n,) bool, whether the machine has a pose near T (n,) at these values (n, axes)."""
    exists = np.ones(len(values), bool)
    try:
        of.correction.predict(values, T)
    except NotConverged as error:
        exists[error.index] = False
    return exists


def _axes(covariance: Floats, A: Floats) -> Floats:
    """(n, axes) variances of the axes that poses' covariance (n, 6, 6) amounts to. A : (n, axes, 6) of the axes with
    the pose
    """
    return np.einsum("nij,njk,nik->ni", A, covariance, A)


def _covariance(
    calibration: Calibration, physics: Physics, of: Machine, T: RigidTransform, at: tuple[Route, Floats]
) -> _Spread:
    """_Spread: of the calibration without its physics, of the physics and of both together, of channels that nobody
    logged, and of what comes again at no moment that anybody knows. docs/mathematics.md (21)

    at : (Route, values (n, axes) at its poses)
    """
    (route, values), parts, missing, uncovered = at, [], [], []
    commands, t = route.commands(values), route.times
    lengths = of.effective(commands, t, T)
    responses = calibration.correction.responses(T, lengths)

    def stands(at: Floats, effects: tuple[Effect, ...] = of.effects, sensors: Sensors | None = None) -> Floats:
        """(n, 6) m and rad, of which differences tell how the machine moves between effects, or sensors, at times `at`
        (n,) s.
        """
        lengths, sway = of.reached(commands, at, T, effects, sensors)
        return (responses.axes @ lengths[..., None])[..., 0] + sway

    middle, J = stands(t), _columns(physics, of, partial(stands, t))
    both = responses.parameters @ physics.cross @ np.swapaxes(J, 1, 2)
    for name in of.missing:
        moved = stands(t, sensors=physics.displaced(of.sensors, name)) - middle
        if moved.any():
            parts.append(moved[..., None])
            missing.append(name)
    any_time = t + ANY_TIME * (
        np.arange(len(t)) * GOLDEN % 1
    )  # not the poses' own times, which may all meet a sinusoid alike
    design = physics.machine(with_follower_struts_of(calibration.correction.fitted, None))
    motion = motion_of_commands(design, commands, t, of.effects, of.sensors, T)
    for effect in of.effects:
        far = effect.uncovered(motion)
        if far.any():
            parts.append(responses.axes * far[:, None, :])
            uncovered.append((f"{effect.label()} at {effect.place}", int(far.any(axis=1).sum())))
    for effect in physics.scattering():
        moved = (stands(any_time, (*of.effects, effect)) - stands(any_time))[..., None]
        parts.append(np.sqrt(np.mean(moved**2, axis=0, keepdims=True)) * np.eye(6))
    covariance = (
        corrected_pose_covariance(calibration, T, lengths)
        + J @ physics.own @ np.swapaxes(J, 1, 2)
        + both
        + np.swapaxes(both, 1, 2)
    )
    whole = sum((part @ np.swapaxes(part, 1, 2) for part in parts), covariance)
    return _Spread(whole, responses, tuple(missing), tuple(uncovered))


def _columns(physics: Physics, of: Machine, stands: Callable[[tuple[Effect, ...]], Floats]) -> Floats:
    """(n, 6, c) m and rad by which poses move with each coordinate of the physics; nothing for what commands do not
    undo.

    stands : effects -> (n, 6), of which differences tell how the machine moves between them
    """
    out = np.zeros((*stands(()).shape, len(physics.coordinates)))
    acting = (*of.effects, *physics.sizeless_effects())  # a size of 0 is uncertain as well
    for i, c in enumerate(physics.coordinates):
        effect = physics.effects[c.effect]
        if effect in acting:
            ends, between = c.ends_of(physics.effects, of.effects)
            out[..., i] = (stands(ends[0]) - stands(ends[1])) / between
    return out


AGREED = 1e-9  # m, of the lengths that a commanded pose gives


def pose_commands_for_controller_with_own_kinematics(
    nominal: Mechanism, lengths: Floats, wanted: RigidTransform, frames: PoseFrames
) -> RigidTransform:
    """Poses (n,) to command a controller with own kinematics.

    Its nominal kinematics then gives strut lengths (n, 6) m.
    wanted : T_base_platform (n,) near which they are looked for
    Raises RigError for what is no hexapod, NotConverged for lengths that no pose near the wanted one gives, and for a
    pose whose lengths are not these
    """
    hexapod = require_hexapod(
        nominal, "a controller that takes poses drives a hexapod, not a mechanism of kind {kind!r}"
    )
    found = mechanisms.hexapod.forward(lengths, hexapod, wanted)
    command = frames.command_of_pose(found)
    off = np.abs(mechanisms.hexapod.inverse(frames.pose_of_command(command), hexapod) - lengths).max(axis=-1)
    wrong = np.flatnonzero(~(off <= AGREED))
    if len(wrong):
        raise NotConverged(
            f"{len(wrong)} of {len(off)} commanded poses do not give their lengths back; the worst is off by "
            f"{off.max():.3g} m",
            wrong,
            lengths[wrong],
            off[wrong],
        )
    return command
