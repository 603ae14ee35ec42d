"""Faults of an emulated controller.

They are injected once or at a rate per move.
"""

from dataclasses import dataclass

import numpy as np

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


def parse_faults(text: str) -> tuple[FaultOrder, ...]:
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
