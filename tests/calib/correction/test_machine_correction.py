"""Correction summands: the patent's worked way, the fixed point, the remainder, and limits."""

import numpy as np
import pytest

from calib.correction.interpolation import gaussian_process_interpolation as gaussian_process
from calib.correction.machine_correction import (
    Correction,
    fit_geometry_and_remainder_of_correction,
    require_commands_in_axis_ranges,
)
from rig.errors import RigError, Unreachable
from rig.model.design import Free
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from tests.calib.noisy_samples import real, rms, sampled, workspace


def wavy(commands):
    """A strut whose screw has a lead error, and another that feels the whole configuration."""
    out = np.zeros(commands.shape)
    out[..., 1] = 3e-5 * np.sin((commands[..., 1] - 0.47) / 0.012)
    out[..., 4] = 2e-5 * (commands[..., 0] - commands[..., 2]) / 0.05
    return out


def test_summand_is_commanded_less_inverse_of_measured(design):
    samples, true = sampled(design, 1)
    correction, _ = fit_geometry_and_remainder_of_correction(samples, design.mechanism)
    commands = hexapod.inverse(workspace(design, 20), design.mechanism)
    exact = commands - hexapod.inverse(real(commands, true), design.mechanism)
    np.testing.assert_allclose(correction.summand(commands), exact, atol=2.5e-5)
    assert np.abs(exact).max() > 5e-4


def test_corrected_commands_solve_the_fixed_point(design):
    samples, _ = sampled(design, 2, deviation=wavy)
    correction, _ = fit_geometry_and_remainder_of_correction(samples, design.mechanism)
    assert any(correction.remainder)
    wanted = workspace(design, 50)
    commands = correction.inverse(wanted)
    np.testing.assert_allclose(
        commands, hexapod.inverse(wanted, design.mechanism) + correction.summand(commands), atol=1e-9
    )
    assert np.abs(pose_difference(correction.predict(commands), wanted)).max() < 1e-9
    x = hexapod.inverse(wanted, design.mechanism)
    first = np.abs(x + correction.summand(x) - commands).max()
    assert first > 1e-7  # the first step alone would miss by more than a tenth of a micrometre


def test_commanded_poses_become_the_poses_one_gets(design):
    samples, true = sampled(design, 3)
    correction, found = fit_geometry_and_remainder_of_correction(samples, design.mechanism)
    wanted = workspace(design)
    before = rms(pose_difference(wanted, real(hexapod.inverse(wanted, design.mechanism), true)))
    after = rms(pose_difference(wanted, real(correction.inverse(wanted), true)))
    assert before[0] > 50 * after[0] and after[0] < 1.2e-5


def test_the_remainder_takes_what_geometry_cannot(design):
    samples, true = sampled(design, 5, count=300, deviation=wavy)
    correction, _ = fit_geometry_and_remainder_of_correction(samples, design.mechanism)
    plain, _ = fit_geometry_and_remainder_of_correction(samples, design.mechanism, "none")
    wanted = workspace(design)
    errors = [rms(pose_difference(wanted, real(c.inverse(wanted), true, wavy)))[0] for c in (plain, correction)]
    assert correction.remainder[1] is not None and errors[1] < 0.75 * errors[0]


def test_no_remainder_is_made_of_noise(design):
    for seed in range(5):
        correction, _ = fit_geometry_and_remainder_of_correction(sampled(design, seed)[0], design.mechanism)
        assert correction.remainder == (None,) * 6


def test_the_remainder_fades_beyond_the_samples(design):
    rng = np.random.default_rng(0)
    strokes = np.tile([0.4, 0.5], (6, 1))
    x = rng.uniform(0.43, 0.47, (200, 6))
    part = gaussian_process.fit_gaussian_process(x, 4e-5 * np.sin(x[:, 2] / 0.004), np.full(200, 1e-12), 2, strokes)
    inside = rng.uniform(0.435, 0.465, (50, 6))
    np.testing.assert_allclose(part(inside), 4e-5 * np.sin(inside[:, 2] / 0.004), atol=4e-6)
    assert np.abs(part(np.full(6, 0.53))) < 1e-7 and part(np.zeros((2, 3, 6))).shape == (2, 3)


def test_unreachable_poses_are_all_listed(design):
    correction = Correction(design.mechanism, design.mechanism, (None,) * 6)
    commands = np.tile(design.mechanism.strut_range.mean(axis=1), (3, 1))
    require_commands_in_axis_ranges(commands, design.mechanism, ["a", "b", "c"])
    commands[1, 2] += 0.1
    commands[2] -= 0.2
    with pytest.raises(Unreachable) as caught:
        require_commands_in_axis_ranges(commands, design.mechanism, ["frame 0", "frame 7", "frame 9"])
    assert caught.value.index.tolist() == [1, 2]
    assert (
        "frame 7: strut 3 at" in str(caught.value)
        and "above its range" in str(caught.value)
        and "frame 9" in str(caught.value)
    )
    assert correction.rho(commands).shape == (3, 6)


def test_another_kind_is_refused_by_name(design):
    with pytest.raises(RigError, match="'free'"):
        fit_geometry_and_remainder_of_correction(sampled(design, 1)[0], Free())
