"""Play operator (backlash with memory) along a whole path, and the deviation it causes."""

import numpy as np

from rig.arrays import Floats
from rig.compute.numba_kernels import njit
from rig.effects.framework.machine_motion import Motion


def play_operator(lengths: Floats, half: float) -> Floats:
    """Play operator: output (m, axes) of a play of half width `half` along a path of lengths (m, axes), m or rad.

    The output starts in the middle of the gap and is dragged along at its ends. Between knots the input is monotonic,
    so the knots are all that matters. Source: Brokate and Sprekels, Hysteresis and Phase Transitions, 1996, ch. 2
    """
    return _walk(np.ascontiguousarray(lengths, dtype=float), float(half))


def play_deviation(motion: Motion, half: float) -> Floats:
    """Deviation (n, axes) m or rad from the command at the exposures by a play of half width `half`."""
    path = motion.path
    return motion.once(
        ("behind", half), lambda: (path.walked(lambda _, lengths: play_operator(lengths, half)) - path.lengths)[path.at]
    )


@njit(cache=True)
def _walk(lengths: Floats, half: float) -> Floats:
    out = np.empty_like(lengths)
    at = lengths[0].copy()
    for k in range(len(lengths)):
        for i in range(lengths.shape[1]):
            at[i] = min(max(at[i], lengths[k, i] - half), lengths[k, i] + half)
            out[k, i] = at[i]
    return out
