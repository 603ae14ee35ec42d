"""Scatter beyond the noise that is stated: a chi-square of what is left, whitened by that noise alone, whatever
explains it or nothing.
"""

import numpy as np
import scipy

from calib.diagnose.engine.lack_of_fit import ALPHA, LackOfFit

MATERIAL = 1.2  # times the stated noise; a statement of noise is seldom better than that


def detect_excess_scatter(
    place: str, unit: str, noise: float, square: float, freedom: float, tests: int = 1, depends_on: tuple[str, ...] = ()
) -> LackOfFit | None:
    """LackOfFit of what scatters more than chance and a statement's own accuracy allow, None where the noise suffices.

    noise : in unit, RMS of what is stated; square : sum of squares left, whitened by it, over `freedom` degrees of
        freedom
    tests : how many such are made of one recording
    """
    ratio = square / max(freedom, 1.0)
    chance = float(scipy.special.chdtrc(max(freedom, 1.0), square))
    if ratio <= MATERIAL**2 or chance * tests >= ALPHA:
        return None
    return LackOfFit(place, float(noise * np.sqrt(ratio - 1)), unit, depends_on, chance, float(square - freedom))
