"""Moving axes over time: straight moves with trapezoidal speed, halts, history of positions."""

import bisect
import threading

import numpy as np

from rig.arrays import Floats

FINE = 1e-7  # m by which straight lines between knots may leave the true motion


class Axes:
    """n axes and all that they did: pieces of constant acceleration, one after the other. May be asked from other
    threads.

    t, start : s and (n,) m; speed : (n,) m/s and acceleration : (n,) m/s^2, each axis's limits
    """

    def __init__(self, t: float, start: Floats, speed: Floats, acceleration: Floats) -> None:
        self.speed, self.acceleration = np.array(speed, float), np.array(acceleration, float)
        start = np.array(start, float)
        self._lock = threading.RLock()
        self._t, self._p, self._v, self._a = [t], [start], [np.zeros_like(start)], [np.zeros_like(start)]

    @property
    def until(self) -> float:
        """s at which the last motion told ends, or ended."""
        return self._t[-1]

    def at(self, t: float) -> Floats:
        """(n,) m where they stand at a time (s), also one to come."""
        with self._lock:
            i, late = self._piece(t)
            return self._p[i] + late * (self._v[i] + late / 2 * self._a[i])

    def lengths_at(self, t: Floats | float) -> Floats:
        """(..., n) m at times (...) s."""
        t = np.asarray(t, float)
        with self._lock:
            i = np.clip(np.searchsorted(self._t, t, side="right") - 1, 0, None)
            late = np.maximum(t - np.asarray(self._t)[i], 0)[..., None]
            p, v, a = (np.asarray(each)[i] for each in (self._p, self._v, self._a))
        return p + late * (v + late / 2 * a)

    def go(self, t: float, target: Floats, duration: float = 0.0) -> float:
        """Begin a straight move at t (s), or when what is told already is done; returns when it ends.

        target : (n,) m; duration : s that it takes at least, without ramps. All axes start and arrive together, none
            beyond its limits.
        """
        t = max(t, self.until)
        start = self.at(t)
        way = np.asarray(target, float) - start
        far = np.abs(way)
        if not far.any():
            return t
        on = far > 0
        top = (self.speed[on] / far[on]).min()
        if duration > 0:
            top = min(top, 1 / duration)
        ramp = (self.acceleration[on] / far[on]).min()
        top = min(top, np.sqrt(ramp))  # a short way never comes to full speed
        up, cruise = top / ramp, 1 / top - top / ramp
        end = t + 2 * up + cruise
        with self._lock:
            self._piece_from(t, start, 0 * way, ramp * way)
            if cruise > 0:
                self._piece_from(t + up, start + ramp * up**2 / 2 * way, top * way, 0 * way)
            self._piece_from(t + up + cruise, start + (1 - ramp * up**2 / 2) * way, top * way, -ramp * way)
            self._piece_from(end, np.asarray(target, float), 0 * way, 0 * way)
        return end

    def halt(self, t: float) -> float:
        """Slow down from t (s) on, all axes together; what is told beyond is dropped. Returns when they stand."""
        with self._lock:
            i, late = self._piece(t)
            p, v = self.at(t), self._v[i] + late * self._a[i]
            self.freeze(t)
            if not v.any():
                return t
            brake = (np.abs(v) / self.acceleration).max()
            self._piece_from(t, p, v, -v / brake)
            self._piece_from(t + brake, p + v * brake / 2, 0 * v, 0 * v)
            return t + brake

    def freeze(self, t: float) -> None:
        """Stand at once, as when the power goes."""
        with self._lock:
            p = self.at(t)
            keep = bisect.bisect_right(self._t, t)
            for each in (self._t, self._p, self._v, self._a):
                del each[max(keep, 1) :]
            self._piece_from(t, p, 0 * p, 0 * p)

    def knots(self, since: float = -np.inf) -> tuple[Floats, Floats]:
        """(k,) s and (k, n) m from `since` on, between which straight lines leave the true motion by no more than
        FINE.
        """
        with self._lock:
            begins, bends = np.array(self._t), np.abs(self._a).max(axis=1)
            t: list[float] = []
            for i in range(max(int(np.searchsorted(begins, since)) - 1, 0), len(begins)):
                end = begins[i + 1] if i + 1 < len(begins) else begins[i]
                pieces = max(int(np.ceil((end - begins[i]) * np.sqrt(bends[i] / (8 * FINE)))), 1)
                t.extend(np.linspace(begins[i], end, pieces, endpoint=False))
            kept = np.array([one for one in t if one >= since] or [max(self.until, since)])
            return kept, self.lengths_at(kept)

    def _piece(self, t: float) -> tuple[int, float]:
        i = max(bisect.bisect_right(self._t, t) - 1, 0)
        return i, max(t - self._t[i], 0.0)

    def _piece_from(self, t: float, p: Floats, v: Floats, a: Floats) -> None:
        if t <= self._t[-1]:
            self._p[-1], self._v[-1], self._a[-1] = p, v, a
            return
        self._t.append(t)
        for each, value in ((self._p, p), (self._v, v), (self._a, a)):
            each.append(value)
