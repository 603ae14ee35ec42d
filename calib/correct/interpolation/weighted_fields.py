"""Fields that weigh the values of some samples: value, gradient and error estimate from the weights."""

from typing import NamedTuple

import numpy as np

ON = 1e-4  # of half the samples' extent, beyond which a place is no more among them: commands are written rounded


class Weights(NamedTuple):
    """Of n places: samples (n, k), their indices; weight (n, k), which add up to 1; slope (n, k, axes) of the weights
    with the place.
    """

    samples: np.ndarray
    weight: np.ndarray
    slope: np.ndarray


class Weighted:
    """A field by weights of samples. Who inherits it has values, variances (samples, outputs) and misfit (outputs,):
    the standard deviation of what it leaves midway between samples, 0 at a sample."""

    __slots__ = ()
    values: np.ndarray
    variances: np.ndarray
    misfit: np.ndarray

    def weights(self, x: np.ndarray) -> Weights:
        """Weights at places x (n, axes)."""
        raise NotImplementedError

    def outside(self, x: np.ndarray) -> np.ndarray:
        """(n,) how far places x (n, axes) lie beyond the samples, as a share of half their extent; 0 among them."""
        raise NotImplementedError

    def value(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        found = self.weights(x.reshape(-1, x.shape[-1]))
        return np.einsum("nk,nkm->nm", found.weight, self.values[found.samples]).reshape(*x.shape[:-1], -1)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        found = self.weights(x.reshape(-1, x.shape[-1]))
        return np.einsum("nkd,nkm->nmd", found.slope, self.values[found.samples]).reshape(
            *x.shape[:-1], -1, x.shape[-1]
        )

    def error(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        flat = x.reshape(-1, x.shape[-1])
        found = self.weights(flat)
        square = found.weight**2
        noise = np.einsum("nk,nkm->nm", square, self.variances[found.samples])
        k = square.shape[1]
        between = (1 - square.sum(axis=1)) * k / (k - 1)  # 0 at a sample, 1 where all weigh alike
        beyond = self.outside(flat)[:, None] * self.values.std(
            axis=0
        )  # as far as the values differ over half their extent, so far they may go on
        return np.sqrt(noise + between[:, None] * self.misfit**2 + beyond**2).reshape(*x.shape[:-1], -1)

    def inside(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        return (self.outside(x.reshape(-1, x.shape[-1])) <= ON).reshape(x.shape[:-1])
