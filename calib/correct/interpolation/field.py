"""What every way of extending corrections answers to: a value, its gradient and an error estimate all over a
configuration space.
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np


class Field(Protocol):
    """KSF_KR, the summand function all over a space of `axes` numbers, each of `outputs` values. Beyond its samples it
    goes on continuously.

    kind : its name in files and on the command line; exact : whether it passes through its samples, and then has their
        values (n, outputs)
    Source: configuration-space patent, [0027], [0028], [0136], [0137]
    """

    kind: ClassVar[str]
    exact: ClassVar[bool]

    def value(self, x: np.ndarray) -> np.ndarray:
        """(..., outputs) m or rad at x (..., axes)."""
        ...

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """(..., outputs, axes) change of the values with x (..., axes); at a kink that of one side."""
        ...

    def error(self, x: np.ndarray) -> np.ndarray:
        """(..., outputs) m or rad, standard error of the values at x (..., axes): the samples' noise, and what lies
        between them or beyond.
        """
        ...

    def inside(self, x: np.ndarray) -> np.ndarray:
        """(...) bool, whether x (..., axes) lies among the samples; elsewhere the values are extrapolated."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """KSF_PM, the summand function on its samples: configurations (n, axes), values (n, outputs), variances (n,
    outputs), each sample once;
    strokes : (axes, 2) of the space. Raises ValueError for shapes that do not fit each other.

    Source: configuration-space patent, [0128] to [0130]
    """

    configurations: np.ndarray
    values: np.ndarray
    variances: np.ndarray
    strokes: np.ndarray

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

    def take(self, index: np.ndarray) -> "Known":
        """The samples of an index or mask (n,)."""
        return Known(self.configurations[index], self.values[index], self.variances[index], self.strokes)


def merge_repeats(known: Known, tolerance: float = 1e-5) -> Known:
    """Known with repeats of one configuration (within a share of the strokes) as one sample: their mean, weighted by
    their variances.
    """
    scaled = np.round(
        (known.configurations - known.strokes[:, 0]) / (tolerance * np.ptp(known.strokes, axis=1)) / 2
    ).astype(np.int64)
    _, first, at = np.unique(scaled, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(scaled):
        return known
    at, where = at.ravel(), np.zeros((len(first), scaled.shape[1]))
    np.add.at(where, at, known.configurations)
    return Known(where / np.bincount(at)[:, None], *average_samples(known, at), known.strokes)


def average_samples(known: Known, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(values, variances), (count, outputs) each, of samples that stand for one of 0..count - 1 each: at (n,). Weighted
    by their variances.
    """
    weight = 1 / np.maximum(known.variances, 1e-300)
    shape = int(at.max()) + 1, weight.shape[1]
    total, mean = np.zeros(shape), np.zeros(shape)
    np.add.at(total, at, weight)
    np.add.at(mean, at, weight * known.values)
    return mean / total, 1 / total
