"""Move profiles, and the check of a path.

A report is read at some moment between its request and its answer. At 20 mm/s a millisecond of that is 20 um, so
positions between reports are taken from the profile that all of them together determine.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats
from rig.driving.axis_display_units_and_controller_counts import (
    SHOWN,
    axes_word,
    axis_values_text,
    greatest_distance_text,
    value_text,
)
from rig.driving.controller_status_and_limits import (
    OUT_OF_RANGE,
    PositionReport,
    hint_at_lengths_wrong_by_factor_of_thousand,
)
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.errors import NotConverged, Unreachable
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import COUPLED
from rig.model.design import Controller
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, Parallel, has_struts, is_parallel

TimedShares = tuple[tuple[float, float], ...]
PIECES = 8  # straight pieces to a ramp: they leave the curve by less than a five hundredth of what is travelled in it


def trapezoidal_profile(start_time: float, end_time: float, cruise_time: float, ramp_time: float | None) -> TimedShares:
    """Trapezoidal speed profile of a move.

    cruise_time : s that the way would take at full speed alone; ramp_time : s from standing to full speed, or None
        where the
    controller keeps its acceleration to itself: then what the move took beyond `cruise_time` is taken to be the ramp
    A move too short for full speed is a triangle. What was not needed is waiting at its end.
    Returns ((s, share of the path), ..) between start and end time
    """
    whole = end_time - start_time
    if whole <= 0 or cruise_time <= 0:
        return ()
    if ramp_time is None:
        ramp_time = max(whole - cruise_time, 0.0)
    if ramp_time >= cruise_time:  # full speed is never reached
        moving = min(2 * np.sqrt(ramp_time * cruise_time), whole)
        ramp_time = moving / 2
    else:
        moving = min(cruise_time + ramp_time, whole)
        ramp_time = min(ramp_time, moving / 2)
    up = np.linspace(0, ramp_time, PIECES + 1)[1:]
    top = 1 / (moving - ramp_time)  # share per s at full speed
    if ramp_time > 0:
        rising = top * up**2 / (2 * ramp_time)
        t = np.concatenate([up, moving - up[::-1], [moving]])
        share = np.concatenate([rising, 1 - rising[::-1], [1.0]])
    else:
        t, share = np.array([moving]), np.array([1.0])
    keep = np.r_[True, np.diff(t) > 1e-9] & (t < whole - 1e-9)
    return tuple((float(start_time + at), float(min(max(part, 0.0), 1.0))) for at, part in zip(t[keep], share[keep]))


def straight_move_segment(
    start: Floats, target: Floats, speed_fraction: float, controller: Controller, mechanism: Commanded
) -> Segment:
    """Segment of a straight move.

    All axes begin and arrive simultaneously.
    start, target : (n,) m or rad; speed_fraction : of the greatest speeds, above 0 and at most 1
    """
    travel = np.abs(target - start)
    duration = max(float((travel / (speed_fraction * controller.max_speed)).max()), 1e-6)
    acceleration = None
    if controller.max_acceleration is not None and travel.any():
        acceleration = travel * (controller.max_acceleration[travel > 0] / travel[travel > 0]).min()
    pose = mechanisms.kinematics_of(mechanism).forward(target, mechanism) if controller.kinematics == "world" else None
    return Segment(start - controller.zero, target - controller.zero, duration, travel / duration, acceleration, pose)


def speed_fraction_of_move(
    start: Floats, target: Floats, speed: float, controller: Controller, mechanism: Commanded
) -> float:
    """Fraction of the greatest speeds for a move at a speed.

    At it the axis that moves most has that speed (m/s or rad/s).
    start, target : (n,) m or rad
    Raises ValueError where an axis would exceed its greatest speed.
    """
    travel = np.abs(target - start)
    if not travel.any():
        return 1.0
    share = float((travel / controller.max_speed).max()) * speed / float(travel.max())
    if not 0 < share <= 1 + 1e-9:
        stated = value_text(speed, mechanisms.axis_units(mechanism)[int(np.argmax(travel))])
        greatest = axis_values_text(controller.max_speed, mechanism)
        raise ValueError(f"{stated} per second exceeds the axes' max_speed, {greatest} per second")
    return min(share, 1.0)


SPACING = 2e-3  # m or rad of the axis that moves most, between the places looked at
FEWEST, MOST = 3, 200  # of them, beside the start


def require_axis_values_in_range(lengths: Floats, mechanism: Commanded) -> Floats:
    """Require values (n,) m or rad within the axes' ranges, and return them.

    Raises ValueError for another number of values or for what is not finite, Unreachable naming each axis beyond
    its range, and each joint that is not where its leader has it.
    """
    lengths = np.array(lengths, float)
    if lengths.shape != (len(mechanism.axes),) or not np.isfinite(lengths).all():
        wanted = f"{len(mechanism.axes)} finite values ({mechanisms.travel_unit(mechanism)})"
        raise ValueError(f"expected {wanted}, got {lengths.tolist()}")
    module = mechanisms.kinematics_of(mechanism)
    beyond = module.signed_limit_excess(lengths, mechanism)
    if beyond.any():
        places, units = mechanisms.axis_place_texts(mechanism), mechanisms.axis_units(mechanism)
        lines = []
        for i in np.flatnonzero(beyond):
            scale, name = SHOWN[units[i]]
            low, high = module.travel_ranges(mechanism)[i] * scale
            lines.append(f"{places[i]}: {lengths[i] * scale:.3f} {name} is outside {low:.6g} .. {high:.6g} {name}")
        what = "lengths" if has_struts(mechanism) else "values"
        raise Unreachable(f"not moved: the {what} are beyond what the {axes_word(mechanism)} reach", [0], lines)
    led = mechanisms.with_followers(lengths, mechanism)
    if apart := np.flatnonzero(np.abs(led - lengths) > COUPLED).tolist():
        places, units = mechanisms.axis_place_texts(mechanism), mechanisms.axis_units(mechanism)
        raise Unreachable(
            "not moved: joints that follow others ([[mechanism.coupling]]) are not where their leaders have them",
            [0],
            [
                f"{places[i]}: {value_text(lengths[i], units[i])}, its leader has it at {value_text(led[i], units[i])}"
                for i in apart
            ],
        )
    return lengths


def jog_goal(goal: Floats, is_named: Booleans, mechanism: Commanded) -> Floats:
    """Goal (axes,) m or rad of a jog.

    Joints that follow others are as their leaders have them, except axes (axes,) named.
    """
    return np.where(is_named, goal, mechanisms.with_followers(goal, mechanism))


def require_safe_path(
    start: Floats,
    target: Floats,
    mechanism: Commanded,
    singularity_margin: float,
    max_step: float | None,
    zero: Floats | float = 0.0,
) -> None:
    """Raise Unreachable unless the straight path is safe.

    Largest step, workspace, singularities; of a chain stage by stage. In its own axes a serial machine passes
    singularities as any other place, and its workspace is the ranges.
    start, target : (n,) m or rad, start as read back, which may lie outside the range as long as the way leads inwards
    singularity_margin : least singular value of the Jacobian as a share of that at home; max_step : m or rad, or None
    zero : (n,) m, lengths where the controller counts 0, for a hint at its units
    """
    step = np.abs(target - start).max()
    if max_step is not None and step > max_step:
        raise Unreachable(
            "not moved: the step is too large",
            [0],
            [
                f"{greatest_distance_text(target - start, mechanism)}, [controller] max_step allows "
                f"{greatest_distance_text(np.full(len(start), max_step), mechanism)}"
            ],
        )
    zero, at = np.broadcast_to(zero, start.shape), 0
    for number, stage in enumerate(mechanism.stages, 1):
        own = slice(at, at + len(stage.axes))
        at = own.stop
        if is_parallel(stage):
            place = f"stage {number}, " if len(mechanism.stages) > 1 else ""
            _require_safe_platform_path(start[own], target[own], stage, singularity_margin, zero[own], place)


def _require_safe_platform_path(
    start: Floats, target: Floats, mechanism: Parallel, singularity_margin: float, zero: Floats, place: str
) -> None:
    """Raise Unreachable unless the straight path of a parallel mechanism stays in its workspace, off singularities.

    start, target, zero : (n,) m or rad; place : in a chain, for messages, or ""
    """
    count = int(np.clip(np.ceil(np.abs(target - start).max() / SPACING), FEWEST, MOST))
    share = np.linspace(0.0, 1.0, count + 1)
    path = start + share[:, None] * (target - start)
    module = mechanisms.kinematics_of(mechanism)
    home = mechanism.home_pose
    if home is None:
        home = module.forward(module.home_values(mechanism), mechanism)
    try:
        poses = module.forward(path, mechanism)
    except NotConverged as error:
        k = int(np.min(error.index))
        hint = hint_at_lengths_wrong_by_factor_of_thousand(start - zero, module.travel_ranges(mechanism).T - zero)
        where = [f"{place}{share[k]:.0%} along: {error}", *([OUT_OF_RANGE + hint] if k == 0 else [])]
        raise Unreachable("not moved: the path leaves the workspace", [k], where) from None
    least = _dexterity(poses, path, mechanism) / _dexterity(home, module.home_values(mechanism), mechanism)
    if least.min() < singularity_margin:
        k = int(np.argmin(least))
        raise Unreachable(
            "not moved: the path comes too near a singularity",
            [k],
            [
                f"{place}{share[k]:.0%} along, at {axis_values_text(path[k], mechanism)}: {least[k]:.3f} of the "
                "Jacobian's "
                f"least singular value at home is left, [controller] margin requires {singularity_margin:g}"
            ],
        )


def _dexterity(poses: RigidTransform, values: Floats, mechanism: Parallel) -> Floats:
    """(...) least singular value of the Jacobian, turns taken as lengths at the platform joints' mean radius."""
    J = mechanisms.kinematics_of(mechanism).inverse_kinematics_jacobian(poses, values, mechanism)
    if mechanism.plates is not None:
        J = J / np.r_[1, 1, 1, np.full(3, np.linalg.norm(mechanism.plates[1], axis=1).mean())]
    return np.asarray(np.linalg.svd(J, compute_uv=False)[..., -1], float)


