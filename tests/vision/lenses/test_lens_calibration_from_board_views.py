"""A lens from views of a board: the truth found within its covariance, models told apart on views held out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.errors import NotEnoughData
from rig.model.calibration_board_layout_and_description_parsing import parse_board
from rig.model.design import Camera
from rig.model.pose import pose, transform_points
from vision import opencv_lens_model as lens
from vision.lenses.calibration_board_corner_detection_in_photograph import BoardView
from vision.lenses.lens_calibration_from_board_views import (
    calibrate_lens,
    choose_simplest_adequate_lens_model,
    cross_validate_lens,
    observations_from_board_views,
    projection_pixels_and_uncertainty,
)

BOARD = parse_board("charuco:8x9:0.03:0.02:DICT_6X6_250")
TRUE = Camera(
    "cam",
    1280,
    1024,
    [[1000, 0, 650], [0, 1005, 500], [0, 0, 1]],
    [-0.2, 0.08, 1e-3, -5e-4, 0.0],
    RigidTransform.identity(),
)


def views(seed, count=12, noise=0.05, camera=TRUE):
    rng = np.random.default_rng(seed)
    out = []
    while len(out) < count:
        T = pose([-0.12, -0.135, 0], [0, 0, 0])
        T = pose(rng.uniform([-0.12, -0.1, 0.35], [0.12, 0.1, 0.6]), 0.5 * rng.normal(size=3) * [1, 1, 0.5]) * T
        points = transform_points(T, BOARD.points)
        uv = lens.project(points, camera.matrix, camera.distortion) + noise * rng.normal(size=(len(points), 2))
        inside = ((uv > 5) & (uv < np.array([camera.width, camera.height]) - 5)).all(axis=1)
        if inside.sum() > 20:
            rows = np.flatnonzero(inside)
            out.append(BoardView(rows, uv[rows], np.tile(0.02**2 * np.eye(2), (len(rows), 1, 1)), ()))
    return out


def test_the_lens_is_found_within_its_covariance():
    square = []
    for seed in range(12):
        fit = calibrate_lens(observations_from_board_views(views(seed), BOARD), TRUE.width, TRUE.height, 5)
        assert fit.rms == pytest.approx(0.05, rel=0.1) and fit.inliers.mean() > 0.999
        found, true = (np.r_[c.matrix[0, 0], c.matrix[1, 1], c.matrix[:2, 2], c.distortion] for c in (fit.camera, TRUE))
        C = fit.adjustment.shared_covariance * fit.adjustment.cost / fit.adjustment.dof
        square.append((found - true) @ np.linalg.solve(C, found - true))
    assert np.mean(square) == pytest.approx(9, rel=4 * np.sqrt(2 / (9 * 12)))


@pytest.mark.slow
def test_the_simplest_model_that_serves_is_taken():
    o = observations_from_board_views(views(3), BOARD)
    inliers = np.ones(len(o), bool)
    held = [cross_validate_lens(o, TRUE.width, TRUE.height, terms, inliers) for terms in (0, 4, 5)]
    assert held[0].rms > 5 * held[1].rms and choose_simplest_adequate_lens_model(held).terms in (4, 5)
    assert held[1].rms == pytest.approx(0.05, rel=0.1) and held[1].corners == len(o) and len(held[1].by_image) == 12
    straight = observations_from_board_views(views(3, camera=replace(TRUE, distortion=np.zeros(5))), BOARD)
    assert (
        choose_simplest_adequate_lens_model(
            [
                cross_validate_lens(straight, TRUE.width, TRUE.height, terms, inliers[: len(straight)])
                for terms in (0, 4)
            ]
        ).terms
        == 0
    )


def test_outliers_are_set_aside():
    seen = views(4)
    uv = seen[0].uv.copy()
    uv[3] += [4.0, -3.0]
    seen[0] = BoardView(seen[0].corner, uv, seen[0].covariance, ())
    o = observations_from_board_views(seen, BOARD)
    fit = calibrate_lens(o, TRUE.width, TRUE.height, 5)
    assert not fit.inliers[3] and fit.inliers.sum() >= len(o) - 2 and fit.rms < 0.06


def test_uncertainty_of_projection_holds_and_grows_where_nothing_was_seen():
    fits = [
        calibrate_lens(observations_from_board_views(views(seed, 6), BOARD), TRUE.width, TRUE.height, 5)
        for seed in range(30)
    ]
    sigmas = np.array([projection_pixels_and_uncertainty(fit, 128)[1] for fit in fits])
    assert (sigmas[:, 4, 5] < sigmas[:, 0, 0]).all()
    errors = []
    for fit in fits:  # the error of projection less the small turn that undoes most of it
        uv, _ = projection_pixels_and_uncertainty(fit, 128)
        ideal = lens.undistort(uv, TRUE.matrix, TRUE.distortion)
        points = np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=-1)
        shift = lens.project(points, fit.camera.matrix, fit.camera.distortion) - uv
        _, J, _ = lens.projected_pixels_and_jacobians(points, TRUE.matrix, TRUE.distortion)
        turn = np.stack([(J @ np.cross(axis, points)[..., None])[..., 0] for axis in np.eye(3)], axis=-1)
        x = np.linalg.lstsq(turn.reshape(-1, 3), shift.ravel(), rcond=None)[0]
        errors.append(((shift - turn @ x) ** 2).mean(axis=-1))
    ratio = np.mean(errors / sigmas**2, axis=0)
    assert 0.6 < np.median(ratio) < 1.6


def test_too_few_photographs_are_refused():
    with pytest.raises(NotEnoughData, match="2 photographs"):
        observations_from_board_views(views(0, 2), BOARD)
