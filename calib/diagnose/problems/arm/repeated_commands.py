"""Commands that were given twice: how well poses repeat, and whether what a model leaves is noise or comes again."""

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.spatial import cKDTree

from calib.diagnose.problems.arm.pose_fit import Fit

SAME = {"rad": 1e-3, "m": 1e-5}  # commands nearer than this in every axis are one command
FEWEST = 12  # pairs


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """pairs : how many; mean, rms : m, of one position's length about what it repeats; mean_rad : of a rotation, None
    where not measured
    recurring_share : share of what is left that comes again under the same command, 0..1; p_value : of that share by
        chance"""

    pairs: int
    mean: float
    rms: float
    mean_rad: float | None
    recurring_share: float
    p_value: float


def pose_repeatability(fit: Fit) -> Repeats | None:
    """Repeats, the repeatability of poses commanded twice, or None where too few were.

    The difference of two residuals under one command holds no model error, so its scatter is pure error; of a
    residual's square, the part that both share is repeatable and not explained.
    """
    used = np.flatnonzero(fit.used & ~fit.aside)
    apart_by = np.array([SAME[unit] for unit in fit.arms.context.moved().units])
    pairs = np.array(sorted(cKDTree(fit.arms.q[used] / apart_by).query_pairs(1.0, p=np.inf)), int).reshape(-1, 2)
    if len(pairs) < FEWEST:
        return None
    one, two = fit.left[used[pairs[:, 0]]], fit.left[used[pairs[:, 1]]]
    apart = np.linalg.norm(one[:, :3] - two[:, :3], axis=1) / np.sqrt(2)
    turned = float((np.linalg.norm(one[:, 3:] - two[:, 3:], axis=1) / np.sqrt(2)).mean()) if one.shape[1] == 6 else None
    product = (one[:, :3] * two[:, :3]).sum(axis=1)
    again = float(product.sum() / max(((one[:, :3] ** 2).sum() + (two[:, :3] ** 2).sum()) / 2, 1e-300))
    z = float(product.sum() / max(np.sqrt((product**2).sum()), 1e-300))
    return Repeats(
        len(pairs),
        float(apart.mean()),
        float(np.sqrt((apart**2).mean())),
        turned,
        max(again, 0.0),
        float(scipy.special.ndtr(-z)),
    )
