"""Lenses of two cameras from drawn photographs of a board, against the true ones: rig's, OpenCV's and multical's.

`MULTICAL=PATH python -m tests.bench peers` runs multical's command too, from an environment of its own (Python 3.10,
numpy < 1.24); without it multical is skipped.
"""

import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

from rig.model.calibration_board_layout_and_description_parsing import parse_board
from rig.model.design import Camera
from vision.lenses import calibration_board_corner_detection_in_photograph as boards
from vision.lenses.lens_calibration_from_board_views import calibrate_lens, observations_from_board_views

BOARD = "charuco:7x5:0.03:0.022:DICT_5X5_100"
MULTICALS = """common: {_type_: charuco, size: [7, 5], aruco_dict: 5X5_100, square_length: 0.03, marker_length: 0.022,
  min_rows: 3, min_points: 9}
boards: {board: {aruco_offset: 0}}
"""
WIDTH, HEIGHT, SHOTS, TERMS, SEED = 1280, 960, 20, 5, 11
PIXELS, FINER, BLUR, NOISE = 120, 3, 0.6, 1.5  # px of a drawn square, samples of a pixel's side, px, grey levels
TRUE = {
    "left": (np.array([[900.0, 0, 648.0], [0, 902.0, 471.0], [0, 0, 1]]), np.array([-0.11, 0.06, 4e-4, -3e-4, 0.0])),
    "right": (np.array([[880.0, 0, 630.0], [0, 881.0, 486.0], [0, 0, 1]]), np.array([-0.09, 0.04, -5e-4, 2e-4, 0.0])),
}
T_LEFT_RIGHT = RigidTransform.from_components([0.12, 0.0, 0.01], Rotation.from_rotvec([0.0, -0.3, 0.02]))
PATIENCE = 600  # s that multical may take
EXACTLY = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)  # how long rays are sought


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _photograph(folder)
        what = f"2 cameras, {SHOTS} photographs each, {TERMS} terms"
        found = {"rig": _ours(folder), "OpenCV": _opencvs(folder)}
        yield f"{what}: corners found, rig / OpenCV", " / ".join(str(found[k][1]) for k in ("rig", "OpenCV")), ""
        lenses = {name: lens for name, (lens, _) in found.items()}
        command = os.environ.get("MULTICAL")
        apart = "skipped: MULTICAL names no command"
        if command:
            lenses["multical"], apart = _multicals(folder, command)
    for name, lens in lenses.items():
        off = {camera: lens[camera][0] - K for camera, (K, _) in TRUE.items()}
        errors = [projection_error(*lens[camera], *TRUE[camera]) for camera in TRUE]
        yield f"{what}: projection off the truth, RMS over the image, {name}", _both(errors), ""
        yield f"{what}: focal length off the truth, {name}", _both([K[0, 0] for K in off.values()]), ""
        centre = [float(np.hypot(K[0, 2], K[1, 2])) for K in off.values()]
        yield f"{what}: principal point off the truth, {name}", _both(centre), ""
    yield f"{what}: right camera's pose off the truth, multical (rig lens estimates none)", apart, ""
    yield "multical ran with", _packages(command) if command else "skipped", ""


def _both(values):
    return ", ".join(f"{value:.3f}" for value in values) + " px"


def _packages(command):
    """The packages of multical's environment and their versions."""
    names = ("multical", "opencv-contrib-python", "numpy")
    says = f"from importlib.metadata import version; print(*(f'{{n}} {{version(n)}}' for n in {names}), sep=', ')"
    python = Path(command).with_name("python")
    return subprocess.run([python, "-c", says], check=True, capture_output=True, text=True).stdout.strip()


