"""Type aliases of NumPy arrays and of JSON values.

Those of arrays are named by what they hold. Arrays of dataclasses are made read-only, and their shapes are checked.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Json = dict[
    str, Any
]  # a table of a file: numbers, words, lists and tables by their names, known only once they are read


Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.integer]  # of any width: NumPy indexes by one, OpenCV counts in another
Booleans = NDArray[np.bool_]
ImageBytes = NDArray[np.uint8]  # (height, width) grey levels or (height, width, 3) BGR
Pixels = NDArray[np.integer | np.floating]  # what OpenCV draws on and gives back


def read_only_float_array_of_shape(value: ArrayLike, shape: tuple[int | None, ...], name_in_errors: str) -> Floats:
    """Read-only floats of a shape, such as (None, 3) with None for any length.

    name_in_errors : its name, in errors. Raises ValueError for another shape and for what is not finite
    """
    array = np.array(value, float)
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape)):
        raise ValueError(f"{name_in_errors}: expected shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name_in_errors}: not finite: {array.tolist()}")
    array.setflags(write=False)
    return array


def freeze_array(instance: object, name: str, shape: tuple[int | None, ...]) -> None:
    """Freeze an array field of a dataclass instance: read-only floats of a shape.

    Raises ValueError otherwise.
    """
    object.__setattr__(instance, name, read_only_float_array_of_shape(getattr(instance, name), shape, name))
