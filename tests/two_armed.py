"""A trunk with two arms, as docs/hands/humanoid.toml states it, and what tests make of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.models.arm import arm_error_model_and_instrument_observations as model
from calib.models.arm.arm_error_model_and_instrument_observations import Observations
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.pose import exp

HUMANOID = Path(__file__).parents[1] / "docs" / "hands" / "humanoid.toml"
NOISE = np.repeat([3e-5, 1e-4], 3)  # m, rad


def humanoid():
    """Design of the trunk with two arms."""
    return design_from_rig_toml.load_design(HUMANOID)


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


def seen_by_cameras():
    """Text of the rig.toml with joints that stay in front, six cameras about them, and cubes on hands and base."""
    text = HUMANOID.read_text()
    middle = np.array([0, 0, 0, 0.3, 0.2, -0.6, 0, 0.4, 0, -0.3, -0.2, 0.6, 0, -0.4, 0])
    limits = np.stack([middle - 0.4, middle + 0.4], axis=1).round(3).tolist()
    start, stop = text.index("limits = ["), text.index("[[mechanism.branch]]")
    text = f"{text[:start]}limits = {limits}\n\n{text[stop : text.index('[instrument]')]}"
    centre, identity = np.array([0.8, -0.06, 0.44]), 0
    for k in range(6):
        place = centre + [2 * np.cos(k * np.pi / 3), 2 * np.sin(k * np.pi / 3), 0.9]
        text += f'[[camera]]\nname = "cam{k}"\nwidth = 1280\nheight = 1024\ndistortion = [-0.1, 0.08, 0.0, 0.0, 0.0]\n'
        text += "matrix = [[1000.0, 0.0, 639.5], [0.0, 1000.0, 511.5], [0.0, 0.0, 1.0]]\n"
        text += f"pose = {{ position = {place.round(4).tolist()}, look_at = {centre.tolist()} }}\n"
    cubes = {"base": ([0.5, 0.5, 0.4], [-0.5, -0.4, 0.5])}
    for body in ("left", "right", "base"):
        for n, place in enumerate(cubes.get(body, ([0.09, 0.0, 0.08], [-0.09, 0.02, 0.05]))):
            faces = ", ".join(f'"{face}" = {identity + k}' for k, face in enumerate(("+x", "-x", "+y", "-y", "+z")))
            identity += 5
            text += f'[[target]]\nname = "{body}{n}"\nbody = "{body}"\nedge = 0.12\nmarker = 0.1\n'
            text += f'dictionary = "DICT_5X5_100"\nfaces = {{ {faces} }}\n'
            text += f"pose = {{ position = {place}, rotvec = [0.0, 0.0, 0.3] }}\n"
    return text
