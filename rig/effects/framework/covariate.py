"""What gives an effect away: the quantity against which its residuals show, ready to be drawn."""

from dataclasses import dataclass

import numpy as np

from rig.effects.framework.machine_motion import Motion

DRAWN = {"m": (1e3, "mm"), "rad": (180 / np.pi, "degrees")}  # of an axis' travel


@dataclass(frozen=True, slots=True, eq=False)
class Covariate:
    """values : (n,) or (n, axes) in the unit in which they are drawn; label : in words, with that unit."""

    values: np.ndarray
    label: str


def travel_covariate(values: np.ndarray, motion: Motion, what: str, per: str = "") -> Covariate:
    """Covariate of values (n, axes) in the unit of the axes' travel (m or rad), times what `per` says."""
    scale = np.array([DRAWN[unit][0] for unit in motion.units])
    words = " or ".join(dict.fromkeys(DRAWN[unit][1] for unit in motion.units))
    return Covariate(values * scale, f"{what}, {words}{per}")


def load_covariate(values: np.ndarray, motion: Motion, what: str) -> Covariate:
    """Covariate of what the axes bear, values (n, axes) N or N m. what : whose load it is, in words"""
    kind = motion.kind
    per = {"m": ("force", "N"), "rad": ("torque", "N m")}
    names, units = (dict.fromkeys(per[unit][k] for unit in motion.units) for k in (0, 1))
    return Covariate(values, f"{' or '.join(names)}, {what.format(unit=' or '.join(units), axis=kind.AXIS)}")


def time_covariate(motion: Motion) -> Covariate:
    """Time from the first exposure on."""
    return Covariate((motion.t - motion.t[0]) / 60, "time, min")


def temperature_covariate(values: np.ndarray, of: str) -> Covariate:
    """Temperatures (n,) or (n, axes) in degrees Celsius."""
    return Covariate(values, f"temperature of {of}, °C")
