"""Wanted poses -> commands through a calibration, with an approach where it makes a pose surer, and how sure each pose then is."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify.calibration import Calibration
from calib.correct.physics import Physics
from calib.correct.driven import Machine, held, memory, unremembered
from calib.correct.route import Pace, Route, timed, untimed
from calib.identify.geometry import pose_jacobian, strut_jacobian, to_pose
from rig import mechanisms
from rig.errors import NotConverged, Unreachable
from rig.plan import SPEED, UNSTATED_SPEED
from rig.recording import Sensors

BEYOND = 1.2  # times what an axis remembers that an approach goes
ANY_TIME, GOLDEN = 60.0, 0.5 * (np.sqrt(5) - 1)  # s over which moments are spread, evenly and without a period


@dataclass(frozen=True, slots=True, eq=False)
class Commanded:
    """values : (n, axes) m or rad to command at the wanted poses; route : Route; covariance : (n, 6, 6) of the poses that come of them (m, rad,
    on the right), None for an arm; missing : sensor channels that nobody logged, whose spread is in it."""

    values: np.ndarray
    route: Route
    covariance: np.ndarray | None
    missing: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Spread:
    """covariance : (n, 6, 6) of poses; missing : channels that nobody logged and that change something."""

    covariance: np.ndarray
    missing: tuple[str, ...]


def pace_of(calibration: Calibration, t: np.ndarray, sensors: Sensors | None) -> Pace:
    """Pace of poses held at times t (n,) s: half the axes' top speed, where that is known, as plans go; the axes stand at the start from where
    the sensors' log begins, so that a warm-up counts from there."""
    top = calibration.physics.actuator.max_speed if calibration.physics is not None else None
    unstated = min(UNSTATED_SPEED[unit] for unit in mechanisms.units(calibration.correction.nominal))
    begin = float(sensors.t[0]) if sensors is not None and len(sensors.t) > 1 else None
    return Pace(t, begin, SPEED * top if top else unstated, top)


def command(calibration: Calibration, T: RigidTransform, start: np.ndarray, pace: Pace | None = None, sensors: Sensors | None = None,
            approach: str = "auto", given: np.ndarray | None = None) -> Commanded:
    """Commanded for wanted poses T (n,), in their order.

    start : (axes,) m or rad, where the axes stand; pace : Pace, when the poses are held, or None: each until all has come to rest
    sensors : Sensors over that time, or None; approach : "auto" where it makes a pose surer, "always" or "never"; without a pace there is none
    given : (n, axes) m or rad to command at the poses as they are, for comparison, or None
    Raises Unreachable for poses that come too soon, NotConverged where no commands are found; limits are for `reachable` to check
    """
    of = Machine(calibration.correction, calibration.physics, sensors)
    plain = calibration.correction.inverse(T) if given is None else given
    route = untimed(plain, start) if pace is None else timed(pace, plain, start)
    if given is not None:
        return Commanded(given, route, None, ())
    values = held(of, T, route, plain) if of.effects else plain
    if calibration.correction.fitted.kind in ("arm", "chain"):
        return Commanded(values, route, None, ())
    back = to_pose(T, calibration.correction.fitted)
    base = _covariance(calibration, of, T, route, values)
    if pace is not None and approach != "never" and memory(of).any():
        sure = _struts(base.covariance, strut_jacobian(T, calibration.correction.fitted)) if approach == "auto" else None
        found = _approached(of, T, route, values, pace, sure)
        if found is not route:
            route, values = found, held(of, T, found, values)
            base = _covariance(calibration, of, T, route, values)
    doubt = unremembered(of, T, route, values) ** 2 / 3  # anywhere between the two, as likely here as there
    return Commanded(values, route, base.covariance + np.einsum("nij,nj,nkj->nik", back, doubt, back), base.missing)


