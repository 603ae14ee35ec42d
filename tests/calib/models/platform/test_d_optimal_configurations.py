"""Plans for parameters: better than evenly spread by the criterion they were chosen for, and honest about what was
given.
"""

import numpy as np
import pytest

from calib.models.platform.d_optimal_hexapod_configurations import (
    CANDIDATES,
    CRITERIA,
    FILL,
    choose_d_optimal_configurations,
    solvable_commands_and_whitened_jacobians,
)
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    PLAUSIBLE,
    parameter_combinations_and_visibility,
)
from calib.models.platform.platform_identification import identify_platform
from rig.errors import RigError
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from rig.planning import configuration_generators
from tests.calib.noisy_samples import sampled

SIGMAS = (1e-5, 1e-4)


@pytest.fixture(scope="module")
def chosen(design):
    return {
        criterion: choose_d_optimal_configurations(design.mechanism, 24, SIGMAS, criterion) for criterion in CRITERIA
    }


def singular(root):
    return np.linalg.svd(root * PLAUSIBLE, compute_uv=False)


@pytest.mark.slow
def test_each_criterion_is_best_at_its_own(chosen):
    s = {name: singular(found.root) for name, found in chosen.items()}
    even = singular(chosen["noise"].even)
    assert s["determinant"].prod() > s["noise"].prod() > even.prod()
    index = {name: values[-1] ** 2 / values[0] for name, values in {**s, "even": even}.items()}
    assert index["noise"] > 1.07 * index["determinant"] and index["noise"] > 2 * index["even"]


def test_no_single_exchange_pays_any_more(chosen, design):
    """What the exchange ends in is an optimum among its candidates: tried anew by brute force at one place."""
    found = chosen["determinant"]
    _, chosen_rows = solvable_commands_and_whitened_jacobians(found.commands[1:], design.mechanism, SIGMAS)
    base = chosen_rows.reshape(-1, 42)
    spread = configuration_generators.sobol_configurations(design.mechanism.strut_range, CANDIDATES, FILL, 0)[:400]
    _, others = solvable_commands_and_whitened_jacobians(spread, design.mechanism, SIGMAS)
    now = np.linalg.slogdet((found.root * PLAUSIBLE).T @ (found.root * PLAUSIBLE))[1]
    best = max(np.linalg.slogdet(base.T @ base + rows.T @ rows)[1] for rows in others)
    assert best <= now + 0.01


def test_configurations_can_be_reached(chosen, design):
    for found in chosen.values():
        assert (
            found.commands.shape == (24, 6) and not hexapod.signed_limit_excess(found.commands, design.mechanism).any()
        )
        hexapod.forward(found.commands, design.mechanism)


def test_what_is_promised_is_what_a_fit_finds(chosen, design):
    """Standard errors along combinations before any pose is measured, held to a fit of poses simulated at the chosen
    commands.
    """
    own = np.repeat(SIGMAS, 3)
    errors = []
    for seed in range(30):
        samples, true = sampled(design, seed, count=24, commands=chosen["determinant"].commands, own=own)
        found = identify_platform(samples, design.mechanism)
        errors.append(geometric_parameters(found.mechanism) - geometric_parameters(true))
    parts, _ = parameter_combinations_and_visibility(chosen["determinant"].root, design.mechanism)
    z = np.array([np.array(errors) @ part.direction / part.sigma for part in parts])
    assert np.std(z) == pytest.approx(1, abs=0.06)


def test_what_is_given_counts(design):
    given = configuration_generators.sobol_configurations(design.mechanism.strut_range, 3)
    found = choose_d_optimal_configurations(design.mechanism, 20, SIGMAS, existing_configurations=given)
    hidden = [
        part for part in parameter_combinations_and_visibility(found.before, design.mechanism)[0] if not part.determined
    ]
    assert len(hidden) >= 42 - 18 and all(
        part.determined for part in parameter_combinations_and_visibility(found.root, design.mechanism)[0]
    )


def test_too_few_and_unknown_are_refused(design):
    with pytest.raises(RigError, match="3 configurations cannot determine 42"):
        choose_d_optimal_configurations(design.mechanism, 3, SIGMAS)
    with pytest.raises(RigError, match="'D'"):
        choose_d_optimal_configurations(design.mechanism, 30, SIGMAS, "D")
