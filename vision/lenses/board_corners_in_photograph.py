"""Corners of a calibration board in a photograph, with covariance."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.model.calibration_board import Board
from rig.model.design import Camera
from vision import lens
from vision.corners.marker_detection_and_corner_fit import detect_markers, grey_images_for_reader_and_fit
from vision.lenses import chessboard_corner
from vision.predict import MarkerMap

NEIGHBOURS = 4  # markers next to a chessboard corner from which it is guessed
NEIGHBOUR_DISTANCE = 1.6  # squares, the farthest that they are


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Corners of a board in one photograph. corner : (n,) rows of Board.points; uv : (n, 2) px; covariance : (n, 2, 2)
    px^2
    left_out : (corner, reason) of those expected and not placed."""

    corner: Integers
    uv: Floats
    covariance: Floats
    left_out: tuple[tuple[int, str], ...]


def find_board_corners(image: Pixels, board: Board, camera: Camera) -> BoardView:
    """Find the corners of a board in an image as cv2 reads it, as a BoardView.
    camera : Camera whose lens bends the edges (no distortion for the first look)
    """
    if board.kind != "charuco":
        return _markers(image, board, camera)
    eight, full = grey_images_for_reader_and_fit(image)
    found, ids, _ = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    ).detectMarkers(eight)
    ids = np.zeros(0, int) if ids is None else ids.ravel()
    keep = [i for i, number in enumerate(ids) if number < len(board.places()) and (ids == number).sum() == 1]
    if not keep:
        return BoardView(np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 2, 2)), ())
    quads = np.array([found[i].reshape(4, 2) for i in keep], float)
    numbers = ids[keep]
    corners, middles = board.marker_corners()[numbers, :, :2], board.places()[numbers]
    straight = _straight(camera)
    clear = board.margin / board.pitch
    rows, out, left_out = [], [], []
    for row, point in enumerate(board.points[:, :2]):
        distance = np.linalg.norm(middles - point, axis=1) / board.pitch
        near = [i for i in np.argsort(distance)[:NEIGHBOURS] if distance[i] < NEIGHBOUR_DISTANCE]
        if not near:
            continue
        H, _ = cv2.findHomography((corners[near].reshape(-1, 2) - point) / board.pitch, quads[near].reshape(-1, 2))
        if H is None:
            continue
        guess, slope = H[:2, 2] / H[2, 2], (H[:2, :2] - np.outer(H[:2, 2] / H[2, 2], H[2, :2])) / H[2, 2]
        column, line = np.round(point / board.pitch).astype(int)
        white = (column + line + (board.rows % 2 == 0 if board.legacy else 0)) % 2 == 1
        fitted = chessboard_corner.fit_chessboard_corner(full, guess, slope, white, straight, clear)
        if isinstance(fitted, str):
            left_out.append((row, fitted))
        else:
            rows.append(row)
            out.append(fitted)
    return BoardView(
        np.array(rows, int),
        np.array([one.uv for one in out]).reshape(-1, 2),
        np.array([one.covariance for one in out]).reshape(-1, 2, 2),
        tuple(left_out),
    )


def _markers(image: Pixels, board: Board, camera: Camera) -> BoardView:
    middles = np.pad(board.places() * [1, -1], ((0, 0), (0, 1)))
    map_ = MarkerMap(
        np.arange(len(middles)),
        np.zeros(len(middles), bool),
        RigidTransform.from_translation(middles),
        np.full(len(middles), board.side),
        np.full(len(middles), board.margin),
        [board.dictionary] * len(middles),
        ["board"] * len(middles),
        np.zeros(len(middles), int),
    )
    found = detect_markers(image, camera, map_)
    rows = (found.marker[:, None] * 4 + np.arange(4)).ravel()
    covariance = (
        np.array([found.covariance[:, 2 * c : 2 * c + 2, 2 * c : 2 * c + 2] for c in range(4)])
        .reshape(4, -1, 2, 2)
        .swapaxes(0, 1)
    )
    return BoardView(
        rows,
        found.corners.reshape(-1, 2),
        covariance.reshape(-1, 2, 2),
        tuple((4 * one.marker, one.reason) for one in found.left_out),
    )


def _straight(camera: Camera) -> chessboard_corner.Straight:
    """Pixels to coordinates without the lens's distortion, px, and one of these back with its Jacobian."""
    K, D = camera.matrix, camera.distortion
    focal, centre = np.diag(K)[:2], K[:2, 2]
    if not np.any(D):
        return chessboard_corner.Straight(lambda uv: uv, lambda xy: (xy, np.eye(2)))

    def back(xy: Floats) -> tuple[Floats, Floats]:
        uv, J, _ = lens.project_jacobian(np.append((xy - centre) / focal, 1.0), K, D)
        return uv, J[:, :2] / focal

    return chessboard_corner.Straight(lambda uv: lens.undistort(uv, K, D) * focal + centre, back)
