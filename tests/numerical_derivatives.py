"""Derivatives by central differences, to hold analytic ones to."""

import numpy as np


def jacobian(function, x, step=1e-6):
    """(..., n) derivative of function(x (n,)) -> array by central differences."""
    columns = []
    for i in range(len(x)):
        shift = np.zeros(len(x))
        shift[i] = step
        columns.append((np.asarray(function(x + shift)) - np.asarray(function(x - shift))) / (2 * step))
    return np.stack(columns, axis=-1)
