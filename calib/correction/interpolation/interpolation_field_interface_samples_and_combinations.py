"""Field interface of interpolations, samples of fields, and combinations of fields.

A field has value, gradient and error; combinations are sums and restricted maps.

Source: configuration-space patent, [0035] (corrections in some regions of the configuration space or the workspace)

Source: configuration-space patent, [0035]
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Integers


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
class FieldSamples:
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

    def take(self, index: Booleans) -> "FieldSamples":
        """The samples of an index or mask (n,)."""
        return FieldSamples(self.configurations[index], self.values[index], self.variances[index], self.strokes)


def merge_repeated_samples(samples: FieldSamples, tolerance: float = 1e-5) -> FieldSamples:
    """Samples with repeats of one configuration merged into their weighted mean."""
    scaled = np.round(
        (samples.configurations - samples.strokes[:, 0]) / (tolerance * np.ptp(samples.strokes, axis=1)) / 2
    ).astype(np.int64)
    _, first, at = np.unique(scaled, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(scaled):
        return samples
    at, where = at.ravel(), np.zeros((len(first), scaled.shape[1]))
    np.add.at(where, at, samples.configurations)
    return FieldSamples(
        where / np.bincount(at)[:, None], *group_means_and_variances_of_samples(samples, at), samples.strokes
    )


def group_means_and_variances_of_samples(samples: FieldSamples, group_indices: Integers) -> tuple[Floats, Floats]:
    """Averages (values, variances) of samples grouped by index.

    Each is (count, outputs), weighted by variance.
    """
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


FADES, HALF = (
    0.1,
    1e-3,
)  # of a part's extent, over which a map fades beyond it; m or rad where it is bounded on one side alone


@dataclass(frozen=True, slots=True, eq=False)
class SpacePart:
    """low, high : (axes,) m or rad, infinite where a coordinate is free. Raises ValueError where they bound nothing or
    are the wrong way round.
    """

    low: Floats
    high: Floats

    def __post_init__(self) -> None:
        if np.shape(self.low) != np.shape(self.high) or not (np.asarray(self.low) < np.asarray(self.high)).all():
            raise ValueError(
                f"a part reaches from low to high, not from {np.ravel(self.low).tolist()} to "
                f"{np.ravel(self.high).tolist()}"
            )
        if not np.isfinite(np.concatenate([self.low, self.high])).any():
            raise ValueError("a part must be bounded on at least one side")

    @property
    def fade(self) -> Floats:
        """(axes,) m or rad over which a map fades."""
        extent = self.high - self.low
        return np.where(np.isfinite(extent), FADES * extent, HALF)

    def holds(self, x: Floats) -> Booleans:
        """(...) bool, whether places x (..., axes) lie within."""
        return np.asarray(((x >= self.low) & (x <= self.high)).all(axis=-1))

    def weight(self, x: Floats) -> tuple[Floats, Floats]:
        """(weight (...), 1 within and 0 far from it, its slope (..., axes)) at places x (..., axes), continuous
        both.
        """
        below, above = self.low - x, x - self.high
        far = np.clip(np.maximum(np.maximum(below, above), 0) / self.fade, 0, 1)
        each = (1 - far) ** 2 * (1 + 2 * far)
        slope = -6 * far * (1 - far) / self.fade * np.where(above > 0, 1.0, np.where(below > 0, -1.0, 0.0))
        rest = np.stack([np.delete(each, i, axis=-1).prod(axis=-1) for i in range(x.shape[-1])], axis=-1)
        return each.prod(axis=-1), slope * rest


@dataclass(frozen=True, slots=True, eq=False)
class RestrictedMap:
    """field : Field of a part's own samples; part : Part of its space."""

    field: Field
    part: SpacePart
    kind: ClassVar[str] = "within"
    exact: ClassVar[bool] = False

    def value(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        return np.asarray(self.part.weight(x)[0][..., None] * self.field.value(x))

    def gradient(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        weight, slope = self.part.weight(x)
        return np.asarray(
            weight[..., None, None] * self.field.gradient(x) + self.field.value(x)[..., None] * slope[..., None, :]
        )

    def error(self, x: Floats) -> Floats:
        x = np.asarray(x, float)
        return np.asarray(self.part.weight(x)[0][..., None] * self.field.error(x))

    def inside(self, x: Floats) -> Booleans:
        x = np.asarray(x, float)
        return np.asarray(self.part.holds(x) & self.field.inside(x))


@dataclass(frozen=True, slots=True, eq=False)
class SummedPasses:
    """fields : Field of each pass, the first first, all over the same space."""

    fields: tuple[Field, ...]
    kind: ClassVar[str] = "passes"
    exact: ClassVar[bool] = False

    def value(self, x: Floats) -> Floats:
        return np.asarray(sum(field.value(x) for field in self.fields))

    def gradient(self, x: Floats) -> Floats:
        return np.asarray(sum(field.gradient(x) for field in self.fields))

    def error(self, x: Floats) -> Floats:
        """Of the last pass that holds at x: it was measured on what the others left, whose errors are in its
        samples.
        """
        square = self.fields[0].error(x) ** 2
        for field in self.fields[1:]:
            weight = field.part.weight(np.asarray(x, float))[0][..., None] if isinstance(field, RestrictedMap) else 1.0
            own = (field.field if isinstance(field, RestrictedMap) else field).error(x) ** 2
            square = weight * own + (1 - weight) * square
        return np.asarray(np.sqrt(square))

    def inside(self, x: Floats) -> Booleans:
        inside = self.fields[0].inside(x)
        for field in self.fields[1:]:
            inside = (
                np.where(field.part.holds(x), field.inside(x), inside)
                if isinstance(field, RestrictedMap)
                else field.inside(x)
            )
        return np.asarray(inside)
