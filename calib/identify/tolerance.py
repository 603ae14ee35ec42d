"""How good the owner's figures are, as the poses themselves have it: joints and zeros are drawn about where they are stated.

The widths of these draws, one for the joints' coordinates and one for the zeros, are found by the evidence, so that what the poses
do not tell rests on a tolerance that they bear out, and what is promised of it too. Source: MacKay, Bayesian interpolation,
Neural Computation 1992.
"""

from dataclasses import dataclass

import numpy as np

from calib.identify.geometry import PRIOR, Identified, parameters
from rig.design import Hexapod

LEAST = 1e-5  # m; no owner knows his joints better
STEPS = 25  # of the grid of either width, in equal ratios


@dataclass(frozen=True, slots=True, eq=False)
class Tolerance:
    """widths : (k, 2) m, of joints and of zeros; weight : (k,) probability of each pair
    information : (42, 42) 1/m^2 of the poses alone; right : (42,) 1/m, information times what the poses alone move the parameters by
    """

    widths: np.ndarray
    weight: np.ndarray
    information: np.ndarray
    right: np.ndarray

    @property
    def prior(self) -> np.ndarray:
        """(42,) m, the likeliest standard deviation of each parameter (the mean of its logarithm)."""
        return spread(np.exp(self.weight @ np.log(self.widths)))


def spread(widths: np.ndarray) -> np.ndarray:
    """(..., 42) of widths (..., 2) of joints and zeros."""
    return np.repeat(widths, (36, 6), axis=-1)


def tolerance(found: Identified, nominal: Hexapod) -> Tolerance:
    """Tolerance of an Identified: widths from 10 um to 5 mm, each order of magnitude as likely as another before the poses."""
    information = found.root.T @ found.root
    right = information @ (parameters(found.hexapod) - parameters(nominal)) + (parameters(found.hexapod) - parameters(nominal)) / found.prior**2
    grid = np.geomspace(LEAST, PRIOR, STEPS)
    widths = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    sigma = spread(widths)
    # with p = sigma x, x ~ N(0, I): log evidence = -1/2 log |I + sigma Lambda sigma| + 1/2 |L^-1 sigma right|^2
    L = np.linalg.cholesky(np.eye(42) + sigma[:, :, None] * information * sigma[:, None, :])
    half = np.linalg.solve(L, (sigma * right)[..., None])[..., 0]
    evidence = 0.5 * (half**2).sum(axis=1) - np.log(np.einsum("kii->ki", L)).sum(axis=1)
    weight = np.exp(evidence - evidence.max())
    return Tolerance(widths, weight / weight.sum(), information, right)
