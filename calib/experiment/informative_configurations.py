"""Informative configurations that determine a machine's parameters best (D-optimal, by exchange)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.correction import filter_closed_commands
from calib.models.geometric_parameters import geometric_parameters
from calib.models.platform.optimal_configurations import exchange_configurations, total_information
from rig.arrays import Floats, Integers
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.mechanism_geometry import Arm, Chain, Planar2
from rig.planning.approach_balance import balanced_order
from rig.planning.configuration_sets import sobol_configurations

CANDIDATES = 1500
FILL = 0.95  # of the travels
TOLD = 4.0  # information, that of the prior being 1, from which a combination of parameters is told
FEWEST = 2  # markers of what moves that a configuration must show


@dataclass(frozen=True, slots=True, eq=False)
class Informative:
    """values : (n, axes) m or rad, chosen, ordered so that neither time nor direction is a function of place
    names, units : of the parameters asked for, "m" or "rad"; sigma, even : (p,) their standard errors by
    these, and by as many spread evenly, along what these tell at all; undetermined : how many combinations keep half of
    what they may be off by or more
    seen : share of all configurations tried in which the machine is seen"""

    values: Floats
    names: tuple[str, ...]
    units: tuple[str, ...]
    sigma: Floats
    even: Floats
    undetermined: int
    seen: float


def informative_configurations(
    mechanism: Arm | Chain | Planar2,
    count: int,
    sigmas: tuple[float, float],
    visible_marker_count: Callable[[RigidTransform], Integers] | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Informative:
    """Informative configurations, `count` of them. sigmas : (m, rad) standard deviations of a measured pose, per axis

    visible_marker_count : how many markers of what moves are seen at poses (n,), or None where an instrument sees it
        anywhere;
        progress : called with (done, of)
    Raises RigError for too few configurations to hold the parameters, or where too few candidates close on a pose or
        are seen
    """
    kinematics = mechanisms.kinematics_of(mechanism)
    values = sobol_configurations(kinematics.travel(mechanism), CANDIDATES, FILL, seed)
    index, T = filter_closed_commands(values, lambda some: kinematics.forward(some, mechanism))
    values = values[index]
    seen = np.ones(len(values), bool) if visible_marker_count is None else visible_marker_count(T) >= FEWEST
    asked = geometric_parameters(mechanism)
    size = asked.size
    if not seen.any():
        raise RigError(
            f"in none of {len(values)} configurations all over the limits {FEWEST} markers are seen whole: "
            "turn the cameras"
        )
    rows = asked.jacobian(values[seen]) / np.repeat(sigmas, 3)[:, None] * size
    told = int(rows.any(axis=2).any(axis=0).sum())  # numbers of a pose that the parameters move at all
    if told * count <= len(size):
        raise RigError(
            f"{count} configurations cannot determine {len(size)} parameters; it takes {len(size) // told + 1}, better "
            f"{3 * len(size) // told}"
        )
    if seen.sum() < 2 * count:
        raise RigError(
            f"in {seen.sum()} of {len(values)} configurations all over the limits {FEWEST} markers are seen "
            f"whole; choosing {count} takes "
            "more: narrow the limits, or turn the cameras"
        )
    start = np.eye(len(size)) if asked.alike else np.zeros((len(size), len(size)))
    picked = exchange_configurations(rows, start, count, "determinant", progress)
    even = np.linspace(0, len(rows) - 1, count).astype(int)
    told_by, vectors = np.linalg.eigh(np.eye(len(size)) + total_information(rows, picked))
    sharp = vectors[:, told_by > TOLD]
    sigma, plain = (
        size
        * np.sqrt(
            np.einsum(
                "pi,ij,pj->p",
                sharp,
                sharp.T @ np.linalg.inv(np.eye(len(size)) + total_information(rows, chosen)) @ sharp,
                sharp,
            )
        )
        for chosen in (picked, even)
    )
    chosen = values[seen][picked]
    order = balanced_order(chosen, np.random.default_rng(seed), kinematics.travel(mechanism).mean(axis=1))
    return Informative(
        chosen[order], asked.names, asked.units, sigma, plain, len(size) - sharp.shape[1], float(seen.mean())
    )
