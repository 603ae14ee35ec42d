"""Boards: their descriptions, and chessboard corners placed in drawn images, with covariances held to the scatter."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline
from scipy.spatial.transform import RigidTransform
from scipy.stats import multivariate_normal

from rig.errors import RigError
from rig.model.calibration_board_layout_and_description_parsing import parse_board
from rig.model.design import Camera
from rig.model.pose import pose, transform_points
from tests.numerical_derivatives import jacobian
from vision import opencv_lens_model as lens
from vision.lenses import calibration_board_corner_detection_in_photograph
from vision.lenses.calibration_board_corner_detection_in_photograph import find_board_corners

TEXT = "charuco:5x7:0.036:0.018:DICT_6X6_250"
PINHOLE = Camera("cam", 420, 460, [[500, 0, 210], [0, 500, 230], [0, 0, 1]], np.zeros(5), RigidTransform.identity())
BENT = Camera(
    "cam", 420, 460, [[500, 0, 210], [0, 500, 230], [0, 0, 1]], [-0.35, 0.15, 0, 0, 0], RigidTransform.identity()
)


def draw(board, camera, T_camera_board, noise=1.5, blur=0.8, seed=0, finer=3):
    """A photograph of a board: every sample of every pixel looked up on the board, averaged, blurred, made noisy."""
    cells = 40
    sheet = cv2.aruco.CharucoBoard(
        (board.columns, board.rows),
        board.pitch,
        board.side,
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary)),
    )
    flat = sheet.generateImage((board.columns * cells * 8, board.rows * cells * 8), marginSize=0)
    scale = cells * 8 / board.pitch
    step = (np.arange(finer) + 0.5) / finer - 0.5
    u = (np.arange(camera.width)[:, None] + step).ravel()
    v = (np.arange(camera.height)[:, None] + step).ravel()
    coarse = np.arange(-4, camera.width + 8, 4.0), np.arange(-4, camera.height + 8, 4.0)
    ideal = lens.undistort(np.stack(np.meshgrid(*coarse), axis=-1), camera.matrix, camera.distortion)
    ideal = np.stack([RectBivariateSpline(*coarse[::-1], ideal[..., c])(v, u) for c in range(2)], axis=-1)
    rays = np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=-1)
    M = T_camera_board.as_matrix()
    H = np.stack([M[:3, 0], M[:3, 1], M[:3, 3]], axis=1)
    on = rays @ np.linalg.inv(H).T
    on = on[..., :2] / on[..., 2:]
    x, y = np.floor(on * scale).astype(int).transpose(2, 0, 1)
    inside = (x >= 0) & (y >= 0) & (x < flat.shape[1]) & (y < flat.shape[0])
    bright = (
        np.where(inside, flat[np.clip(y, 0, flat.shape[0] - 1), np.clip(x, 0, flat.shape[1] - 1)] > 127, True) * 180.0
        + 30
    )
    image = (
        cv2.GaussianBlur(bright, (0, 0), blur * finer)
        .reshape(camera.height, finer, camera.width, finer)
        .mean(axis=(1, 3))
    )
    image += noise * np.random.default_rng(seed).normal(size=image.shape)
    uv = lens.project(transform_points(T_camera_board, board.points), camera.matrix, camera.distortion)
    return np.clip(np.round(image), 0, 255).astype(np.uint8), uv


@pytest.mark.parametrize("camera", [PINHOLE, BENT], ids=["pinhole", "bent"])
@pytest.mark.parametrize("turn", [[0.2, 0.1, 0.1], [0.5, -0.3, 0.2]])
def test_corners_lie_where_they_are_within_their_covariance(camera, turn):
    board = parse_board(TEXT)
    image, true = draw(board, camera, pose([-0.085, -0.12, 0.38], turn))
    view = find_board_corners(image, board, camera)
    assert len(view.corner) >= 20 and not set(view.corner) & {row for row, _ in view.left_out}
    errors = view.uv - true[view.corner]
    assert np.sqrt((errors**2).mean()) < 0.02
    square = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(view.covariance), errors)
    assert 0.5 < square.mean() / 2 < 2.5


def test_a_lens_that_is_not_taken_out_bends_the_corners():
    board = parse_board(TEXT)
    image, true = draw(board, BENT, pose([-0.085, -0.12, 0.38], [0.2, 0.1, 0.1]))
    rms = [
        np.sqrt(((view.uv - true[view.corner]) ** 2).mean())
        for view in (find_board_corners(image, board, PINHOLE), find_board_corners(image, board, BENT))
    ]
    assert rms[1] < rms[0]


def test_share_is_the_bivariate_normals():
    rng, share = np.random.default_rng(0), calibration_board_corner_detection_in_photograph.edge_crossing_white_share
    h, k = rng.uniform(-3, 3, (2, 20))
    for rho in (-0.7, 0.0, 0.4):
        normal = multivariate_normal([0, 0], [[1, rho], [rho, 1]])
        value, dh, dk, dr = share(h, k, rho)
        expected = [normal.cdf([a, b]) + normal.cdf([-a, -b]) for a, b in zip(h, k)]
        np.testing.assert_allclose(value, expected, atol=1e-6)
        np.testing.assert_allclose(np.diagonal(jacobian(lambda x, r=rho: share(x, k, r)[0], h)), dh, atol=1e-6)
        np.testing.assert_allclose(np.diagonal(jacobian(lambda x, r=rho: share(h, x, r)[0], k)), dk, atol=1e-6)
        by_rho = jacobian(lambda r: share(h, k, r[0])[0], np.array([rho]))[:, 0]
        np.testing.assert_allclose(by_rho, dr, atol=1e-6)


def test_what_is_no_corner_gives_a_reason():
    board = parse_board(TEXT)
    image, true = draw(board, PINHOLE, pose([-0.085, -0.12, 0.38], [0.2, 0.1, 0.1]))
    u, v = true[8].astype(int)
    image[v - 6 : v + 40, u - 6 : u + 40] = 128
    view = find_board_corners(image, board, PINHOLE)
    assert 8 not in view.corner and dict(view.left_out)[8]
    empty = find_board_corners(np.full((460, 420), 128, np.uint8), board, PINHOLE)
    assert len(empty.corner) == 0 and empty.left_out == ()
    noise = np.random.default_rng(0).integers(0, 255, (460, 420)).astype(np.uint8)
    assert len(find_board_corners(noise, board, PINHOLE).corner) == 0


def test_a_grid_of_markers_is_read_too():
    board = parse_board("aruco:4x3:0.03:0.01:DICT_4X4_50")
    assert board.points.shape == (48, 3)
    grid = cv2.aruco.GridBoard((4, 3), 0.03, 0.01, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    np.testing.assert_allclose(np.array(grid.getObjPoints()), board.marker_corners(), atol=1e-8)
    image = cv2.copyMakeBorder(grid.generateImage((451, 331)), 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    camera = Camera("cam", 571, 451, [[800, 0, 300], [0, 800, 230], [0, 0, 1]], np.zeros(5), RigidTransform.identity())
    view = find_board_corners(cv2.GaussianBlur(image, (0, 0), 0.8), board, camera)
    assert len(view.corner) == 48
    H, _ = cv2.findHomography(board.points[view.corner, :2], view.uv)
    expected = cv2.perspectiveTransform(board.points[view.corner, None, :2], H)[:, 0]
    np.testing.assert_allclose(expected, view.uv, atol=0.6)  # OpenCV draws to whole pixels


def test_layout_is_opencvs():
    for legacy, text in ((False, "charuco:6x5:0.04:0.02:DICT_4X4_50"), (True, "charuco:5x6:0.04:0.02:DICT_4X4_50")):
        board = replace(parse_board(text), legacy=legacy)
        theirs = cv2.aruco.CharucoBoard(
            (board.columns, board.rows), 0.04, 0.02, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        )
        theirs.setLegacyPattern(legacy)
        np.testing.assert_allclose(theirs.getChessboardCorners(), board.points, atol=1e-7)
        np.testing.assert_allclose(np.array(theirs.getObjPoints()), board.marker_corners(), atol=1e-7)


@pytest.mark.parametrize(
    "text, what",
    [
        ("charucoo:5x7:0.036:0.018:DICT_6X6_250", "charucoo"),
        ("charuco:5x7:0.036:DICT_6X6_250", "4 parts"),
        ("charuco:5by7:0.036:0.018:DICT_6X6_250", "5by7"),
        ("charuco:5x7:36:18:DICT_6X6_250", "metres"),
        ("charuco:5x7:0.018:0.036:DICT_6X6_250", "does not fit"),
        ("charuco:5x7:a:0.018:DICT_6X6_250", "'a'"),
        ("charuco:5x7:0.036:0.018:DICT_6X6", "DICT_6X6"),
        ("charuco:2x2:0.036:0.018:DICT_6X6_250", "2x2"),
        ("charuco:0x7:0.036:0.018:DICT_6X6_250", "0x7"),
        ("charuco:20x20:0.036:0.018:DICT_4X4_50", "only 50"),
        ("charuco:5x7:nan:0.018:DICT_6X6_250", "nan"),
        ("", "no kind"),
    ],
)
def test_a_typo_in_the_board_is_named(text, what):
    with pytest.raises(RigError, match=what):
        parse_board(text)