def _approached(of: Machine, T: RigidTransform, route: Route, values: np.ndarray, pace: Pace, sure: np.ndarray | None) -> Route:
    """The Route with approaches. sure : (n, axes) m^2, variances that forgotten ways must exceed to be worth one; None: to every pose"""
    n, (low, high) = len(values), mechanisms.of(of.correction.nominal).travel(of.correction.nominal).T
    wanted, room = BEYOND * memory(of), values - BEYOND * memory(of) >= low
    side = np.where(room, -wanted, np.where(values + wanted <= high, wanted, 0.0))
    possible = _exists(of, T, values + side)
    reach, refused = np.zeros_like(values), ~possible
    for _ in range(2 * n):
        if sure is None:
            due = ~refused & ~reach.any(axis=1)
        else:
            unsure = unremembered(of, T, route, values) ** 2 / 3 > sure
            due = (unsure & (side != 0) & (reach == 0)).any(axis=1) & ~refused
            due &= np.arange(n) == (np.argmax(due) if due.any() else -1)  # what one forgets, those after it need not
        if not due.any():
            break
        asked = np.where(due[:, None], side if sure is None else np.where(unsure, side, 0.0), reach)
        try:
            route, reach = timed(pace, values, route.start, asked), asked
        except Unreachable as error:
            refused[np.intersect1d(error.index, np.flatnonzero(due))] = True
    return route


def _exists(of: Machine, T: RigidTransform, values: np.ndarray) -> np.ndarray:
    """(n,) bool, whether the machine has a pose near T (n,) at these values (n, axes)."""
    there = np.ones(len(values), bool)
    try:
        of.correction.predict(values, T)
    except NotConverged as error:
        there[error.index] = False
    return there


def _struts(covariance: np.ndarray, A: np.ndarray) -> np.ndarray:
    """(n, axes) variances of the axes that poses' covariance (n, 6, 6) amounts to. A : (n, axes, 6) of the axes with the pose"""
    return np.einsum("nij,njk,nik->ni", A, covariance, A)


def _covariance(calibration: Calibration, of: Machine, T: RigidTransform, route: Route, values: np.ndarray) -> _Spread:
    """_Spread: parameters of geometry and physics together, the struts' own scatter, channels that nobody logged, and what comes again at no
    moment that anybody knows. docs/mathematics.md (21)"""
    fitted, physics = calibration.correction.fitted, calibration.physics
    back, J = to_pose(T, fitted), pose_jacobian(T, fitted)
    known = calibration.covariance
    parts, missing = [back * calibration.scatter], []
    if physics is not None:
        commands, t = route.commands(values), route.times
        middle = of.effective(commands, t, T)
        J = np.concatenate([J, back @ _columns(physics, of, route, values, T)], axis=2)
        known = np.block([[known, physics.cross], [physics.cross.T, physics.own]])
        for name in of.missing:
            course = {**of.sensors.channels, name: of.sensors.channels[name] + physics.spread(name)}
            moved = of.effective(commands, t, T, sensors=Sensors(of.sensors.t, course)) - middle
            if moved.any():
                parts.append(back @ moved[..., None])
                missing.append(name)
        any_time = t + ANY_TIME * (np.arange(len(t)) * GOLDEN % 1)  # not the poses' own times, which may all meet a sinusoid alike
        for effect in physics.scattering():
            ends = [of.effective(commands, any_time, T, effects) for effects in (of.effects, (*of.effects, effect))]
            moved = back @ (ends[1] - ends[0])[..., None]
            parts.append(np.sqrt(np.mean(moved**2, axis=0, keepdims=True)) * np.eye(6))
    return _Spread(J @ known @ np.swapaxes(J, 1, 2) + sum(part @ np.swapaxes(part, 1, 2) for part in parts), tuple(missing))


def _columns(physics: Physics, of: Machine, route: Route, values: np.ndarray, T: RigidTransform) -> np.ndarray:
    """(n, axes, c) m by which the struts lengthen with each coordinate of the physics; nothing for what commands do not undo."""
    out = np.zeros((*values.shape, len(physics.coordinates)))
    for i, c in enumerate(physics.coordinates):
        effect = physics.effects[c.effect]
        if effect not in of.effects:
            continue
        others, (high, low) = tuple(e for e in of.effects if e is not effect), c.around(effect)
        ends = [of.effective(route.commands(values), route.times, T, (*others, c.written(effect, end))) for end in (high, low)]
        out[..., i] = (ends[0] - ends[1]) / (high - low)
    return out
