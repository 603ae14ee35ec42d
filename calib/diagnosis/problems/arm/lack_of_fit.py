"""Lack of fit of an arm beyond all candidates: smooth functions, excess scatter, covariates of the rest."""

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.engine.lack_of_fit import (
    ALPHA,
    Covariate,
    LackOfFit,
    Share,
    Test,
    detect_excess_scatter,
    rank_covariates,
    share_explained_by_functions,
    significant_lack_of_fit,
    test_lack_of_fit,
)
from calib.diagnosis.problems.arm.candidate_search import joint_products
from calib.diagnosis.problems.arm.linearised_poses import Arms
from calib.diagnosis.problems.arm.projected_pose_residuals import Fit
from calib.diagnosis.problems.evidence_interface import Repeats
from calib.diagnosis.problems.remainder_covariates import motion_functions, time_and_sensor_functions
from rig.array_types import Floats
from rig.effects.framework.machine_motion_and_play import independent_load_columns

KNOTS = 8  # of a smooth function of time
PRIOR = 1e-3  # rad; size of a coefficient
SHARE = 0.05  # of the squares left, from which a covariate is named beside the scatter
JOINTS = "joints"


def find_lack_of_fit_by_joint(
    fit: Fit, correlated_frames: int = 1, place: str | None = None, alpha: float = ALPHA
) -> list[LackOfFit]:
    """Find lack of fit ([LackOfFit]) of a Fit's residuals to smooth functions at each joint, largest first.

    place : where alone they are asked, None for everywhere; alpha : chance of any where there is nothing
    """
    arms, found = fit.arms, []
    moved = arms.context.moved()
    for j in range(arms.q.shape[1]):
        products = joint_products(fit, j)
        information = float(products.gamma.sum())
        for depends, basis in _bases(arms, j):
            test = Test(moved.places[j], moved.units[j], (depends,), basis[fit.used][:, None, :], information, PRIOR)
            found.append(test_lack_of_fit(fit.linear, products, test, correlated_frames))
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


def excess_scatter(fit: Fit, repeats: Repeats | None, covariates: Sequence[Covariate]) -> list[LackOfFit]:
    """[LackOfFit] of excess scatter of positions and of rotations beyond their stated noise.

    repeats : Repeats, which show whether the scatter recurs with the same joint angles ("configuration"); where it does
    not, it depends on the covariates that explain some of it, or on nothing known. Where nobody states the noise, only
    what recurs under one command is beyond it
    """
    recurs = repeats is not None and repeats.p_value < ALPHA
    if fit.arms.assumed and not recurs:
        return []
    depends = ("configuration",) if recurs else tuple(c.name for c in covariates if _explains(c, len(covariates)))
    used, k = fit.used, fit.left.shape[1]
    taken = (fit.arms.freedoms.shape[2] + fit.known()) / k  # of each number measured
    found = []
    for part, unit in ((slice(0, 3), "m"), (slice(3, 6), "rad")):
        left, own = fit.left[used, part], fit.arms.own[used, part, part]
        if left.size:
            square = float(np.einsum("ni,nij,nj->", left, np.linalg.inv(own), left))
            noise = float(np.sqrt(np.einsum("nii->n", own).mean()))
            found.append(
                detect_excess_scatter("rig", unit, noise, square, left.size - left.shape[1] * taken, k // 3, depends)
            )
    return [u for u in found if u is not None]


def _explains(covariate: Covariate, count: int) -> bool:
    """Whether a covariate, one of so many, explains some of what is left with all admitted."""
    return any(s.p_value * count < ALPHA and s.share > SHARE for s in covariate.after.values())


def ranked_covariates(before: Fit, after: Fit, cluster: int) -> list[Covariate]:
    """[Covariate] ranked by the share of residuals they explain, without effects and with them.

    cluster : poses in a row whose errors may be alike
    """
    return rank_covariates(_shares(before, cluster), _shares(after, cluster))


def _shares(fit: Fit, cluster: int) -> dict[str, dict[str, Share]]:
    arms, used = fit.arms, fit.used
    count = arms.q.shape[1]
    products = [joint_products(fit, j) for j in range(count)]
    asked = {
        **time_and_sensor_functions(arms.t, arms.context.sensors),
        **motion_functions(arms.context.moved().path, arms.commands, arms.t),
    }
    out = {}
    for name, functions in asked.items():
        wide = np.broadcast_to(functions, (len(arms), count, functions.shape[2]))[used]
        out[name] = {
            JOINTS: share_explained_by_functions(
                fit.linear, 0, [(products[j], wide[:, [j]]) for j in range(count)], cluster
            )
        }
    return out
