"""Which configurations to visit, in which order and how long: plans of commands and exposures through time."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from rig.recording import Commands

DWELL = 2.0  # s at a configuration before its exposure
AFTER = 1.0  # s at it after the exposure
SPEED = 0.5  # of the actuator's top speed
UNSTATED_SPEED = 0.02  # m/s where the design states none


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """commands : Commands; t : (frames,) s, the exposures."""

    commands: Commands
    t: np.ndarray


def settled(configurations, start, speed):
    """Plan that goes to each configuration (n, axes) in turn from start (axes,), dwells, and exposes once settled. speed : m/s."""
    t, values, exposures = [0.0, 1.0], [start, start], []
    for goal in configurations:
        travel = max(np.abs(goal - values[-1]).max() / speed, 1e-3)
        t += [t[-1] + travel, t[-1] + travel + DWELL + AFTER]
        values += [goal, goal]
        exposures.append(t[-1] - AFTER)
    return Plan(Commands(np.array(t), np.array(values)), np.array(exposures))


def low_discrepancy(strokes, count, fill=0.8, seed=0):
    """(count, axes) configurations that cover the middle `fill` of the strokes (axes, 2) evenly (scrambled Sobol points)."""
    points = qmc.Sobol(len(strokes), rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(max(count, 2)))))[:count]
    centre, half = strokes.mean(axis=1), np.ptp(strokes, axis=1) / 2
    return centre + fill * half * (2 * points - 1)


def speed_of(design):
    """m/s at which a plan moves the struts of a design."""
    top = design.actuator.max_speed
    return SPEED * top if top else UNSTATED_SPEED
