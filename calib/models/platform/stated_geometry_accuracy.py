"""How good the owner's figures are, as the poses themselves have it: joints and zeros are drawn about where they are
stated.

The widths of these draws, one for the joints' coordinates and one for the zeros, are found by the evidence, so that
what the poses do not tell rests on a tolerance that they bear out, and what is promised of it too. Source: MacKay,
Bayesian interpolation, Neural Computation 1992.
"""

from dataclasses import dataclass

import numpy as np

from calib.models.platform.identification import PRIOR, Identified, parameters
from rig.model.mechanism_kinds import Struts

LEAST = 1e-5  # m; no owner knows his joints better
STEPS = 25  # of the grid of either width, in equal ratios


@dataclass(frozen=True, slots=True, eq=False)
class Tolerance:
    """widths : (k, 2) m, of joints and of zeros; weight : (k,) probability of each pair
    information : (p, p) 1/m^2 of the poses alone; right : (p,) 1/m, information times what the poses alone move the
        parameters by
    counts : how many of the parameters are joints' coordinates and how many are zeros
    """

    widths: np.ndarray
    weight: np.ndarray
    information: np.ndarray
    right: np.ndarray
    counts: tuple[int, int]

    @property
    def prior(self) -> np.ndarray:
        """(p,) m, the likeliest standard deviation of each parameter (the mean of its logarithm)."""
        return parameter_widths(np.exp(self.weight @ np.log(self.widths)), self.counts)


def parameter_widths(widths: np.ndarray, counts: tuple[int, int]) -> np.ndarray:
    """(..., p) of widths (..., 2) of joints and zeros, of which there are so many."""
    return np.repeat(widths, counts, axis=-1)


def stated_geometry_accuracy(found: Identified, nominal: Struts) -> Tolerance:
    """Tolerance of an Identified: widths from 10 um to 5 mm, each order of magnitude as likely as another before the
    poses.
    """
    information = found.root.T @ found.root
    counts = (len(found.prior) - len(nominal.axes), len(nominal.axes))
    right = (
        information @ (parameters(found.mechanism) - parameters(nominal))
        + (parameters(found.mechanism) - parameters(nominal)) / found.prior**2
    )
    grid = np.geomspace(LEAST, PRIOR, STEPS)
    widths = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    sigma = parameter_widths(widths, counts)
    # with p = sigma x, x ~ N(0, I): log evidence = -1/2 log |I + sigma Lambda sigma| + 1/2 |L^-1 sigma right|^2
    L = np.linalg.cholesky(np.eye(len(found.prior)) + sigma[:, :, None] * information * sigma[:, None, :])
    half = np.linalg.solve(L, (sigma * right)[..., None])[..., 0]
    evidence = 0.5 * (half**2).sum(axis=1) - np.log(np.einsum("kii->ki", L)).sum(axis=1)
    weight = np.exp(evidence - evidence.max())
    return Tolerance(widths, weight / weight.sum(), information, right, counts)
