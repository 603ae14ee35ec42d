"""Whether a machine is as good as tolerances require: conforms, does not, or cannot be said, with guard bands.

One decision is made of all tolerances. Judged is the depth below which the `coverage` of all poses lies, each pose's
depth the greater of its position and rotation errors over their tolerances: 1 is as good as required. It is accepted
only where even the upper limit is within 1, refused only where even the lower is beyond it, both one-sided with GUARD:
the guard band between is as wide as the limits are apart, and a decision, of one tolerance or of two, is wrong in 2.5 %
of cases at the most. Errors of the targets' scale are in no held-out pose, so that a position is accepted only where
the scale was certified. docs/mathematics.md (28); JCGM 106:2012, 8.3 (guarded acceptance).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from calib.certify.pose_error_promise import Bound

GUARD = 0.975
CONFORMS, FAILS, OPEN = "conforms", "does not conform", "cannot be said"


@dataclass(frozen=True, slots=True)
class Conformity:
    """Of one tolerance. quantity : "position" or "rotation"; tolerance, lower, upper, estimate : m or rad, of all
    quantities at once
    verdict : one of the three, the same for all tolerances; guard : between the tolerance and what may be accepted, m
        or rad
    given_scale : the verdict if the targets' scale is exact, which differs from `verdict` where a position would
        conform and nobody certified it
    beyond : how many of the held-out poses lie beyond this tolerance, as measured."""

    quantity: str
    tolerance: float
    estimate: float
    lower: float
    upper: float
    guard: float
    verdict: str
    given_scale: str
    beyond: int


def tolerance_conformity(
    tolerances: Sequence[tuple[str, float]], depth: Bound | None, scale_certified: bool, beyond: Sequence[int]
) -> tuple[Conformity, ...]:
    """Conformity with each tolerance, ("position", m) or ("rotation", rad).

    depth : Bound of the depth in units of the tolerances, its limits of the confidence GUARD; None where there are too
        few poses for one
    beyond : of each tolerance
    """
    if depth is None:
        depth = Bound(float("nan"), 0.0, float("inf"), float("nan"), 0.0, 0.0)
    given = CONFORMS if depth.upper <= 1 else FAILS if depth.lower > 1 else OPEN
    resting = not scale_certified and any(quantity == "position" for quantity, _ in tolerances)
    verdict = OPEN if given == CONFORMS and resting else given
    guard = depth.upper if depth.estimate != depth.estimate else depth.upper - depth.estimate
    return tuple(
        Conformity(
            quantity,
            size,
            size * depth.estimate,
            size * depth.lower,
            size * depth.upper,
            size * guard,
            verdict,
            given,
            count,
        )
        for (quantity, size), count in zip(tolerances, beyond)
    )
