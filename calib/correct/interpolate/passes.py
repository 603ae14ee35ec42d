"""The method repeated: what each pass found on the machine corrected by those before it, added up.

Source: configuration-space patent, [0035]
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.correct.interpolate.field import Field


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
        return self.fields[-1].error(x)  # the last pass was measured on what the others left: their errors are in its samples

    def inside(self, x: np.ndarray) -> np.ndarray:
        return self.fields[-1].inside(x)
