"""Values of a nonlinear parameter among which to search: from its role, its usual size and what the exposures
resolve.
"""

import numpy as np

from rig.effects.framework.parameter import Parameter

LOG_STEPS, EVEN_STEP = 14, 0.01  # values of a "log" parameter over its usual range; steps of an "even" one
SIZES = 16  # values of a "size" parameter over its usual range
EDGE = 4  # frames at either end that a moment leaves


def parameter_grid(p: Parameter, t: np.ndarray) -> list[float]:
    """The values of a parameter of role "size", "log", "even" or "moment" to be tried; t : (n,) s, the exposures."""
    low, high = p.usual
    if p.role in ("size", "log"):
        return np.geomspace(low, high, SIZES if p.role == "size" else LOG_STEPS).tolist()
    if p.role == "even":
        return np.arange(max(low * 0.3, p.bounds[0]), min(high * 2.5, p.bounds[1]), EVEN_STEP).tolist()
    return ((t[EDGE - 1 : -EDGE] + t[EDGE : len(t) - EDGE + 1]) / 2).tolist()


def derivative_step(p: Parameter) -> float:
    """A small value of a parameter, for its derivative."""
    size = np.sqrt(p.usual[0] * p.usual[1]) if p.usual[0] > 0 else 1e-2 * max(map(abs, p.usual))
    return 1 / size if p.role == "inverse" else 0.1 * size
