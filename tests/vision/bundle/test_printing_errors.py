"""Printed markers a little off: how far is told by the recording, poses own up to it, and nothing is said where nothing
is off.
"""

from dataclasses import replace

import numpy as np
import pytest

from rig.model.arm_hands_effect_places_and_tolerances import PLACES, SIDES
from rig.model.pose import exp, pose_difference
from tests.numerical_derivatives import jacobian
from tests.vision.drawn_observations import nees, scene, standing
from tests.vision.test_recording_adjustment_with_hand_and_stages import joint_chi2
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    Printing,
    estimate_after_step,
    estimate_offset_from_stated,
)
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import adjustment_unknowns_and_start_estimate
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import whitened_residuals_and_derivatives
from vision.corner_observations_and_merging import whitener_of_observations
from vision.marker_corner_prediction import State, marker_map, predict_corners
from vision.recording_adjustment_with_hand_and_stages import measure_observations

FREE = ("poses", "lenses")
NOISE = 0.005  # px, of a good image


def printed(design, rng, place=0.6, side=0.5):
    """MarkerMap of a design whose markers are off on their faces by shares of what is tolerated."""
    markers = marker_map(design)
    tangent = np.zeros((len(markers.id), 6))
    tangent[:, :2] = place * PLACES.sigma * rng.normal(size=(len(markers.id), 2))
    grown = side * SIDES.sigma * (rng.normal() + rng.normal(size=len(markers.id)))
    return replace(markers, T_body_marker=markers.T_body_marker * exp(tangent), side=markers.side * (1 + grown))


def off_recording(design, seed, frames=24, noise=NOISE, **off):
    """(Observations, stated Design, true poses) of markers printed a little off."""
    observations, stated, true, T = scene(design, seed, frames=frames, noise=noise)
    rng, plain = np.random.default_rng(seed), State(true.cameras, T, {})
    moved = (
        predict_corners(observations, replace(plain, markers=printed(design, rng, **off)))[0]
        - predict_corners(observations, plain)[0]
    )
    return replace(observations, uv=observations.uv + moved), stated, T


def test_derivatives_of_prints_agree_with_differences(design):
    observations, stated, _ = off_recording(design, 3, frames=3)
    state = State(stated.cameras, scene(design, 3, frames=3)[3], {}, printed(design, np.random.default_rng(1)))
    u, estimate = adjustment_unknowns_and_start_estimate(
        observations, state, replace(state, markers=marker_map(stated)), FREE, printing=Printing(1.0, 0.5, 1.0, 1.0)
    )
    W, rng = whitener_of_observations(observations), np.random.default_rng(2)
    _, found = whitened_residuals_and_derivatives(observations, estimate, u, W)
    shared, local, h = rng.normal(size=u.shared), np.zeros((3, u.local)), 1e-3
    up, down = (
        W(
            observations.uv
            - predict_corners(observations, estimate_after_step(estimate, u, s * h * shared, local).state)[0]
        )
        for s in (1, -1)
    )
    expected = np.zeros_like(up)
    for d in found.values():
        expected[d.rows] = (d.shared @ shared[d.shared_columns[observations.marker[d.rows]]][..., None])[..., 0]
    np.testing.assert_allclose(-(up - down) / (2 * h), expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_the_common_part_of_the_sides_is_what_the_priors_make_likeliest(design):
    """Of each marker's side only the whole shows; no other split of it between its own and all together's costs
    less.
    """
    observations, stated, T = off_recording(design, 4, frames=3)
    state = State(stated.cameras, T, {}, printed(design, np.random.default_rng(1)))
    u, estimate = adjustment_unknowns_and_start_estimate(
        observations, state, replace(state, markers=marker_map(stated)), FREE, printing=Printing(0.0, 0.0, 0.0, 1.0)
    )
    away = estimate_offset_from_stated(estimate, replace(state, markers=marker_map(stated)), u)
    own = np.concatenate([np.arange(c.start, c.stop) for c in u.prints.rows.values()])

    def cost(common):
        return np.array(
            [
                (away[u.prints.together] + common[0]) @ (away[u.prints.together] + common[0])
                + ((away[own] - common[0]) ** 2).sum()
            ]
        )

    assert abs(away[u.prints.together][0]) > 0.1
    assert jacobian(cost, np.zeros(1))[0, 0] == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
def test_poses_own_up_to_how_markers_are_printed(design):
    """With places taken as stated poses would be off by some ten times what they say."""
    chi2, alone, count, claimed = 0.0, [], 0, []
    for seed in range(200, 206):
        observations, stated, T = off_recording(design, seed)
        m = measure_observations(observations, stated, marker_map(stated))
        errors = pose_difference(m.T_base_platform, T[m.frames])
        chi2, count = chi2 + joint_chi2(m, errors), count + len(errors)
        alone.append(np.mean(nees(errors, m.covariance)) / 6)
        assert m.noise == pytest.approx(NOISE, rel=0.06)
        claimed.append((m.adjustment.printing.place, m.adjustment.printing.side))
    assert chi2 / count == pytest.approx(6, rel=0.12)  # 864 numbers leave 5 % to chance
    assert np.mean(alone) < 2
    place, side = np.sqrt(np.mean(np.square(claimed), axis=0))
    assert place == pytest.approx(0.6, rel=0.2) and side == pytest.approx(0.5, rel=0.35)


def test_prints_are_told_from_what_the_pixel_grid_does_to_corners_that_stand_still(design):
    chi2, count = 0.0, 0
    for seed in range(200, 203):
        observations, stated, T = off_recording(design, seed)
        m = measure_observations(standing(observations, np.random.default_rng(seed), 0.006), stated, marker_map(stated))
        chi2, count = chi2 + joint_chi2(m, pose_difference(m.T_base_platform, T[m.frames])), count + len(T)
        assert m.standing == pytest.approx(0.006, rel=0.15)
        assert m.adjustment.printing.place == pytest.approx(0.6, rel=0.25) and not m.adjustment.printing.turn
    assert chi2 / count == pytest.approx(6, rel=0.16)  # 432 numbers leave 7 % to chance


def test_markers_printed_as_stated_are_taken_as_stated(design):
    for seed in range(300, 302):
        observations, stated, *_ = scene(design, seed, frames=20, noise=0.02)
        assert measure_observations(observations, stated, marker_map(stated)).adjustment.printing is None
