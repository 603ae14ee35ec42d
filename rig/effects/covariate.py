"""What gives an effect away: the quantity against which its residuals show, ready to be drawn."""

from dataclasses import dataclass

import numpy as np

from rig.effects.motion import Motion

DRAWN = {"m": (1e3, "mm"), "rad": (180 / np.pi, "degrees")}  # of an axis' travel


@dataclass(frozen=True, slots=True, eq=False)
class Covariate:
    """values : (n,) or (n, axes) in the unit in which they are drawn; label : in words, with that unit."""

    values: np.ndarray
    label: str


def travel(values: np.ndarray, motion: Motion, what: str, per: str = "") -> Covariate:
    """Covariate of values (n, axes) in the unit of the axes' travel (m or rad), times what `per` says."""
    scale, unit = DRAWN[motion.kind.UNIT]
    return Covariate(values * scale, f"{what}, {unit}{per}")


def in_time(motion: Motion) -> Covariate:
    """Time from the first exposure on."""
    return Covariate((motion.t - motion.t[0]) / 60, "time, min")


def temperature(values: np.ndarray, of: str) -> Covariate:
    """Temperatures (n,) or (n, axes) in degrees Celsius."""
    return Covariate(values, f"temperature of {of}, °C")
