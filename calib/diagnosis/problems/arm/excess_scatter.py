"""An arm's scatter beyond the noise that is stated of its poses, and what it goes with as far as anything tells."""

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.engine.lack_of_fit import ALPHA, Covariate, LackOfFit, detect_excess_scatter
from calib.diagnosis.problems.arm.projected_pose_residuals import Fit
from calib.diagnosis.problems.measured_evidence import Repeats

SHARE = 0.05  # of the squares left, from which a covariate is named beside the scatter


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
