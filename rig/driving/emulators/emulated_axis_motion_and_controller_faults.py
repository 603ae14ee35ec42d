"""Emulated axes, and faults of their controller.

Motion over time (trapezoidal speed, halts, history) within limits. Faults are injected once or at a rate per move.
"""

import bisect
import threading
from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import RigError

KINDS = {
    "lost-ok": "an acknowledgement that never comes",
    "buffer-64": "a receive buffer of 64 bytes that silently drops the excess",
    "buffer-128": "a receive buffer of 128 bytes that silently drops the excess",
    "runs-after-error": "an error for a move that is executed anyway",
    "two-ok": "two acknowledgements for one line",
    "ok-after-error": "an error, the line not executed, and then an acknowledgement",
    "resend": "a resend is requested, without acknowledgement; the line was not executed",
    "resend-moving": "a resend is requested while the line is being executed",
    "late": "answers seconds late",
    "half-line": "half an answer; the rest later, or never",
    "garbage": "bytes that mean nothing, among the answers",
    "stale-alarm": "after a reset a piece of an older answer runs into the alarm",
    "reset-ignored": "an alarm in which resets are ignored until the power is switched",
    "early-stop": "standstill is reported before the fine approach ends",
    "done-in-error": "a move is reported done while an axis is in error, and has not arrived",
    "homes-on": "an axis fails to home, and the others home on",
    "unplug": "the connection is cut, and returns under another name",
    "stall": "an axis stops during a move",
    "drift": "an axis's zero wanders while it stands",
    "restart": "the controller restarts and loses its position",
}
ALWAYS = ("buffer-64", "buffer-128")  # they are so, and do not happen
ON_ANSWERS = ("late", "half-line", "garbage")


@dataclass(frozen=True, slots=True)
class FaultOrder:
    """kind : one of KINDS; rate : chance per move (or homing, for homes-on), or None for once, at the next."""

    kind: str
    rate: float | None


def parse_fault_orders(text: str) -> tuple[FaultOrder, ...]:
    """Fault orders parsed from text.

    `KIND` (once) or `KIND:RATE` (chance per move).
    Raises RigError.
    """
    kind, _, rate = text.partition(":")
    try:
        chance = float(rate) if rate else None
    except ValueError:
        chance = np.nan
    if (
        (kind not in KINDS and kind != "all")
        or (chance is not None and not 0 < chance <= 1)
        or (kind == "all" and chance is None)
    ):
        raise RigError(
            f"fault {text!r}: write KIND or KIND:RATE, the rate above 0 and at most 1; kinds are all (with a "
            f"rate), {', '.join(KINDS)}"
        )
    if kind != "all" or chance is None:
        return (FaultOrder(kind, chance),)
    happening = [kind for kind in KINDS if kind not in ALWAYS]
    return tuple(FaultOrder(kind, chance / len(happening)) for kind in happening)


class Faults:
    """Dice for orders. `begin` is called with every move; what it arms, `take` finds once."""

    def __init__(self, orders: tuple[FaultOrder, ...] = (), rng: np.random.Generator | None = None) -> None:
        self.orders, self.rng = list(orders), rng or np.random.default_rng(0)
        self.armed: dict[str, int] = {}  # kind: answers to let pass before
        self.struck: list[str] = []

    def always(self, kind: str) -> bool:
        """Whether a kind that is so, and does not happen, was ordered."""
        return any(order.kind == kind for order in self.orders)

    def begin(self, homing: bool = False) -> None:
        """A move, or a homing, is told: see what is to go wrong with it."""
        self.armed.clear()
        for order in list(self.orders):
            if order.kind in ALWAYS or (order.kind == "homes-on") != homing:
                continue
            if order.rate is None:
                self.orders.remove(order)
            elif self.rng.random() >= order.rate:
                continue
            self.armed[order.kind] = (
                int(self.rng.integers(4)) if order.kind in ON_ANSWERS and order.rate is not None else 0
            )

    def take(self, kind: str) -> bool:
        """Whether this goes wrong now; then it is over."""
        if kind not in self.armed:
            return False
        if self.armed[kind] > 0:
            self.armed[kind] -= 1
            return False
        del self.armed[kind]
        self.struck.append(kind)
        return True


FINE = 1e-7  # m by which straight lines between knots may leave the true motion


