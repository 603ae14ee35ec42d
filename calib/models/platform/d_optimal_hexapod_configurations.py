"""Configurations that are D-optimal to calibrate a hexapod's parameters.

Criteria: "determinant" (D-optimal: the volume of the parameters' uncertainty), "noise" (the noise amplification index
of Nahvi and Hollerbach, ICRA 1996: smallest singular value squared over the greatest). Source of the exchange:
Fedorov, Theory of Optimal Experiments, 1972.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import PLAUSIBLE
from calib.models.platform.platform_identification import pose_parameter_jacobian
from rig.array_and_json_types import Booleans, Floats
from rig.errors import NotConverged, RigError
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod as mechanism
from rig.planning import configuration_generators
from rig.planning.timed_plan_and_visiting_order import time_balanced_order

CANDIDATES = 2000
FILL = 0.9  # of the strokes
PASSES = 6  # of exchanging; each ends early where nothing pays
PAYS = 1e-4  # relative gain below which an exchange is not made
LOOKED_AT = 24  # candidates whose noise amplification is worked out exactly, the most promising ones
CRITERIA = ("determinant", "noise")

ConfigurationExclusion = Callable[
    [Floats], Booleans
]  # configurations (n, 6) m -> (n,) bool, those that are not to be visited


@dataclass(frozen=True, slots=True, eq=False)
class DOptimalConfigurations:
    """commands : (n, 6) m, ordered so that time is no function of place
    root : (42, 42) information's square root, 1/m, with what was given; before : of what was given alone
    even : (42, 42) with as many low-discrepancy configurations in their stead"""

    commands: Floats
    root: Floats
    before: Floats
    even: Floats


def choose_d_optimal_configurations(
    hexapod: Hexapod,
    count: int,
    sigmas: tuple[float, float],
    criterion: str = "determinant",
    existing_configurations: Floats | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    exclusion: ConfigurationExclusion | None = None,
) -> DOptimalConfigurations:
    """D-optimal configurations chosen, `count` of them, in addition to those given (k, 6) m.

    sigmas : (m, rad) standard deviations of a measured pose's position and rotation, per axis; progress : called with
        (done, of)
    exclusion : which of configurations (n, 6) m are not to be visited, (n,) bool, or None where all may be
    Raises RigError for an unknown criterion, too few configurations to hold 42 parameters, or where none may be visited
    """
    if criterion not in CRITERIA:
        raise RigError(f"there is no criterion {criterion!r}; there are {', '.join(CRITERIA)}")
    existing_configurations = (
        np.zeros((0, 6)) if existing_configurations is None else np.asarray(existing_configurations, float)
    )
    if count + len(existing_configurations) < 7:
        raise RigError(
            f"{count + len(existing_configurations)} configurations cannot determine 42 parameters; "
            "minimum 7, better 30"
        )
    candidates, G = _candidates(hexapod, sigmas, seed, exclusion)
    known = (
        solvable_commands_and_whitened_jacobians(existing_configurations, hexapod, sigmas)[1].reshape(-1, 42)
        if len(existing_configurations)
        else np.zeros((0, 42))
    )
    picked = choose_configurations_by_exchange(G, known.T @ known, count, criterion, progress)
    even = solvable_commands_and_whitened_jacobians(
        configuration_generators.sobol_configurations(hexapod.strut_range, count, FILL, seed + 1), hexapod, sigmas
    )[1].reshape(-1, 42)
    parts = [np.concatenate([known, rows]) for rows in (G[picked].reshape(-1, 42), even)]
    chosen = candidates[picked]
    order = time_balanced_order(chosen, np.random.default_rng(seed))
    return DOptimalConfigurations(chosen[order], *(_root(rows) for rows in (parts[0], known, parts[1])))


def choose_configurations_by_exchange(
    whitened_jacobians: Floats,
    prior_information: Floats,
    count: int,
    criterion: str,
    progress: Callable[[int, int], None] | None = None,
) -> list[int]:
    """Choose `count` configurations by exchange.

    They are candidates of whitened rows (c, m, p), those that add most to prior information.
    """
    picked: list[int] = []
    gain = _determinant if criterion == "determinant" else _noise
    for k in range(count):  # greedily first, by volume: from nothing only that has a meaning
        M = prior_information + total_information(whitened_jacobians, picked)
        picked.append(int(np.argmax(_determinant(M + np.eye(whitened_jacobians.shape[2]), whitened_jacobians)[1])))
        if progress:
            progress(k + 1, count * (1 + PASSES))
    for turn in range(PASSES):
        moved = 0
        for k in range(count):
            rest = picked[:k] + picked[k + 1 :]
            M = (
                prior_information
                + total_information(whitened_jacobians, rest)
                + 1e-9 * np.eye(whitened_jacobians.shape[2])
            )
            now, values = gain(M, whitened_jacobians, picked[k])
            best = int(np.argmax(values))
            if values[best] > now + PAYS * abs(now):
                picked[k], moved = best, moved + 1
            if progress:
                progress(count * (1 + turn) + k + 1, count * (1 + PASSES))
        if not moved:
            break
    if progress:
        progress(count * (1 + PASSES), count * (1 + PASSES))
    return picked


def solvable_commands_and_whitened_jacobians(
    commands: Floats, hexapod: Hexapod, sigmas: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Commands (n, 6) m whose forward kinematics converges, and their whitened parameter Jacobians (n, 6, 42).

    The rows J give the information J^T J of a configuration.
    """
    commands = np.asarray(commands, float)
    while True:
        try:
            T = mechanism.forward(commands, hexapod)
        except NotConverged as error:
            commands = np.delete(commands, error.index, axis=0)
            continue
        weights = 1 / np.repeat(sigmas, 3)[:, None]
        return commands, pose_parameter_jacobian(T, hexapod) * weights * PLAUSIBLE


