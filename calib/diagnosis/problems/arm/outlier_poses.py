"""Outlier poses of an arm, excluded before the search."""

import numpy as np

from calib.diagnosis.engine.excluded_outliers import Crowd, LeftOut, Outliers
from calib.diagnosis.problems.arm.linearised_poses import Arms
from calib.diagnosis.problems.remainder_covariates import axis_speeds, time_cosines
from calib.identify.robust_fit import MIDDLE, MOST, outlier_rows, robust_fit
from rig.arrays import Floats

GROSS, GATE = (
    20.0,
    7.0,
)  # times the scatter of the others, from which a pose may be wild before anything is admitted, and after
SLOW = 4  # cosines of time that are free at each joint
ROWS = 4  # numbers measured for each that is free
REASON = (
    "what was measured and the command agree with no other pose, neither those before and after it nor those at "
    "joint angles near it"
)


def outlier_poses(arms: Arms, residuals: Floats, gate: float) -> Outliers:
    """Outliers by residuals left (n, k), m and rad, beyond a gate."""
    W = np.linalg.inv(np.linalg.cholesky(arms.own))
    columns = np.concatenate([arms.freedoms, _smooth(arms)], axis=2)[..., : residuals.size // ROWS]
    found = robust_fit([((W @ residuals[..., None])[..., 0], W @ columns)])
    all_off = _relative(found.residual)
    far = outlier_rows(all_off, arms.t, arms.q, gate)
    if far.sum() > MOST * len(arms):
        return Outliers(crowd=Crowd("poses", int(far.sum()), len(arms)))
    residual = np.linalg.solve(W[far], found.residual[far, :, None])[..., 0]
    told = []
    for frame, off, relative in zip(arms.frame[far].tolist(), residual, np.abs(all_off[far])):
        turned = int(relative.argmax()) >= 3
        size = float(np.linalg.norm(off[3:] if turned else off[:3]))
        told.append(LeftOut(frame, "pose", "rig", size, "rad" if turned else "m", float(relative.max()), REASON))
    return Outliers(frozenset(arms.frame[far].tolist()), left_out=tuple(told))


def _relative(residual: Floats) -> Floats:
    """(n, k) whitened residuals over one scatter of positions and one of rotations, by their middle length: what a
    joint does shows along other axes in every pose."""
    out = np.empty_like(residual)
    for part in (slice(0, 3), slice(3, 6)):
        if residual[:, part].size:
            out[:, part] = residual[:, part] / max(
                float(np.median(np.linalg.norm(residual[:, part], axis=1))) / np.sqrt(MIDDLE), 1e-300
            )
    return out


def _smooth(arms: Arms) -> Floats:
    """(n, k, q) what joints may do besides their geometry to what is measured, the plainest first."""
    path = arms.context.moved().path
    functions = [path.direction, axis_speeds(arms.commands, arms.t), path.last_step]
    functions += [np.broadcast_to(c[:, None], arms.q.shape) for c in (*time_cosines(arms.t, SLOW).T, *_varying(arms))]
    scaled = [values / np.abs(values).max() for values in functions if np.any(values)]
    return np.concatenate([arms.joints * values[:, None, :] for values in scaled], axis=2)


def _varying(arms: Arms) -> list[Floats]:
    """[(n,)] of the log's channels that vary, about their means."""
    return [values - values.mean() for values in arms.channels.values() if np.ptp(values) > 0]
