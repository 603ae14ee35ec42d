"""Whether a machine is as good as a tolerance asks: conforms, does not, or cannot be said, with guard bands.

Judged is the length below which the `coverage` of all poses lies. It is accepted only where even its upper limit is within the tolerance,
refused only where even its lower limit is beyond it, both one-sided with GUARD: the guard band between is as wide as the limits are apart,
and either decision is wrong in 2.5 % of cases at the most. docs/mathematics.md (28); JCGM 106:2012, 8.3 (guarded acceptance).
"""

from dataclasses import dataclass

from calib.certify.promise import Bound

GUARD = 0.975
CONFORMS, FAILS, OPEN = "conforms", "does not conform", "cannot be said"


@dataclass(frozen=True, slots=True)
class Conformity:
    """quantity : "position" or "rotation"; tolerance, lower, upper, estimate : m or rad; verdict : one of the three; guard : between the tolerance
    and what may be accepted, m or rad."""

    quantity: str
    tolerance: float
    estimate: float
    lower: float
    upper: float
    guard: float
    verdict: str


def judged(quantity: str, tolerance: float, bound: Bound) -> Conformity:
    """Conformity of a Bound whose limits have the confidence GUARD. tolerance : m or rad"""
    verdict = CONFORMS if bound.upper <= tolerance else FAILS if bound.lower > tolerance else OPEN
    return Conformity(quantity, tolerance, bound.estimate, bound.lower, bound.upper, bound.upper - bound.estimate, verdict)
