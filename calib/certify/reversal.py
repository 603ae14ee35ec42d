"""ISO 230-2 of each axis from ladders: accuracy A, repeatability R and reversal B of positions come to from both sides by that axis alone.

An axis' deviation is what the calibrated machine would have had to be commanded beyond the command for the pose that was measured. The standard
asks for five positions at least, each come to five times from either side; what a recording has short of that is reported with its counts.
docs/mathematics.md (29)
"""

from dataclasses import dataclass

import numpy as np

from calib.certify.held_poses import HeldPoses
from calib.correct.correction import Correction
from calib.identify.geometry import strut_jacobian
from rig import mechanisms
from rig.design import Arm, Chain
from rig.mechanisms import arm, chain

POSITIONS, CYCLES = 5, 5  # of ISO 230-2


@dataclass(frozen=True, slots=True)
class AxisTest:
    """axis : "strut 1" ..; unit : m or rad; positions come to from both sides; cycles : fewest from either side
    B : greatest reversal over them, by size; B_mean : mean reversal, with its sign; E : systematic deviation (range of means)
    A, R : accuracy and repeatability of both directions, None where some position was come to once alone from a side
    u : standard uncertainty of one deviation from measuring; formal : whether there are as many as the standard asks for."""

    axis: str
    unit: str
    positions: int
    cycles: int
    B: float
    B_mean: float
    E: float
    A: float | None
    R: float | None
    u: float
    formal: bool


def iso230(correction: Correction, poses: HeldPoses) -> tuple[AxisTest, ...]:
    """AxisTest of each axis that was moved alone from both sides; none where rotations were not measured."""
    if not poses.rotations:
        return ()
    J = _to_axes(correction, poses)
    deviation = np.einsum("nij,nj->ni", J, poses.errors)
    noise = np.sqrt(np.einsum("nij,njk,nik->ni", J, poses.own, J))
    mechanism = correction.nominal
    alone = poses.step.sum(axis=1) == 1
    out = []
    for axis, name in enumerate(mechanisms.places(mechanism)):
        rows = np.flatnonzero(alone & poses.step[:, axis])
        found = _test(name, mechanisms.units(mechanism)[axis], poses, rows, axis, deviation[:, axis], float(noise[:, axis].mean()))
        if found is not None:
            out.append(found)
    return tuple(out)


def _to_axes(correction: Correction, poses: HeldPoses) -> np.ndarray:
    """(n, axes, 6) change of the axes with the pose's tangent."""
    if isinstance(correction.fitted, Arm):
        return np.linalg.pinv(arm.jacobian(poses.commanded, correction.fitted))
    if isinstance(correction.fitted, Chain):
        return np.linalg.pinv(chain.jacobian(poses.commanded, correction.fitted))
    return strut_jacobian(poses.T_base_platform, correction.fitted)


def _test(name: str, unit: str, poses: HeldPoses, rows: np.ndarray, axis: int, deviation: np.ndarray, u: float) -> AxisTest | None:
    means, spreads, counts = [], [], []
    for label in np.unique(poses.label[rows]):
        sides = [deviation[rows[(poses.label[rows] == label) & (poses.before[rows, axis] == sign)]] for sign in (1.0, -1.0)]
        if all(len(side) for side in sides):
            means.append([side.mean() for side in sides])
            spreads.append([side.std(ddof=1) if len(side) > 1 else np.nan for side in sides])
            counts.append(min(len(side) for side in sides))
    if not means:
        return None
    mean, s = np.array(means), np.array(spreads)
    reversal = mean[:, 0] - mean[:, 1]
    cycles = min(counts)
    told = np.isfinite(s).all()
    A = float((mean + 2 * s).max() - (mean - 2 * s).min()) if told else None
    R = float(np.maximum(2 * s.sum(axis=1) + np.abs(reversal), 4 * s.max(axis=1)).max()) if told else None
    return AxisTest(name, unit, len(mean), cycles, float(np.abs(reversal).max()), float(reversal.mean()), float(np.ptp(mean)), A, R, u,
                    len(mean) >= POSITIONS and cycles >= CYCLES)
