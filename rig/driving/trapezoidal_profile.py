"""How far along its way a move was through time: a trapezoid of speed between the moments at which it began and
ended.
"""

import numpy as np

Way = tuple[tuple[float, float], ...]
PIECES = 8  # straight pieces to a ramp: they leave the curve by less than a five hundredth of what is travelled in it


def trapezoidal_profile(begun: float, ended: float, cruise: float, ramp: float | None) -> Way:
    """((s, share of the way), ..) between begun and ended (s), first and last left out; straight pieces between them.

    cruise : s that the way would take at full speed alone; ramp : s from standing to full speed, or None where the
    controller keeps its acceleration to itself: then what the move took beyond `cruise` is taken to be the ramp
    A move too short for full speed is a triangle. What was not needed is waiting at its end.
    """
    whole = ended - begun
    if whole <= 0 or cruise <= 0:
        return ()
    if ramp is None:
        ramp = max(whole - cruise, 0.0)
    if ramp >= cruise:  # full speed is never reached
        moving = min(2 * np.sqrt(ramp * cruise), whole)
        ramp = moving / 2
    else:
        moving = min(cruise + ramp, whole)
        ramp = min(ramp, moving / 2)
    up = np.linspace(0, ramp, PIECES + 1)[1:]
    top = 1 / (moving - ramp)  # share per s at full speed
    if ramp > 0:
        rising = top * up**2 / (2 * ramp)
        t = np.concatenate([up, moving - up[::-1], [moving]])
        share = np.concatenate([rising, 1 - rising[::-1], [1.0]])
    else:
        t, share = np.array([moving]), np.array([1.0])
    keep = np.r_[True, np.diff(t) > 1e-9] & (t < whole - 1e-9)
    return tuple((float(begun + at), float(min(max(part, 0.0), 1.0))) for at, part in zip(t[keep], share[keep]))
