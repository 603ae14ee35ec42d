"""What an arm's remainder goes with: every channel of its log, known or not, time, order, step, direction, speed, dwell
and way travelled.
"""

import numpy as np

from calib.diagnosis.engine.lack_of_fit import Covariate, Share, explained_share, rank_covariates
from calib.diagnosis.problems.arm.candidate_search import joint_products
from calib.diagnosis.problems.arm.projected_pose_residuals import Fit
from calib.diagnosis.problems.remainder_covariates import motion_functions, time_and_sensor_functions

JOINTS = "joints"


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
            JOINTS: explained_share(fit.linear, 0, [(products[j], wide[:, [j]]) for j in range(count)], cluster)
        }
    return out
