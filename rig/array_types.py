"""Array types for annotations (Floats, Integers, Booleans, Pixels ..); shapes and units stand in docstrings."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.integer]  # of any width: NumPy indexes by one, OpenCV counts in another
Booleans = NDArray[np.bool_]
ImageBytes = NDArray[np.uint8]  # (height, width) grey levels or (height, width, 3) BGR
Pixels = NDArray[np.integer | np.floating]  # what OpenCV draws on and gives back
