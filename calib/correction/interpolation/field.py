"""Field interface of all interpolations (value, gradient, error), and fields as weighted sums of samples."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from rig.arrays import Booleans, Floats, Integers


class Field(Protocol):
    """KSF_KR, the summand function all over a space of `axes` numbers, each of `outputs` values. Beyond its samples it
    goes on continuously.

    kind : its name in files and on the command line; exact : whether it passes through its samples, and then has their
        values (n, outputs)
    Source: configuration-space patent, [0027], [0028], [0136], [0137]
    """

    kind: ClassVar[str]
    exact: ClassVar[bool]

    def value(self, x: Floats) -> Floats:
        """(..., outputs) m or rad at x (..., axes)."""
        ...

    def gradient(self, x: Floats) -> Floats:
        """(..., outputs, axes) change of the values with x (..., axes); at a kink that of one side."""
        ...

    def error(self, x: Floats) -> Floats:
        """(..., outputs) m or rad, standard error of the values at x (..., axes): the samples' noise, and what lies
        between them or beyond.
        """
        ...

    def inside(self, x: Floats) -> Booleans:
        """(...) bool, whether x (..., axes) lies among the samples; elsewhere the values are extrapolated."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """KSF_PM, the summand function on its samples: configurations (n, axes), values (n, outputs), variances (n,
    outputs), each sample once;
    strokes : (axes, 2) of the space. Raises ValueError for shapes that do not fit each other.

    Source: configuration-space patent, [0128] to [0130]
    """

    configurations: Floats
    values: Floats
    variances: Floats
    strokes: Floats

    def __post_init__(self) -> None:
        n, axes = np.shape(self.configurations)
        if (
            np.shape(self.values)[:1] != (n,)
            or np.shape(self.values) != np.shape(self.variances)
            or np.shape(self.strokes) != (axes, 2)
        ):
            raise ValueError(
                f"expected configurations (n, axes), values and variances (n, outputs) and strokes (axes, 2), got "
                f"{np.shape(self.configurations)}, {np.shape(self.values)}, {np.shape(self.variances)} and "
                f"{np.shape(self.strokes)}"
            )

    def take(self, index: Booleans) -> "Known":
        """The samples of an index or mask (n,)."""
        return Known(self.configurations[index], self.values[index], self.variances[index], self.strokes)


def merge_repeats(samples: Known, tolerance: float = 1e-5) -> Known:
    """Samples with repeats of one configuration merged to their weighted mean."""
    scaled = np.round(
        (samples.configurations - samples.strokes[:, 0]) / (tolerance * np.ptp(samples.strokes, axis=1)) / 2
    ).astype(np.int64)
    _, first, at = np.unique(scaled, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(scaled):
        return samples
    at, where = at.ravel(), np.zeros((len(first), scaled.shape[1]))
    np.add.at(where, at, samples.configurations)
    return Known(where / np.bincount(at)[:, None], *average_samples(samples, at), samples.strokes)


def average_samples(samples: Known, group_indices: Integers) -> tuple[Floats, Floats]:
    """Averages (values, variances), each (count, outputs), of samples grouped by index, weighted by variance."""
    weight = 1 / np.maximum(samples.variances, 1e-300)
    shape = int(group_indices.max()) + 1, weight.shape[1]
    total, mean = np.zeros(shape), np.zeros(shape)
    np.add.at(total, group_indices, weight)
    np.add.at(mean, group_indices, weight * samples.values)
    return mean / total, 1 / total


ON = 1e-4  # of half the samples' extent, beyond which a place is no more among them: commands are written rounded


class Weights(NamedTuple):
    """Of n places: samples (n, k), their indices; weight (n, k), which add up to 1; slope (n, k, axes) of the weights
    with the place.
    """

    samples: Floats
    weight: Floats
    slope: Floats


class WeightedField:
    """A field by weights of samples. Who inherits it has values, variances (samples, outputs) and misfit (outputs,):
    the standard deviation of what it leaves midway between samples, 0 at a sample."""

    __slots__ = ()
    values: Floats
    variances: Floats
    misfit: Floats

    def weights(self, x: Floats) -> Weights:
        """Weights at places x (n, axes)."""
        raise NotImplementedError

    def outside(self, x: Floats) -> Floats:
        """(n,) how far places x (n, axes) lie beyond the samples, as a share of half their extent; 0 among them."""
        raise NotImplementedError

    def value(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        found = self.weights(x.reshape(-1, x.shape[-1]))
        return np.einsum("nk,nkm->nm", found.weight, self.values[found.samples]).reshape(*x.shape[:-1], -1)

    def gradient(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        found = self.weights(x.reshape(-1, x.shape[-1]))
        return np.einsum("nkd,nkm->nmd", found.slope, self.values[found.samples]).reshape(
            *x.shape[:-1], -1, x.shape[-1]
        )

    def error(self, x: Floats) -> Floats:
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

    def inside(self, x: Floats) -> Booleans:
        x = np.asarray(x, float)
        return (self.outside(x.reshape(-1, x.shape[-1])) <= ON).reshape(x.shape[:-1])
