"""Independent parameters of an arm: by its structure, and by the rank of the data (pivoted QR).

A complete model of R joints that turn and P that slide has 4 R + 2 P + 6 parameters, of which an instrument of whole
poses tells all: of a slide only the direction counts. Which ones stand for the others is chosen in an order: the
places of base and tool, zeros, angles, then lengths. Sources: Mooring, Roth and Driels, Fundamentals of manipulator
calibration, 1991 (the count); Hayati, CDC 1983 (beta for d where axes are parallel)
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr

from calib.models.arm import error_model
from calib.models.arm.instrument_observations import observation_jacobian
from rig.arrays import Booleans, Floats
from rig.model.mechanism_geometry import Arm
from rig.model.pose import pose

PLAUSIBLE = {
    "m": 5e-3,
    "rad": 2e-2,
}  # what a maker's figure may be wrong by; data that tell less than this tell nothing
NAMED = 0.1  # share of the greatest coefficient from which a parameter is named as a partner


@dataclass(frozen=True, slots=True, eq=False)
class Rank:
    """free : (p,) bool, parameters fitted; dependent : pairs (held parameter, those it cannot be told from)
    condition : of the columns that were fitted, scaled by what is plausible; asked : parameters asked for."""

    free: Booleans
    dependent: tuple[tuple[str, tuple[str, ...]], ...]
    condition: float
    asked: int

    def report(self) -> list[str]:
        """Lines for a reader."""
        if not self.asked:
            return ["no parameters were sought"]
        lines = [f"{self.free.sum()} of {self.asked} parameters fitted; condition number {self.condition:.0f}"]
        lines += [
            f"{name} cannot be told from {', '.join(others)} and stays as stated"
            if others
            else f"{name} has no effect on what was measured and stays as stated"
            for name, others in self.dependent
        ]
        return lines


def parameter_rank(B: Floats, free: Booleans, names: tuple[str, ...], units: tuple[str, ...]) -> Rank:
    """Rank of the parameter columns B (rows, p), whitened, of the requested parameters: free (p,) bool.

    A column is dependent where, those before it given, the data leave its parameter less certain than PLAUSIBLE: a
    plain zero of the pivoted QR, but also a direction in which only rounding or noise would be fitted.
    """
    asked = np.flatnonzero(free)
    scaled = B[:, asked] * np.array([PLAUSIBLE[unit] for unit in units])[asked]
    dead = np.linalg.norm(scaled, axis=0) < 1
    live = asked[~dead]
    R, order = qr(scaled[:, ~dead], mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R)[: min(R.shape)])
    rank = int((diagonal >= 1).sum())
    keep = np.zeros(len(free), bool)
    keep[live[order[:rank]]] = True
    dependent = [(names[i], ()) for i in asked[dead]]
    if rank < len(live):
        partners = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])
        for j, column in enumerate(partners.T):
            strong = np.abs(column) > NAMED * np.abs(column).max()
            dependent.append((names[live[order[rank + j]]], tuple(names[i] for i in live[order[:rank]][strong])))
    values = np.linalg.svd(R[:rank, :rank], compute_uv=False)
    return Rank(keep, tuple(dependent), float(values[0] / values[-1]), len(asked))


CONFIGURATIONS = 60
SEED = 0
INDEPENDENT = 1e-7  # of a column's own length, m and rad alike, that must be left of it beside those before it
PARALLEL = float(np.cos(np.radians(5)))  # neighbouring axes nearer to parallel than this take beta for d


def generally_independent_parameters(arm: Arm, kind: str) -> Booleans:
    """Parameters (p,) bool of an Arm that a kind of observation determines independently in general.

    kind : as of Observations. "In general": at configurations all over the limits, with the arm's own rows, and
    instrument and target standing anywhere: where they really stand, what cannot be told there is for
    calib.models.arm.independent_parameters
    """
    rng, (low, high) = np.random.default_rng(SEED), arm.limits.T
    arm = replace(
        arm, base=pose(rng.normal(size=3), rng.normal(size=3)), tool=pose(0.1 * rng.normal(size=3), rng.normal(size=3))
    )
    q = rng.uniform(low, high, (CONFIGURATIONS, len(low)))
    J = observation_jacobian(kind, error_model.parameter_jacobian(q, arm), q, arm)
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


def near_parallel_axis_rows(arm: Arm) -> Booleans:
    """Rows (n,) bool whose two axes are near parallel, so that beta replaces d."""
    return np.asarray(np.abs(np.cos(arm.rows[:, 3]) * np.cos(arm.rows[:, 4])) > PARALLEL)


def _order(arm: Arm) -> list[int]:
    """Indices of the parameters, the preferred first; d of near parallel axes that turn, and beta of others, come
    last.
    """
    n = len(arm.joints)
    index = 6 + np.arange(5 * n).reshape(n, 5)
    parallel = near_parallel_axis_rows(arm)
    zeros = error_model.joint_zero_indices(arm)
    angles = [*index[:, 3], *index[parallel, 4]]
    lengths = [*index[:, 2], *index[~parallel, 1]]
    ends = [*range(6), *range(6 + 5 * n, 12 + 5 * n)]
    first = [*ends, *zeros[1:].tolist(), *angles, *lengths]
    return [int(k) for k in first] + [k for k in range(12 + 5 * n) if k not in first]
