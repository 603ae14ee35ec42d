"""Repeated commands: how well their poses repeat, and whether a model's residuals are noise or repeat."""

from collections.abc import Sequence

import numpy as np
import scipy
from scipy.spatial import cKDTree

from calib.diagnosis.problems.evidence_interface import Repeats
from rig.array_and_json_types import Floats

SAME = {"rad": 1e-3, "m": 1e-5}  # commands nearer than this in every axis are one command
FEWEST = 12  # pairs


def repeated_pairs(commands: Floats, units: Sequence[str]) -> Floats:
    """(p, 2) rows of commands (n, axes), in units "m" or "rad", that are one command."""
    apart_by = np.array([SAME[unit] for unit in units])
    return np.array(sorted(cKDTree(commands / apart_by).query_pairs(1.0, p=np.inf)), int).reshape(-1, 2)


def repeatability_of_pairs(
    pairs: Floats, poses_of_pairs: tuple[Floats, Floats], residuals_of_pairs: tuple[Floats, Floats]
) -> Repeats | None:
    """Repeatability (Repeats) of pairs (p, 2) of poses with one command and of their residuals; None for too few.

    poses_of_pairs : two (p, 6 or 3) m and rad, measured poses of each pair, both less the same; residuals_of_pairs :
        two (p, k) what a model
    leaves of each

    The difference of two poses under one command holds no model error, so its scatter is pure error; of a residual's
    square, the part that both share is repeatable and not explained.
    """
    if len(pairs) < FEWEST:
        return None
    off = (poses_of_pairs[0] - poses_of_pairs[1]) / np.sqrt(2)
    apart = np.linalg.norm(off[:, :3], axis=1)
    turned = float(np.linalg.norm(off[:, 3:], axis=1).mean()) if off.shape[1] == 6 else None
    one, two = residuals_of_pairs
    product = (one * two).sum(axis=1)
    again = float(product.sum() / max(((one**2).sum() + (two**2).sum()) / 2, 1e-300))
    z = float(product.sum() / max(np.sqrt((product**2).sum()), 1e-300))
    return Repeats(
        len(pairs),
        float(apart.mean()),
        float(np.sqrt((apart**2).mean())),
        turned,
        max(again, 0.0),
        float(scipy.special.ndtr(-z)),
    )
