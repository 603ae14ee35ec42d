"""Which parameters of an arm with slides, or of one whose hand's orientation alone is seen, are independent: by the
rank of its own model.

A complete model of R joints that turn and P that slide has 4 R + 2 P + 6 parameters, of which an instrument of whole
poses tells all: of a slide only the direction counts. Which ones stand for the others is chosen in an order: the places
of base and tool, zeros, angles, then lengths.
Sources: Mooring, Roth and Driels, Fundamentals of manipulator calibration, 1991 (the count); Hayati, CDC 1983 (beta for
d where axes are parallel)
"""

from dataclasses import replace

import numpy as np

from calib.models.arm import error_model
from calib.models.arm.instrument_observations import rows
from rig.model.design import Arm
from rig.model.pose import pose

CONFIGURATIONS = 60
SEED = 0
INDEPENDENT = 1e-7  # of a column's own length, m and rad alike, that must be left of it beside those before it
PARALLEL = float(np.cos(np.radians(5)))  # neighbouring axes nearer to parallel than this take beta for d


def independent(arm: Arm, kind: str) -> np.ndarray:
    """(p,) bool: parameters of an Arm, in the order of calib.models.arm.error_model, that a kind of observation tells
    apart in general.

    kind : as of Observations. "In general": at configurations all over the limits, with the arm's own rows, and
    instrument and target standing anywhere: where they really stand, what cannot be told there is for
    calib.models.arm.parameter_rank
    """
    rng, (low, high) = np.random.default_rng(SEED), arm.limits.T
    arm = replace(
        arm, base=pose(rng.normal(size=3), rng.normal(size=3)), tool=pose(0.1 * rng.normal(size=3), rng.normal(size=3))
    )
    q = rng.uniform(low, high, (CONFIGURATIONS, len(low)))
    J = rows(kind, error_model.parameter_jacobian(q, arm), q, arm)
    columns = J.reshape(-1, J.shape[-1])
    free, basis = np.zeros(columns.shape[1], bool), np.zeros((len(columns), 0))
    for k in _order(arm):
        length = np.linalg.norm(columns[:, k])
        rest = columns[:, k] - basis @ (basis.T @ columns[:, k])
        rest = rest - basis @ (basis.T @ rest)  # once more, for the digits
        left = np.linalg.norm(rest)
        if left > INDEPENDENT * max(float(length), 1.0):
            free[k], basis = True, np.column_stack([basis, rest / left])
    return free


def parallel_rows(arm: Arm) -> np.ndarray:
    """(n,) bool, rows whose two axes are near parallel, so that beta takes the place of d."""
    return np.asarray(np.abs(np.cos(arm.rows[:, 3]) * np.cos(arm.rows[:, 4])) > PARALLEL)


def _order(arm: Arm) -> list[int]:
    """Indices of the parameters, the preferred first; d of near parallel axes that turn, and beta of others, come
    last.
    """
    n = len(arm.joints)
    index = 6 + np.arange(5 * n).reshape(n, 5)
    parallel = parallel_rows(arm)
    zeros = error_model.zero_columns(arm)
    angles = [*index[:, 3], *index[parallel, 4]]
    lengths = [*index[:, 2], *index[~parallel, 1]]
    ends = [*range(6), *range(6 + 5 * n, 12 + 5 * n)]
    first = [*ends, *zeros[1:].tolist(), *angles, *lengths]
    return [int(k) for k in first] + [k for k in range(12 + 5 * n) if k not in first]
