"""Type aliases of NumPy arrays by what they hold, and of JSON values."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Json = dict[
    str, Any
]  # a table of a file: numbers, words, lists and tables by their names, known only once they are read


Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.integer]  # of any width: NumPy indexes by one, OpenCV counts in another
Booleans = NDArray[np.bool_]
ImageBytes = NDArray[np.uint8]  # (height, width) grey levels or (height, width, 3) BGR
Pixels = NDArray[np.integer | np.floating]  # what OpenCV draws on and gives back
