"""What an arm still does when the catalogue has had its say: smooth functions of pose, load, time, history and sensors, unnamed."""

import numpy as np

from calib.diagnose import joint_scan
from calib.diagnose.joint_families import Family
from calib.diagnose.unknown import ALPHA, Unknown

KNOTS = 8  # of a smooth function of time
PRIOR = 1e-3  # rad; size of a coefficient


def unknowns(fit, again=None):
    """[Unknown] that the residuals of a Fit still hold, the most convincing first; last, scatter beyond the instrument's own.

    again : Repeats, which tell whether that scatter is noise or comes again with the same joint angles ("configuration")
    """
    arms = fit.arms
    tests = []
    for j in range(arms.q.shape[1]):
        others = np.delete(arms.q, j, axis=1)
        moves = np.sign(np.diff(arms.q[:, j], prepend=arms.q[0, j]))
        bases = {("pose",): np.concatenate([np.sin(others), np.cos(others)], axis=1), ("time",): _hats(arms.t), ("history",): moves[:, None]}
        bases |= {("torque",): np.sign(arms.moments[j][0])} if arms.moments[j][0].shape[1] else {}
        bases |= {(name,): ((v - v.mean()) / v.std())[:, None] for name, v in arms.channels.items() if np.ptp(v) > 0}
        tests += [Family("unknown", j, [{"on": depends}], lambda shape, b=basis: b, PRIOR) for depends, basis in bases.items()]
    out = []
    for score in joint_scan.scan(fit, tests):
        if score.p_value * len(tests) < ALPHA:
            size = score.family.weights(score.shape) @ score.coefficients
            share = max(0.0, 1 - score.freedom / max(score.drop, 1e-9))
            out.append(Unknown(score.family.place, float(size.std() * np.sqrt(share)), "rad", score.shape["on"], score.p_value, score.drop))
    out.sort(key=lambda u: -u.drop)
    if fit.scatter[0] > 0:
        own = np.einsum("nkk->nk", arms.own)[:, :3].mean()
        depends = ("configuration",) if again is not None and again.p_value < ALPHA else ()
        ratio = (fit.scatter[0] ** 2 / own) * np.sqrt(1.5 * fit.used.sum())
        out.append(Unknown("rig", float(fit.scatter[0] * np.sqrt(3)), "m", depends, float(np.exp(-0.5 * min(ratio, 30.0) ** 2)), float(ratio**2)))
    return out


def _hats(t):
    x = np.linspace(t[0], t[-1], KNOTS)
    return np.stack([np.interp(t, x, row) for row in np.eye(KNOTS)[1:]], axis=1)
