"""Profile of a move over time, fitted to the positions that the controller reported during it.

A report is read at some moment between its request and its answer. At 20 mm/s a millisecond of that is 20 um, so
positions between reports are taken from the profile that all of them together determine.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from rig.array_and_json_types import Floats
from rig.driving.controller_status_and_limits import PositionReport
from rig.driving.trapezoidal_move_profile_and_path_check import Way, trapezoidal_profile

FEWEST = 8  # reports in motion from which a profile is fitted
RESOLUTION = 2e-6  # m by which a controller's counts and its own profile may be off
BEYOND = 3.0  # times what the moments of reports explain, from which the controller does not follow a trapezoid
INCLUDED = 0.5  # s before and after the motion of which reports count
UNIFORM = np.sqrt(12.0)  # width of an even spread over its standard deviation


@dataclass(frozen=True, slots=True)
class FittedProfile:
    """way : as of an Arrival, () where reports are too few or follow no trapezoid; rms : m, of the busiest axis at the
    reports about it, or None where none was fitted
    """

    way: Way
    rms: float | None


def profile_of_reports(start: Floats, goal: Floats, reports: Sequence[PositionReport], speed: float) -> FittedProfile:
    """FittedProfile of a straight move: when it began, its ramps and its speed, by its reports.

    start, goal : (n,) m; speed : m/s of the axis that moves most, from which the fit starts
    """
    way = goal - start
    busiest = float(np.abs(way).max())
    if busiest == 0 or len(reports) < FEWEST:
        return FittedProfile((), None)
    t, width = np.array([r.t for r in reports]), np.array([r.answered - r.requested for r in reports])
    share = np.array([r.lengths - start for r in reports]) @ way / float(way @ way)
    passing = (share > 1e-3) & (share < 1 - 1e-3)
    if passing.sum() < FEWEST:
        return FittedProfile((), None)
    used = (t > t[passing][0] - INCLUDED) & (t < t[passing][-1] + INCLUDED)
    t, width, share, origin = t[used], width[used], share[used], float(t[passing][0])
    cruise_time = busiest / speed
    sigma = np.sqrt((width / UNIFORM * speed) ** 2 + RESOLUTION**2) / busiest
    begun = origin - share[t >= origin][0] * cruise_time

    def off(p: Floats) -> Floats:
        return (trapezoid_share(t - origin - p[0], p[1], p[2]) - share) / sigma

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


def trapezoid_share(t: Floats, cruise_time: float, ramp_time: float) -> Floats:
    """(k,) share of the way passed at times t (k,) s from its beginning; cruise_time, ramp_time : s, as of
    `trapezoidal_profile`.
    """
    if ramp_time >= cruise_time:  # full speed is never reached
        half = float(np.sqrt(ramp_time * cruise_time))
        whole, ramp, top = 2 * half, half, 1 / half
    else:
        whole, ramp, top = cruise_time + ramp_time, ramp_time, 1 / cruise_time
    t = np.clip(t, 0, whole)
    up, down = top * t**2 / (2 * ramp), 1 - top * (whole - t) ** 2 / (2 * ramp)
    return np.where(t < ramp, up, np.where(t > whole - ramp, down, top * (t - ramp / 2)))
