"""The method repeated: what each pass found on the machine corrected by those before it, added up.

Source: configuration-space patent, [0035]
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.correct.interpolation.field import Field
from calib.correct.interpolation.restricted_map import Within


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """fields : Field of each pass, the first first, all over the same space."""

    fields: tuple[Field, ...]
    kind: ClassVar[str] = "passes"
    exact: ClassVar[bool] = False

    def value(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(sum(field.value(x) for field in self.fields))

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(sum(field.gradient(x) for field in self.fields))

    def error(self, x: np.ndarray) -> np.ndarray:
        """Of the last pass that holds at x: it was measured on what the others left, whose errors are in its
        samples.
        """
        square = self.fields[0].error(x) ** 2
        for field in self.fields[1:]:
            weight = field.part.weight(np.asarray(x, float))[0][..., None] if isinstance(field, Within) else 1.0
            own = (field.field if isinstance(field, Within) else field).error(x) ** 2
            square = weight * own + (1 - weight) * square
        return np.asarray(np.sqrt(square))

    def inside(self, x: np.ndarray) -> np.ndarray:
        inside = self.fields[0].inside(x)
        for field in self.fields[1:]:
            inside = (
                np.where(field.part.holds(x), field.inside(x), inside) if isinstance(field, Within) else field.inside(x)
            )
        return np.asarray(inside)
