"""Observations drawn straight from a design, for tests of locating and adjusting."""

from dataclasses import replace

import numpy as np

from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from synthetic import random_true_machine_and_truth_file, recording_simulation
from vision.corner_observations_and_merging import observations_from_corners
from vision.marker_corner_prediction import marker_map


def scene(design, seed, frames=12, noise=0.04, size=1.0, spoil=None):
    """(Observations, stated Design, true Design, true poses) of one simulated recording. spoil : Corners -> Corners, or
    None.
    """
    rng = np.random.default_rng(seed)
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng, size)
    strokes = design.mechanism.strut_range
    route = plan.plan_of_configurations(
        configuration_generators.sobol_configurations(strokes, frames, seed=seed),
        strokes.mean(axis=1),
        plan.planned_axis_speeds(design),
    )
    done = recording_simulation.simulate_world(secret, route, rng)
    corners = recording_simulation.noisy_corners(done, noise, rng)
    corners = spoil(corners) if spoil else corners
    return (
        observations_from_corners(corners, np.arange(frames), design, marker_map(design)),
        design,
        secret.true,
        done.run.T_base_platform,
    )


def standing(observations, rng, sigma):
    """Observations with errors (px) added that come back in every frame wherever a base marker's corner stands still,
    and do not elsewhere.
    """
    _, index = np.unique(
        (observations.camera * 1000 + observations.marker) * 4 + observations.corner, return_inverse=True
    )
    still = sigma * rng.normal(size=(index.max() + 1, 2))[index]
    return replace(
        observations,
        uv=observations.uv + np.where(observations.on_platform[:, None], sigma * rng.normal(size=still.shape), still),
    )


def known(design, true):
    """The stated design with the cameras as they truly are."""
    return replace(design, cameras=true.cameras)


def nees(errors, covariance):
    """(n,) normalised error squared of errors (n, d) under covariances (n, d, d)."""
    return np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
