"""The play operator, walked along a whole path: what is left of history in a strut."""

import numpy as np


def play(lengths, half):
    """(m, axes) where the output of a play of half width `half` (m) stands after each knot of a path (m, axes) m.

    The output starts in the middle of the gap and is dragged along at its ends. Between knots the input is monotonic, so the
    knots are all that matters. Source: Brokate and Sprekels, Hysteresis and Phase Transitions, 1996, ch. 2
    """
    out = np.empty_like(lengths)
    at = lengths[0].copy()
    for k, length in enumerate(lengths):
        at = np.clip(at, length - half, length + half)
        out[k] = at
    return out
