"""The fewest poses of a machine for a promised accuracy.

What counts is the position error that the parameters leave once they are fitted to the poses so far, its mean square
over the workspace (I-optimal), exchanged against candidates all over the travel. Source: Atkinson, Donev and Tobias,
Optimum Experimental Designs, 2007, ch. 10
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from calib.correction.machine_correction import indices_and_poses_of_solvable_commands
from calib.models.machine_parameters_and_file_entries import independent_parameter_names_units_sizes_and_jacobian
from calib.models.platform.d_optimal_hexapod_configurations import (
    FILL,
    ConfigurationExclusion,
    configurations_outside_exclusion,
)
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import PLAUSIBLE
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, has_struts
from rig.planning.configuration_generators import FILL as WORKSPACE
from rig.planning.configuration_generators import evenly_spread_configurations

FEWEST_CANDIDATES = 1500
PLACES = 256
MOST = 400  # poses
DRAWS, SURE = 2000, 0.975


@dataclass(frozen=True, slots=True, eq=False)
class FewestConfigurations:
    """commands : (n, axes) m or rad, in the order in which they help most; left : (n + 1,) m, the position error, RMS
    over the workspace, that 97.5 % of machines keep to once so many of them are measured beside what was given."""

    commands: Floats
    left: Floats


def fewest_configurations_for_accuracy(
    mechanism: Commanded,
    promise: float,
    sigmas: tuple[float, float],
    existing_configurations: Floats | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    exclusion: ConfigurationExclusion | None = None,
) -> FewestConfigurations:
    """Fewest configurations that keep a promised accuracy (m).

    They are those found, in addition to those given (k, axes).
    sigmas : (m, rad) standard deviations of a measured pose, per axis, each pose's own; progress : called with (done,
        of)
    exclusion : which of configurations (n, axes) are not to be visited, (n,) bool, or None where all may be
    Raises RigError where MOST poses do not keep it, or where none may be visited
    """
    spread = evenly_spread_configurations(mechanism, FEWEST_CANDIDATES, FILL, seed)
    white = 1 / np.repeat(sigmas, 3)[:, None]
    candidates, G = _solvable_and_rows(configurations_outside_exclusion(spread, exclusion), mechanism)
    G = G * white
    places, J = _solvable_and_rows(evenly_spread_configurations(mechanism, PLACES, WORKSPACE, seed + 1), mechanism)
    count = J.shape[2]
    J = J[:, :3].reshape(-1, count)
    A = J.T @ J / len(places)
    covariance: Floats = np.eye(count)  # of the parameters, each in its plausible size
    if existing_configurations is not None and len(existing_configurations):
        known = (_solvable_and_rows(existing_configurations, mechanism)[1] * white).reshape(-1, count)
        covariance = cast(Floats, np.linalg.inv(np.eye(count) + known.T @ known))
    chosen: list[int] = []
    left = [_left(covariance, A, seed)]
    while left[-1] > promise:
        if len(chosen) == MOST:
            raise RigError(
                f"{MOST} poses leave {left[-1] * 1e6:.3g} um, not the {promise * 1e6:.3g} um promised: poses "
                "must be measured more accurately"
            )
        half = G @ covariance  # (c, 6, p)
        inner = np.eye(6) + half @ np.swapaxes(G, 1, 2)
        gain = np.trace(np.linalg.solve(inner, half @ A @ np.swapaxes(half, 1, 2)), axis1=1, axis2=2)
        best = int(np.argmax(gain))
        chosen.append(best)
        covariance = covariance - half[best].T @ np.linalg.solve(inner[best], half[best])
        left.append(_left(covariance, A, seed))
        if progress:
            progress(len(chosen), MOST)
    if progress:
        progress(MOST, MOST)
    return FewestConfigurations(candidates[chosen].reshape(-1, candidates.shape[1]), np.array(left))


def _solvable_and_rows(values: Floats, mechanism: Commanded) -> tuple[Floats, Floats]:
    """(values (n, axes) of those that close on a pose, change of their poses (n, 6, p) with each independent parameter
    by its plausible size).
    """
    parameters = independent_parameter_names_units_sizes_and_jacobian(mechanism)
    size = np.full(len(parameters.size), PLAUSIBLE) if has_struts(mechanism) else parameters.size
    kinematics = mechanisms.kinematics_of(mechanism)
    index, _ = indices_and_poses_of_solvable_commands(
        np.asarray(values, float), lambda some: kinematics.forward(some, mechanism)
    )
    return values[index], parameters.jacobian(values[index]) * size


def _left(covariance: Floats, A: Floats, seed: int) -> float:
    """m, what SURE of machines keep to: mean squares are sums of squares of normal draws, weighed by the
    eigenvalues.
    """
    weights = np.maximum(np.linalg.eigvals(covariance @ A).real, 0)
    draws = np.random.default_rng(seed).chisquare(1, (DRAWS, len(A))) @ weights
    return float(np.sqrt(np.quantile(draws, SURE)))