class MovingAxes:
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

        target : (n,) m; duration : s that it requires at least, without ramps. All axes start and arrive together, none
            beyond its limits.
        """
        t = max(t, self.until)
        start = self.at(t)
        travel = np.asarray(target, float) - start
        far = np.abs(travel)
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
            self._piece_from(t, start, 0 * travel, ramp * travel)
            if cruise > 0:
                self._piece_from(t + up, start + ramp * up**2 / 2 * travel, top * travel, 0 * travel)
            self._piece_from(t + up + cruise, start + (1 - ramp * up**2 / 2) * travel, top * travel, -ramp * travel)
            self._piece_from(end, np.asarray(target, float), 0 * travel, 0 * travel)
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
            retained = np.array([one for one in t if one >= since] or [max(self.until, since)])
            return retained, self.lengths_at(retained)

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


FINE_APPROACH = (2e-4, 0.4)  # m, s: what an early stop leaves to be crept
HOMING_SHARE = 0.5  # of the greatest speed
WANDER = 5e-5  # m by which a zero drifts
MOTOR = "motor"  # what is wrong with an axis in error


@dataclass(frozen=True, slots=True, eq=False)
class ExecutedMove:
    """A move that was executed: when it began (s), to which true lengths (n,) m it was commanded."""

    t: float
    target: Floats


class EmulatedMachine:
    """axes : as they truly are, lengths in m; zero : (n,) m, length where a counter reads 0; home : (n,) m, lengths
    after homing
    faults : dice; known : whether the counters are true when the power comes on

    executed : every move carried out; homed : whether the counters are true, as the controller believes
    deaf : whether it is in an error that only switching off and on ends; session : counts how often it was switched on
    """

    def __init__(self, axes: MovingAxes, zero: Floats, home: Floats, faults: Faults, known: bool) -> None:
        self.axes, self.zero, self.home, self.faults = axes, np.array(zero, float), np.array(home, float), faults
        self.executed: list[ExecutedMove] = []
        self.homed, self.deaf = known, False
        self._error = (0.0, "")  # from when (s) an axis is in error, and for what
        self.session = 1
        self._known = known
        self._off = -self.zero if known else -axes.at(axes.until)  # (n,) m, counter less true length
        self._lie: tuple[float, Floats] | None = None
        self._busy_until: float | None = None  # s until which it is said to move, where that is not so long as it moves
        self._homing: tuple[float, Floats | None] | None = None

    def counters(self, t: float) -> Floats:
        """(n,) m as the controller counts."""
        self.settle(t)
        lie = self._lie[1] * np.clip((t - self._lie[0]) / 0.1, 0, 1) if self._lie else 0.0
        return self.axes.at(t) + self._off + lie

    def moving(self, t: float) -> bool:
        """Whether the controller reports that it moves."""
        self.settle(t)
        return t < (self.axes.until if self._busy_until is None else self._busy_until)

    def fault(self, t: float) -> str:
        """What an axis is in error for, or ""."""
        return self._error[1] if t >= self._error[0] else ""

    def fail(self, t: float, what: str) -> None:
        """An axis is in error from now on."""
        self._error = (t, what)

    def deafen(self, t: float) -> None:
        """Stop, and be in an error that only switching off and on ends."""
        self.halt(t)
        self.deaf, self._error = True, (t, "critical")

    def homing(self, t: float) -> bool:
        """Whether it is homing, or what is left of that."""
        return self._homing is not None and t < self.axes.until

    def go(self, t: float, target: Floats, duration: float) -> None:
        """A move to counters (n,) m, in at least so long (s); the faults that are armed go with it."""
        target = np.asarray(target, float) - self._off
        start = self.axes.at(max(t, self.axes.until))
        self.executed.append(ExecutedMove(t, target))
        self._busy_until, self._lie = None, None
        take = self.faults.take
        if take("stall"):
            worst = int(np.argmax(np.abs(target - start)))
            target = target.copy()
            target[worst] = start[worst] + 0.5 * (target - start)[worst]
            self.axes.go(t, target, duration)
            if self.faults.rng.random() < 0.5:
                self._busy_until = np.inf
        elif take("done-in-error"):
            worst = int(np.argmax(np.abs(target - start)))
            short = 0.3 * (target - start) * (np.arange(len(target)) == worst)
            end = self.axes.go(t, target - short, duration)
            self._lie, self._error = (end - 0.1, short), (end, f"{MOTOR} {worst + 1}")
        elif take("early-stop"):
            travel = target - start
            rest = travel * min(FINE_APPROACH[0] / max(np.abs(travel).max(), 1e-9), 0.5)
            self._busy_until = self.axes.go(t, target - rest, duration)
            self.axes.go(t, target, FINE_APPROACH[1])
        else:
            self.axes.go(t, target, duration)

    def drift(self) -> None:
        """One counter wanders."""
        self._off = self._off + WANDER * np.eye(len(self._off))[self.faults.rng.integers(len(self._off))]

    def halt(self, t: float) -> float:
        """Decelerate and drop what is queued; returns at standstill."""
        self._busy_until, self._homing = None, None
        return self.axes.halt(t)

    def start_homing(self, t: float) -> tuple[float, bool]:
        """Begin to home all axes; returns when the controller knows how that went, and whether it went well."""
        self.axes.halt(t)
        self.homed, self._error, self._lie, self._busy_until = False, (0.0, ""), None, None
        speed = HOMING_SHARE * self.axes.speed
        travel = self.home - self.axes.at(t)
        if self.faults.take("homes-on"):
            travel = travel * (np.arange(len(travel)) > 0)  # the first axis does not move
            end = self.axes.go(t, self.axes.at(t) + travel, float((np.abs(travel) / speed).max()))
            self._homing = (end, None)
            return t + 0.5 * (end - t), False
        end = self.axes.go(t, self.home, float((np.abs(travel) / speed).max()))
        self._homing = (end, self.home)
        return end, True

    def settle(self, t: float) -> None:
        """Take note of a homing that has come to its end."""
        if self._homing is not None and t >= self._homing[0]:
            done, self._homing = self._homing[1] is not None, None
            if done:
                self._off, self.homed = -self.zero, True

    def restart(self, t: float) -> None:
        """The power goes and comes: axes stand at once, counters begin at 0 unless they are absolute."""
        self.axes.freeze(t)
        self._error, self.deaf, self._lie, self._busy_until, self._homing = (0.0, ""), False, None, None, None
        self.session += 1
        self.homed = self._known
        self._off = -self.zero if self._known else -self.axes.at(t)