def _photograph(folder):
    """Write folder/CAMERA/NN.png."""
    board = parse_board(BOARD)
    drawn = _board().generateImage((board.columns * PIXELS, board.rows * PIXELS), marginSize=0)
    u, v = (np.indices((HEIGHT * FINER, WIDTH * FINER))[::-1] + 0.5) / FINER - 0.5
    grid = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    rays = {
        name: cv2.undistortPoints(grid, K, terms, criteria=EXACTLY).reshape(HEIGHT * FINER, WIDTH * FINER, 2)
        for name, (K, terms) in TRUE.items()
    }
    rng = np.random.default_rng(SEED)
    for name in TRUE:
        (folder / name).mkdir()
    for shot in range(SHOTS):
        middle = [rng.uniform(-0.01, 0.09), rng.uniform(-0.05, 0.05), rng.uniform(0.22, 0.36)]
        turn = Rotation.from_rotvec(np.array([0, -0.15, 0]) + rng.uniform(-0.5, 0.5, 3))
        centre = [board.columns * board.pitch / 2, board.rows * board.pitch / 2, 0]
        T_left_board = RigidTransform.from_components(middle - turn.apply(centre), turn)
        for name, T_board in (("left", T_left_board), ("right", T_LEFT_RIGHT.inv() * T_left_board)):
            R, t = T_board.rotation.as_matrix(), T_board.translation
            H = np.linalg.inv(np.column_stack([R[:, :2], t]))  # rays to the board's plane
            at = cv2.perspectiveTransform(rays[name], H) / board.pitch * PIXELS - 0.5
            fine = cv2.remap(drawn, at.astype(np.float32), None, cv2.INTER_LINEAR, borderValue=200)
            image = cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
            image = cv2.GaussianBlur(image, (0, 0), BLUR) + rng.normal(0, NOISE, (HEIGHT, WIDTH))
            cv2.imwrite(str(folder / name / f"{shot:02d}.png"), np.clip(np.round(image), 0, 255).astype(np.uint8))


def _board():
    board = parse_board(BOARD)
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    return cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch, board.side, words)


def _images(folder, name):
    return [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted((folder / name).glob("*.png"))]


def _ours(folder):
    """({camera: (K, terms)}, corners found)."""
    board, found, corners = parse_board(BOARD), {}, 0
    K = [[1.2 * WIDTH, 0, WIDTH / 2], [0, 1.2 * WIDTH, HEIGHT / 2], [0, 0, 1]]
    for name in TRUE:
        camera = Camera(name, WIDTH, HEIGHT, K, np.zeros(5), RigidTransform.identity())
        views = [boards.find_board_corners(image, board, camera) for image in _images(folder, name)]
        lens = calibrate_lens(observations_from_board_views(views, board), WIDTH, HEIGHT, TERMS).camera
        found[name], corners = (lens.matrix, lens.distortion), corners + sum(len(view.corner) for view in views)
    return found, corners


def _opencvs(folder):
    """The same by CharucoDetector and calibrateCamera."""
    detector, found, corners = cv2.aruco.CharucoDetector(_board()), {}, 0
    for name in TRUE:
        points, pixels = [], []
        for image in _images(folder, name):
            uv, ids, _, _ = detector.detectBoard(image)
            if ids is not None and len(ids) >= 6:
                points.append(_board().getChessboardCorners()[ids.ravel()])
                pixels.append(uv.reshape(-1, 1, 2))
        _, K, terms, _, _ = cv2.calibrateCamera(points, pixels, (WIDTH, HEIGHT), None, None)
        found[name], corners = (K, terms.ravel()), corners + sum(map(len, points))
    return found, corners


def _multicals(folder, command):
    """({camera: (K, terms)}, how far the right camera is off), by multical's command. Raises CalledProcessError where
    it ends with an error.
    """
    (folder / "boards.yaml").write_text(MULTICALS)
    words = [command, "calibrate", "--image_path", folder, "--boards", folder / "boards.yaml", "--cameras", *TRUE]
    subprocess.run([str(word) for word in words], check=True, capture_output=True, timeout=PATIENCE)
    made = json.loads((folder / "calibration.json").read_text())
    found = {name: (np.array(one["K"]), np.ravel(one["dist"])) for name, one in made["cameras"].items()}
    pose = made["camera_poses"]["right_to_left"]
    T_right_left = RigidTransform.from_components(pose["T"], Rotation.from_matrix(pose["R"]))
    off = T_right_left * T_LEFT_RIGHT
    away = np.linalg.norm(T_right_left.inv().translation - T_LEFT_RIGHT.translation)
    return found, f"{1e3 * away:.3f} mm, {1e3 * off.rotation.magnitude():.3f} mrad"


def projection_error(K, terms, true_K, true_terms):
    """RMS (px) by which a lens projects the rays of the true one elsewhere, over the image, the camera turned so as to
    match best: photographs of a board alone do not tell how it is turned.
    """
    u, v = np.meshgrid(np.arange(0, WIDTH, 40.0), np.arange(0, HEIGHT, 40.0))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = cv2.convertPointsToHomogeneous(cv2.undistortPoints(uv[:, None], true_K, true_terms, criteria=EXACTLY))

    def off(turn):
        return (cv2.projectPoints(rays, turn, np.zeros(3), K, terms)[0][:, 0] - uv).ravel()

    return float(np.sqrt((least_squares(off, np.zeros(3)).fun ** 2).sum() / len(uv)))
