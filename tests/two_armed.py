"""A trunk with two arms, as docs/hands/humanoid.toml states it, and what tests make of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.models.arm import error_model_and_observations as model
from calib.models.arm.error_model_and_observations import Observations
from rig.formats.rig_toml import design_file
from rig.model.pose import exp

HUMANOID = Path(__file__).parents[1] / "docs" / "hands" / "humanoid.toml"
NOISE = np.repeat([3e-5, 1e-4], 3)  # m, rad


def humanoid():
    """Design of the trunk with two arms."""
    return design_file.load_design(HUMANOID)


def observed(arm, count, rng, hands=(0, 1), noise=NOISE):
    """Observations of some hands of an arm at `count` configurations, in all of which each of these is seen."""
    q = np.repeat(rng.uniform(*(0.9 * arm.limits).T, (count, len(arm.limits))), len(hands), axis=0)
    hand = np.tile(hands, count)
    T = model.predicted_target_poses(q, arm, hand) * exp(noise * rng.normal(size=(len(q), 6)))
    covariance = np.tile(np.diag(np.maximum(noise, 1e-12) ** 2), (len(q), 1, 1))
    return Observations("pose", q, T, covariance, np.zeros((len(q), 6, 0)), hand=hand)


def drawn(arm, rng, size=1.0):
    """An arm whose every parameter is drawn at random about a stated one's."""
    units = np.array([{"m": 3e-4, "rad": 1e-3}[unit] for unit in model.parameter_units(arm)])
    return model.arm_with_parameter_step(replace(arm), size * units * rng.normal(size=len(units)))