def _candidates(
    hexapod: Hexapod, sigmas: tuple[float, float], seed: int, avoided: ConfigurationExclusion | None
) -> tuple[Floats, Floats]:
    """Low-discrepancy configurations and the strokes' outermost ones, with their rows."""
    spread = configuration_generators.sobol_configurations(hexapod.strut_range, CANDIDATES, FILL, seed)
    return solvable_commands_and_whitened_jacobians(
        configurations_outside_exclusion(
            np.concatenate([spread, configuration_generators.simplex_configurations(hexapod.strut_range, 1, FILL)]),
            avoided,
        ),
        hexapod,
        sigmas,
    )


def configurations_outside_exclusion(commands: Floats, exclusion: ConfigurationExclusion | None) -> Floats:
    """Configurations among the commands (n, 6) m that the exclusion does not exclude.

    Raises RigError where none is.
    """
    retained = commands if exclusion is None else commands[~exclusion(commands)]
    if not len(retained):
        raise RigError(
            f"none of {len(commands)} configurations within the strokes may be visited: the calibration "
            "leaves no pose of the nominal model in reach"
        )
    return retained


def total_information(whitened_jacobians: Floats, picked: list[int] | Floats) -> Floats:
    """Total information (p, p) of the picked (k,) candidates with whitened rows (c, m, p)."""
    rows = whitened_jacobians[picked].reshape(-1, whitened_jacobians.shape[2])
    return rows.T @ rows


def _determinant(M: Floats, G: Floats, present: int = 0) -> tuple[float, Floats]:
    """(log volume that candidate `present` adds to information M, that which each candidate adds (c,))."""
    half = np.linalg.inv(np.linalg.cholesky(M))
    rows = G @ half.T
    values = np.linalg.slogdet(np.eye(rows.shape[1]) + rows @ np.swapaxes(rows, 1, 2))[1]
    return values[present], values


def _noise(M: Floats, G: Floats, present: int = 0) -> tuple[float, Floats]:
    """(noise amplification index with candidate `present`, with each candidate (c,), -inf for those not worth looking
    at).
    """
    size, V = np.linalg.eigh(M)
    promise = np.einsum("cik,k->c", (G @ V) ** 2, 1 / np.maximum(size, 1e-12) ** 2)
    look = np.r_[present, np.argsort(-promise)[:LOOKED_AT]]
    s = np.linalg.eigvalsh(M + np.swapaxes(G[look], 1, 2) @ G[look])
    index = np.maximum(s[:, 0], 0) / np.sqrt(s[:, -1])
    values = np.full(len(G), -np.inf)
    values[look[1:]] = index[1:]
    return index[0], values


def _root(rows: Floats) -> Floats:
    R: Floats = np.asarray(np.linalg.qr(rows, mode="r")) / PLAUSIBLE
    return np.concatenate([R, np.zeros((42 - len(R), 42))]) if len(R) < 42 else R
