"""Combinations of fields: the sum of several passes, and a map restricted to part of its space.

Source: configuration-space patent, [0035] (corrections in some regions of the configuration space or the workspace)

Source: configuration-space patent, [0035]
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.correction.interpolation.field import Field
from rig.arrays import Booleans, Floats

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
            raise ValueError("a part is bounded on one side at the least")

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
