"""Observations drawn straight from a design, for tests of locating and adjusting."""

from dataclasses import replace

import numpy as np

from rig import plan
from rig.mechanisms import hexapod
from synthetic import simulate, world
from vision.observations import from_corners
from vision.targets import marker_map


def scene(design, seed, frames=12, noise=0.04, size=1.0):
    """(Observations, stated Design, true Design, true poses) of one simulated recording."""
    rng = np.random.default_rng(seed)
    secret = world.draw(design, rng, size)
    lengths = plan.low_discrepancy(design.mechanism.strut_range, frames, seed=seed)
    T = hexapod.forward(lengths, secret.true.mechanism)
    corners = simulate.corners(secret.true, T, noise, rng)
    return from_corners(corners, np.arange(frames), design, marker_map(design)), design, secret.true, T


def known(design, true):
    """The stated design with the cameras as they truly are."""
    return replace(design, cameras=true.cameras)


def nees(errors, covariance):
    """(n,) normalised error squared of errors (n, d) under covariances (n, d, d)."""
    return np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
