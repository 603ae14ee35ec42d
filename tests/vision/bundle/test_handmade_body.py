"""A body that is not as stated: its markers' places are freed where the scatter says so, found to their uncertainty,
and nothing bends for them.
"""

import numpy as np
import pytest
from scipy.stats import chi2

from rig.model.pose import log
from tests.vision.handmade_body import Handmade, handmade
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import rigid_transform_aligning_points
from vision.bundle.marker_and_target_displacements import are_stated_places_doubtful, marker_and_target_displacements
from vision.corner_observations_and_merging import observations_from_corners
from vision.marker_corner_prediction import marker_map
from vision.recording_adjustment_with_hand_and_stages import Measurement
from vision.recording_measurement import measure_with_stated_or_free_markers


def measured(made: Handmade, places: str = "auto") -> Measurement:
    frames, markers = np.arange(len(made.T)), marker_map(made.stated)
    observed = observations_from_corners(made.corners, frames, made.stated, markers)
    return measure_with_stated_or_free_markers(
        observed, made.stated, markers, ("poses", "lenses"), None, frames * 1.0, places
    )


def squares(made: Handmade, m: Measurement) -> np.ndarray:
    """(markers,) normalised error squared of the places found, truth seen from the frame that the stated places hold; 6
    is expected.
    """
    stated, true = marker_map(made.stated), marker_map(made.true)
    a, out, seen = m.adjustment, [], m.adjustment.unknowns.seen
    truth = (
        rigid_transform_aligning_points(true.corners[seen].reshape(-1, 3), stated.corners[seen].reshape(-1, 3))
        * true.T_body_marker
    )
    for row, columns in a.unknowns.markers.items():
        error = log(a.state.markers.T_body_marker[row].inv() * truth[row])
        out.append(error @ np.linalg.solve(a.shared_covariance[columns, columns], error))
    return np.array(out)


@pytest.mark.slow
@pytest.mark.parametrize("far", [1.0, 2.0])
def test_a_handmade_body_is_measured(far):
    made = handmade(1, far=far)
    m = measured(made)
    assert m.places_free and len(m.frames) == 100 and m.noise < 1.1 * 0.1 and m.inliers.mean() > 0.999
    assert len(marker_and_target_displacements(m.adjustment)) == 18 and all(
        move.moved for move in marker_and_target_displacements(m.adjustment)
    )
    assert squares(made, m).max() < chi2.isf(1e-4, 6)
    for stated, true, found in zip(made.stated.cameras, made.true.cameras, m.design.cameras):
        assert abs(found.matrix[0, 0] - true.matrix[0, 0]) < 15 and stated.name == found.name


def test_places_that_are_as_stated_are_kept():
    made = handmade(2, frames=40, off=(0.0, 0.0))
    m = measured(made)
    assert not m.places_free and not are_stated_places_doubtful(m, marker_map(made.stated))


@pytest.mark.slow
def test_twenty_handmade_bodies_are_measured():
    """The markers of one body share their cameras' errors, so 360 of them are fewer witnesses."""
    found = []
    for seed in range(20):
        made = handmade(seed, off=(1e-3 * (1 + seed % 3), 0.03))
        m = measured(made)
        assert m.places_free and len(m.frames) == 100 and m.noise < 1.1 * 0.1
        found.append(squares(made, m))
    found = np.concatenate(found)
    assert found.mean() / 6 == pytest.approx(1, abs=0.1) and (found < chi2.ppf(0.9973, 6)).mean() > 0.98
