"""Calibration boards: their printed layout, and their corners in a photograph with covariance."""

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number, parse_whole_number
from rig.model.design import DICTIONARIES, Camera
from vision import lens
from vision.corners.marker_detection_and_corner_fit import detect_markers, grey_images_for_reader_and_fit
from vision.lenses import chessboard_corner
from vision.predict import SQUARE, MarkerMap

KINDS = {
    "charuco": "charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY (squares; m, m)",
    "aruco": "aruco:COLUMNSxROWS:SIDE:GAP:DICTIONARY (markers; m, m)",
}
NEIGHBOURS = 4  # markers next to a chessboard corner from which it is guessed
NEIGHBOUR_DISTANCE = 1.6  # squares, the farthest that they are
LARGEST = 5.0  # m


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """kind "charuco" or "aruco"; columns, rows : squares, or markers; pitch : m from one to the next; side : m, a
    marker's
    dictionary : OpenCV name; legacy : whether a charuco's first square holds a marker where its rows are even."""

    kind: str
    columns: int
    rows: int
    pitch: float
    side: float
    dictionary: str
    legacy: bool = False

    @property
    def points(self) -> Floats:
        """(n, 3) m, corners that are measured: x right, y down, z = 0; of a charuco its inner corners row by row, else
        markers' four.
        """
        if self.kind == "charuco":
            x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
            return np.stack([x.ravel() * self.pitch, y.ravel() * self.pitch, 0.0 * x.ravel()], axis=1)
        return self.marker_corners().reshape(-1, 3)

    def places(self) -> Floats:
        """(m, 2) m, middles of the markers in the order of their identities."""
        x, y = (grid.ravel() for grid in np.meshgrid(np.arange(self.columns), np.arange(self.rows)))
        if self.kind == "charuco":
            odd = (x + y + (self.rows % 2 == 0 if self.legacy else 0)) % 2 == 1
            return (np.stack([x[odd], y[odd]], axis=1) + 0.5) * self.pitch
        return cast(Floats, np.stack([x, y], axis=1) * self.pitch + self.side / 2)

    def marker_corners(self) -> Floats:
        """(m, 4, 3) m, corners of the markers, clockwise from the top left."""
        middles = np.pad(self.places(), ((0, 0), (0, 1)))
        return middles[:, None] + self.side * SQUARE * [1, -1, 1]


def parse_board(text: str) -> Board:
    """Parse a board's description text into a Board.
    Raises RigError saying what is wrong with which part.
    """
    parts = text.split(":")
    kind = parts[0]
    if kind not in KINDS:
        raise RigError(f"--board {text!r}: {kind!r} is no kind of board; there are {' and '.join(KINDS.values())}")
    if len(parts) != 5:
        raise RigError(f"--board {text!r} has {len(parts)} parts, not 5: {KINDS[kind]}")
    try:
        columns, rows = (parse_whole_number(part) for part in parts[1].lower().split("x"))
    except ValueError:
        raise RigError(f"--board {text!r}: {parts[1]!r} is not a size such as 5x7") from None
    if not (columns * rows >= 2 and 1 <= columns <= 100 and 1 <= rows <= 100) or (
        kind == "charuco" and min(columns, rows) < 3
    ):
        raise RigError(f"--board {text!r}: {columns}x{rows} is not a valid size of a {kind} board")
    lengths = []
    for name, part in zip(("square", "marker") if kind == "charuco" else ("side", "gap"), parts[2:4]):
        try:
            lengths.append(parse_number(part))
        except ValueError:
            raise RigError(f"--board {text!r}: {name} {part!r} is not a number (m)") from None
        if not 0 < lengths[-1] <= LARGEST:
            raise RigError(f"--board {text!r}: {name} = {part} m is implausible (lengths are in metres)")
    if parts[4] not in DICTIONARIES:
        raise RigError(f"--board {text!r}: {parts[4]!r} is no dictionary; there are {', '.join(DICTIONARIES)}")
    if kind == "charuco" and not lengths[1] < lengths[0]:
        raise RigError(
            f"--board {text!r}: a marker of {lengths[1]} m does not fit into a square of {lengths[0]} m; "
            "the square is stated first"
        )
    board = Board(
        kind,
        columns,
        rows,
        lengths[0] if kind == "charuco" else sum(lengths),
        lengths[1] if kind == "charuco" else lengths[0],
        parts[4],
    )
    if len(board.places()) > DICTIONARIES[board.dictionary]:
        raise RigError(
            f"--board {text!r} has {len(board.places())} markers, {board.dictionary} only "
            f"{DICTIONARIES[board.dictionary]}"
        )
    return board


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
    if board.kind == "aruco":
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
    clear = (board.pitch - board.side) / 2 / board.pitch
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
    gap = (board.pitch - board.side) / 2
    map_ = MarkerMap(
        np.arange(len(middles)),
        np.zeros(len(middles), bool),
        RigidTransform.from_translation(middles),
        np.full(len(middles), board.side),
        np.full(len(middles), gap),
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
