"""ISO 230-2 errors of each axis: accuracy A, repeatability R, reversal B and systematic deviation E.

An axis' deviation is what the calibrated machine would have had to be commanded beyond the command for the pose that
was measured. The standard requires five positions at least, each come to five times from either side; what a recording
has short of that is reported with its counts.
docs/mathematics.md (29); ISO 230-2:2014, clause 3, whose symbols these are, up standing for an arrow up (the axis had
lengthened).
"""

from dataclasses import dataclass

import numpy as np

from calib.certification.held_out_poses import HeldPoses
from calib.correction.correction import AnyCorrection
from rig.arrays import Floats, Integers
from rig.model import mechanisms

POSITIONS, CYCLES = 5, 5  # of ISO 230-2


@dataclass(frozen=True, slots=True)
class AxisTest:
    """axis : "strut 1" ..; unit : m or rad; positions come to from both sides; cycles : fewest from either side
    B : greatest reversal over them, by size; B_mean : mean reversal, with its sign
    E : bidirectional systematic deviation, the range of both directions' means; E_up, E_down : of one direction's
    M : mean bidirectional deviation, the range of the two directions' common means
    A, R : bidirectional accuracy and repeatability; A_up, A_down, R_up, R_down : of one direction
    each A and R None where some position was come to once alone from a side
    u : standard uncertainty of one deviation from measuring; formal : whether there are as many as the standard asks
        for."""

    axis: str
    unit: str
    positions: int
    cycles: int
    B: float
    B_mean: float
    E: float
    E_up: float
    E_down: float
    M: float
    A: float | None
    A_up: float | None
    A_down: float | None
    R: float | None
    R_up: float | None
    R_down: float | None
    u: float
    formal: bool


def iso230_axis_tests(correction: AnyCorrection, poses: HeldPoses) -> tuple[AxisTest, ...]:
    """ISO 230-2 test of each axis that was moved alone from both sides."""
    if not poses.rotations:
        return ()
    J = _to_axes(correction, poses)
    deviation = np.einsum("nij,nj->ni", J, poses.errors)
    noise = np.sqrt(np.einsum("nij,njk,nik->ni", J, poses.own, J))
    mechanism = correction.nominal
    alone = poses.step.sum(axis=1) == 1
    out = []
    for axis, name in enumerate(mechanisms.axis_places(mechanism)):
        rows = np.flatnonzero(alone & poses.step[:, axis])
        found = _test(
            name,
            mechanisms.axis_units(mechanism)[axis],
            poses,
            rows,
            axis,
            deviation[:, axis],
            float(noise[:, axis].mean()),
        )
        if found is not None:
            out.append(found)
    return tuple(out)


def _to_axes(correction: AnyCorrection, poses: HeldPoses) -> Floats:
    """(n, axes, 6) change of the axes with the pose's tangent."""
    fitted = correction.fitted
    return mechanisms.kinematics_of(fitted).axis_changes(poses.T_base_platform, poses.commanded, fitted)


def _test(
    name: str, unit: str, poses: HeldPoses, rows: Integers, axis: int, deviation: Floats, u: float
) -> AxisTest | None:
    means, spreads, counts = [], [], []
    for label in np.unique(poses.label[rows]):
        sides = [
            deviation[rows[(poses.label[rows] == label) & (poses.before[rows, axis] == sign)]] for sign in (1.0, -1.0)
        ]
        if all(len(side) for side in sides):
            means.append([side.mean() for side in sides])
            spreads.append([side.std(ddof=1) if len(side) > 1 else np.nan for side in sides])
            counts.append(min(len(side) for side in sides))
    if not means:
        return None
    mean, s = np.array(means), np.array(spreads)
    cycles = min(counts)
    E_up, E_down = np.ptp(mean, axis=0).tolist()
    return AxisTest(
        name,
        unit,
        len(mean),
        cycles,
        *reversal_values(mean),
        float(np.ptp(mean)),
        E_up,
        E_down,
        float(np.ptp(mean.mean(axis=1))),
        *axis_accuracy(mean, s),
        *axis_repeatability(mean, s),
        u,
        len(mean) >= POSITIONS and cycles >= CYCLES,
    )


def reversal_values(mean: Floats) -> tuple[float, float]:
    """Reversal values (B, mean B) of means (positions, 2), from below and from above."""
    B = mean[:, 0] - mean[:, 1]
    return float(np.abs(B).max()), float(B.mean())


def axis_accuracy(mean: Floats, standard_deviation: Floats) -> tuple[float | None, float | None, float | None]:
    """Axis accuracy (A, A up, A down) of means and standard deviations (positions, 2); None where unknown."""
    if not np.isfinite(standard_deviation).all():
        return None, None, None
    high, low = mean + 2 * standard_deviation, mean - 2 * standard_deviation
    up, down = (high.max(axis=0) - low.min(axis=0)).tolist()
    return float(high.max() - low.min()), up, down


def axis_repeatability(mean: Floats, standard_deviation: Floats) -> tuple[float | None, float | None, float | None]:
    """Axis repeatability (R, R up, R down) of means and standard deviations (positions, 2); None where unknown."""
    if not np.isfinite(standard_deviation).all():
        return None, None, None
    up, down = (4 * standard_deviation).max(axis=0).tolist()
    both = 2 * standard_deviation.sum(axis=1) + np.abs(mean[:, 0] - mean[:, 1])
    return float(max(both.max(), up, down)), up, down
