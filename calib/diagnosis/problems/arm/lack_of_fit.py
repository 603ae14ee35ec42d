"""Lack of fit of an arm beyond all candidates: smooth functions, excess scatter, repeatability, covariates."""

import numpy as np

from calib.diagnosis.engine.lack_of_fit import ALPHA, LackOfFit, Test, significant_lack_of_fit, test_lack_of_fit
from calib.diagnosis.problems.arm.candidate_search import joint_products
from calib.diagnosis.problems.arm.linearised_poses import Arms
from calib.diagnosis.problems.arm.projected_pose_residuals import Fit
from rig.arrays import Floats
from rig.effects.framework.machine_motion import independent_load_columns

KNOTS = 8  # of a smooth function of time
PRIOR = 1e-3  # rad; size of a coefficient


def lack_of_fit(fit: Fit, cluster: int = 1, place: str | None = None, alpha: float = ALPHA) -> list[LackOfFit]:
    """[LackOfFit] of the residuals of a Fit to smooth functions at each joint, the largest first.

    place : where alone they are asked, None for everywhere; alpha : chance of any where there is nothing
    """
    arms, found = fit.arms, []
    moved = arms.context.moved()
    for j in range(arms.q.shape[1]):
        products = joint_products(fit, j)
        information = float(products.gamma.sum())
        for depends, basis in _bases(arms, j):
            test = Test(moved.places[j], moved.units[j], (depends,), basis[fit.used][:, None, :], information, PRIOR)
            found.append(test_lack_of_fit(fit.linear, products, test, cluster))
    return sorted(
        significant_lack_of_fit([u for u in found if u is not None and place in (None, u.place)], alpha),
        key=lambda u: -u.delta_chi2,
    )


def _bases(arms: Arms, j: int) -> list[tuple[str, Floats]]:
    """[(depends on, (n, q) smooth functions of it)] for a joint."""
    others = np.delete(arms.q, j, axis=1)
    moves = np.sign(np.diff(arms.q[:, j], prepend=arms.q[0, j]))
    out = [
        ("pose", np.concatenate([np.sin(others), np.cos(others)], axis=1)),
        ("time", _hats(arms.t)),
        ("history", moves[:, None]),
    ]
    links = arms.context.moved().links()[:, j]
    turning = links[:, independent_load_columns(links)]
    if turning.shape[1]:
        out.append(("torque", np.sign(turning)))
    return out + [(name, ((v - v.mean()) / v.std())[:, None]) for name, v in arms.channels.items() if np.ptp(v) > 0]


def _hats(t: Floats) -> Floats:
    x = np.linspace(t[0], t[-1], KNOTS)
    return np.stack([np.interp(t, x, row) for row in np.eye(KNOTS)[1:]], axis=1)
