"""The fewest poses for a promise: one configuration after another, each that which makes the corrected machine surest
all over its workspace.

What counts is the position error that the parameters leave once they are fitted to the poses so far, its mean square
over the workspace (I-optimal), exchanged against candidates all over the strokes. Source: Atkinson, Donev and Tobias,
Optimum Experimental Designs, 2007, ch. 10
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.models.platform.d_optimal_configurations import (
    FILL,
    Avoided,
    allowed_configurations,
    configuration_information,
)
from calib.models.platform.identification import pose_jacobian
from calib.models.platform.parameter_observability import PLAUSIBLE
from rig.errors import RigError
from rig.model.design import Hexapod
from rig.model.mechanisms import hexapod as mechanism
from rig.planning import plan
from rig.planning.configuration_sets import FILL as WORKSPACE

CANDIDATES = 1500
PLACES = 256
MOST = 400  # poses
DRAWS, SURE = 2000, 0.975


@dataclass(frozen=True, slots=True, eq=False)
class ChosenConfigurations:
    """commands : (n, 6) m, in the order in which they help most; left : (n + 1,) m, the position error, RMS over the
    workspace, that 97.5 % of machines keep to once so many of them are measured beside what was given."""

    commands: np.ndarray
    left: np.ndarray


def fewest_configurations(
    hexapod: Hexapod,
    promise: float,
    sigmas: tuple[float, float],
    given: np.ndarray | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    avoided: Avoided | None = None,
) -> ChosenConfigurations:
    """Promised configurations beside those given (k, 6) m: the fewest found that keep a promise (m).

    sigmas : (m, rad) standard deviations of a measured pose, per axis, each pose's own; progress : called with (done,
        of)
    avoided : which of configurations (n, 6) m are not to be visited, (n,) bool, or None where all may be
    Raises RigError where MOST poses do not keep it, or where none may be visited
    """
    spread = plan.low_discrepancy(hexapod.strut_range, CANDIDATES, FILL, seed)
    candidates, G = configuration_information(allowed_configurations(spread, avoided), hexapod, sigmas)
    places, _ = configuration_information(
        plan.low_discrepancy(hexapod.strut_range, PLACES, WORKSPACE, seed + 1), hexapod, sigmas
    )
    J = pose_jacobian(mechanism.forward(places, hexapod), hexapod)[:, :3].reshape(-1, 42) * PLAUSIBLE
    A = J.T @ J / len(places)
    covariance = np.eye(42)  # of the parameters, each in its plausible size
    if given is not None and len(given):
        known = configuration_information(given, hexapod, sigmas)[1].reshape(-1, 42)
        covariance = np.linalg.inv(np.eye(42) + known.T @ known)
    chosen: list[int] = []
    left = [_left(covariance, A, seed)]
    while left[-1] > promise:
        if len(chosen) == MOST:
            raise RigError(
                f"{MOST} poses leave {left[-1] * 1e6:.3g} um, not the {promise * 1e6:.3g} um promised: poses "
                "must be measured better"
            )
        half = G @ covariance  # (c, 6, 42)
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
    return ChosenConfigurations(candidates[chosen].reshape(-1, 6), np.array(left))


def _left(covariance: np.ndarray, A: np.ndarray, seed: int) -> float:
    """m, what SURE of machines keep to: mean squares are sums of squares of normal draws, weighed by the
    eigenvalues.
    """
    weights = np.maximum(np.linalg.eigvals(covariance @ A).real, 0)
    draws = np.random.default_rng(seed).chisquare(1, (DRAWS, 42)) @ weights
    return float(np.sqrt(np.quantile(draws, SURE)))
