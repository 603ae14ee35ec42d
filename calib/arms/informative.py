"""Which configurations of an arm determine its parameters best, of those in which it is seen (D-optimal, by exchange)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.arms import model
from calib.arms.identify import parameters
from calib.arms.rank import PLAUSIBLE
from calib.identify.d_optimal import exchanged, summed
from rig.configurations import low_discrepancy
from rig.design import Arm
from rig.errors import RigError
from rig.mechanisms import arm as mechanism

CANDIDATES = 1500
FILL = 0.95  # of the limits
FEWEST = 2  # markers of what moves that a configuration must show


@dataclass(frozen=True, slots=True, eq=False)
class Informative:
    """q : (n, joints) rad or m, chosen; names, units : of the parameters asked for, "m" or "rad"; sigma, even : (p,) their standard errors by
    these, and by as many spread evenly; seen : share of all configurations tried in which the arm is seen."""

    q: np.ndarray
    names: tuple[str, ...]
    units: tuple[str, ...]
    sigma: np.ndarray
    even: np.ndarray
    seen: float


def choose(arm: Arm, count: int, sigmas: tuple[float, float], shown: Callable[[RigidTransform], np.ndarray] | None = None, seed: int = 0,
           progress: Callable[[int, int], None] | None = None) -> Informative:
    """Informative configurations, `count` of them. sigmas : (m, rad) standard deviations of a measured pose, per axis

    shown : how many markers of what moves are seen at poses (n,), or None where an instrument sees it anywhere; progress : called with (done, of)
    Raises RigError for too few configurations to hold the parameters, or where too few candidates are seen
    """
    q = low_discrepancy(arm.limits, CANDIDATES, FILL, seed)
    seen = np.ones(len(q), bool) if shown is None else shown(mechanism.forward(q, arm)) >= FEWEST
    free = parameters(arm, "pose")
    size = np.array([PLAUSIBLE[unit] for unit in model.units(arm)])[free]
    if 6 * count <= free.sum():
        raise RigError(f"{count} configurations cannot determine {free.sum()} parameters; it takes {free.sum() // 6 + 1}, better "
                       f"{free.sum() // 2}")
    if seen.sum() < 2 * count:
        raise RigError(f"in {seen.sum()} of {len(q)} configurations all over the limits {FEWEST} markers are seen whole; choosing {count} takes "
                       "more: narrow the limits, or turn the cameras")
    rows = model.parameter_jacobian(q[seen], arm)[..., free] / np.repeat(sigmas, 3)[:, None] * size
    picked = exchanged(rows, np.zeros((len(size), len(size))), count, "determinant", progress)
    even = np.linspace(0, len(rows) - 1, count).astype(int)
    sigma, plain = (size * np.sqrt(np.diag(np.linalg.inv(np.eye(len(size)) + summed(rows, chosen)))) for chosen in (picked, even))
    names, units = (tuple(word for word, asked in zip(words(arm), free) if asked) for words in (model.names, model.units))
    return Informative(q[seen][picked], names, units, sigma, plain, float(seen.mean()))
