"""A block moved by hand before a hand-held camera: tags off their places are found, no frame is flipped, none is filled
in.
"""

from dataclasses import replace

import numpy as np
import pytest

from rig.formats.rig_toml import camera_instrument_experiment_and_cube_turn_entries, design_from_rig_toml
from rig.model.pose import log, pose_difference
from tests.vision.tumbling_block import scene
from vision.bundle.adjustment_cross_validation_and_determined_unknowns import (
    crossvalidate_adjustment,
    determinacy_of_adjusted_unknowns,
)
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import rigid_transform_aligning_points
from vision.bundle.bundle_adjustment import adjust_bundle
from vision.bundle.marker_and_target_displacements import adjusted_markers, compare_stated_and_adjusted_places
from vision.marker_corner_prediction import marker_map
from vision.recording_adjustment_with_hand_and_stages import measure_observations
from vision.recording_measurement import unsolved_frames_with_enough_markers

FREE = ("lenses", "markers")


@pytest.fixture(scope="module")
def worked():
    observations, stated, true, t = scene(1)
    return observations, stated, true, t, measure_observations(observations, stated, marker_map(stated), FREE, t=t)


def datums(measured, true):
    """Base and platform frame of the stated places, in the true ones: what measured poses must be turned by to be
    compared.
    """
    a = measured.adjustment
    seen, stated = a.unknowns.seen, a.stated.markers
    on = stated.on_platform[seen]
    return [
        rigid_transform_aligning_points(true.markers.corners[rows].reshape(-1, 3), stated.corners[rows].reshape(-1, 3))
        for rows in (seen[~on], seen[on])
    ]


@pytest.mark.slow
def test_frames_are_solved_and_their_covariance_is_true(worked):
    observations, stated, true, t, m = worked
    assert len(m.frames) >= 0.9 * len(t)
    base, platform = datums(m, true)
    errors = pose_difference(m.T_base_platform, base * true.platform[m.frames] * platform.inv())
    assert np.abs(errors[:, 3:]).max() < 0.1 and np.linalg.norm(errors[:, :3], axis=1).max() < 0.02  # no flip
    square = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(m.covariance), errors)
    assert np.median(square) == pytest.approx(5.35, rel=0.35)


def test_tags_off_their_places_are_found_within_their_intervals(worked):
    observations, stated, true, t, m = worked
    found = compare_stated_and_adjusted_places(m, t)
    base, platform = datums(m, true)
    inside = []
    markers = m.adjustment.stated.markers
    rows = {int(number): row for row, number in enumerate(markers.id)}
    for move in found.moves:
        row = rows[move.place.number]
        true_pose = (platform if markers.on_platform[row] else base) * true.markers.T_body_marker[row]
        inside += (np.abs(log(markers.T_body_marker[row].inv() * true_pose) - move.by) < move.ci95).tolist()
    assert np.mean(inside) > 0.85 and len(found.moves) == len(m.adjustment.unknowns.seen)
    assert sum(move.moved for move in found.moves) >= len(found.moves) - 1
    assert found.weighted[0] > 3 > 1.3 > found.weighted[1] and not found.odd
    assert np.median(found.after) < 0.5 * np.median(found.before)


def test_held_out_frames_are_as_far_off_as_the_covariance_says(worked):
    m = worked[-1]
    held = crossvalidate_adjustment(m.used(), m.adjustment)
    assert held.ratio == pytest.approx(1, abs=0.12) and held.corners == m.inliers.sum()
    a = m.adjustment
    unmoved = adjust_bundle(m.used(), replace(a.state, markers=a.stated.markers), ("lenses",), stated=a.stated)
    assert crossvalidate_adjustment(m.used(), unmoved).ratio > 2  # places as stated do not describe these images


def test_the_statement_names_who_holds_the_frames(worked):
    lines = "\n".join(determinacy_of_adjusted_unknowns(worked[-1].adjustment).lines())
    assert (
        "base frame is fixed by the stated positions of its markers as a whole" in lines
        and "camera poses as stated" in lines
    )


def test_stated_places_that_contradict_are_told(worked):
    observations, stated, true, t, _ = worked
    m = measure_observations(observations, stated, marker_map(stated), ("lenses",), t=t)
    assert len(unsolved_frames_with_enough_markers(m)) > 0.05 * len(t) and len(m.frames) < len(worked[-1].frames)


@pytest.mark.slow
def test_one_sighting_counts_only_where_neighbours_confirm_it(worked):
    observations, stated, true, t, m = worked
    full = [
        f for f in range(20, 100) if (observations.frame[observations.on_platform] == f).sum() >= 8 and f in m.frames
    ]
    f = full[len(full) // 2]
    mine = (observations.frame == f) & observations.on_platform
    one = observations.marker == observations.marker[mine][0]
    alone = observations.take(~mine | one)
    timed = measure_observations(alone, stated, marker_map(stated), FREE, t=t)
    untimed = measure_observations(alone, stated, marker_map(stated), FREE)
    assert f in timed.frames and "single sighting" in untimed.unsolved[f]
    k, j = timed.frames.tolist().index(f), m.frames.tolist().index(f)
    assert np.linalg.norm(pose_difference(timed.T_base_platform[k], m.T_base_platform[j])[3:]) < 0.2


def test_places_are_written_into_rig_toml_and_read_back(worked, tmp_path):
    m = worked[-1]
    text = "\n".join(
        ['schema = "rig/1"', "[mechanism]", 'kind = "free"']
        + [
            f'[[target]]\nname = "{target.name}"\nbody = "{target.body}"\ndictionary = '
            f'"{target.dictionary}"\nedge = 1.0\nmarker = 0.5\n'
            'faces = {"+x" = 0}\npose = { position = [0.0, 0.0, 0.0], rotvec = [0.0, 0.0, 0.0] }'
            for target in m.design.targets
        ]
    )
    path = tmp_path / "rig.toml"
    path.write_text(
        camera_instrument_experiment_and_cube_turn_entries.rig_toml_with_target_markers_replaced(
            text, adjusted_markers(m)
        )
    )
    loaded = marker_map(design_from_rig_toml.load_design(path))
    np.testing.assert_allclose(loaded.corners, m.adjustment.state.markers.corners, atol=1e-8)