FEWEST_REPORTS = 8  # reports in motion from which a profile is fitted
RESOLUTION = 2e-6  # m by which a controller's counts and its own profile may be off
BEYOND = 3.0  # times what the moments of reports explain, from which the controller does not follow a trapezoid
INCLUDED = 0.5  # s before and after the motion of which reports count
UNIFORM = np.sqrt(12.0)  # width of an even spread over its standard deviation


@dataclass(frozen=True, slots=True)
class FittedProfile:
    """travel : as of an Arrival, () where reports are too few or follow no trapezoid; rms : m, of the busiest axis at
    the reports about it, or None where none was fitted
    """

    travel: TimedShares
    rms: float | None


def move_profile_fitted_to_reports(
    start: Floats, goal: Floats, reports: Sequence[PositionReport], speed: float
) -> FittedProfile:
    """Profile (FittedProfile) of a straight move, fitted to position reports.

    When it began, its ramps and its speed.

    start, goal : (n,) m; speed : m/s of the axis that moves most, from which the fit starts
    """
    travel = goal - start
    busiest = float(np.abs(travel).max())
    if busiest == 0 or len(reports) < FEWEST_REPORTS:
        return FittedProfile((), None)
    t, width = np.array([r.t for r in reports]), np.array([r.answered - r.requested for r in reports])
    share = np.array([r.lengths - start for r in reports]) @ travel / float(travel @ travel)
    passing = (share > 1e-3) & (share < 1 - 1e-3)
    if passing.sum() < FEWEST_REPORTS:
        return FittedProfile((), None)
    used = (t > t[passing][0] - INCLUDED) & (t < t[passing][-1] + INCLUDED)
    t, width, share, origin = t[used], width[used], share[used], float(t[passing][0])
    cruise_time = busiest / speed
    sigma = np.sqrt((width / UNIFORM * speed) ** 2 + RESOLUTION**2) / busiest
    begun = origin - share[t >= origin][0] * cruise_time

    def off(p: Floats) -> Floats:
        return (travel_fraction_of_trapezoidal_profile(t - origin - p[0], p[1], p[2]) - share) / sigma

    ramp = 0.2 * cruise_time
    starts = [np.array([begun - origin - lead, cruise_time, ramp]) for lead in (0.0, ramp / 2)]
    fits = [
        least_squares(off, p, x_scale=[0.01, 0.01, 0.01], bounds=([-np.inf, 1e-4, 1e-4], np.inf), loss="soft_l1")
        for p in starts
    ]
    found = min(fits, key=lambda fit: float(fit.cost))
    late, cruise, ramp = found.x
    left = off(found.x)
    rms = float(np.sqrt(np.mean((left * sigma) ** 2))) * busiest
    if float(np.sqrt(np.mean(np.minimum(left**2, 2 * BEYOND**2)))) > BEYOND:
        return FittedProfile((), rms)
    moving = cruise + ramp if ramp < cruise else 2 * float(np.sqrt(ramp * cruise))
    begins = float(origin + late)
    return FittedProfile(
        ((begins, 0.0), *trapezoidal_profile(begins, begins + moving + 1e-6, cruise, ramp), (begins + moving, 1.0)), rms
    )


def travel_fraction_of_trapezoidal_profile(t: Floats, cruise_time: float, ramp_time: float) -> Floats:
    """Fraction (k,) of the travel that a trapezoidal profile has passed at times t (k,) s.

    Times are from its beginning; cruise_time, ramp_time : s, as of `trapezoidal_profile`.
    """
    if ramp_time >= cruise_time:  # full speed is never reached
        half = float(np.sqrt(ramp_time * cruise_time))
        whole, ramp, top = 2 * half, half, 1 / half
    else:
        whole, ramp, top = cruise_time + ramp_time, ramp_time, 1 / cruise_time
    t = np.clip(t, 0, whole)
    up, down = top * t**2 / (2 * ramp), 1 - top * (whole - t) ** 2 / (2 * ramp)
    return np.where(t < ramp, up, np.where(t > whole - ramp, down, top * (t - ramp / 2)))
