"""Lenses and places: chessboard corners beside OpenCV's, the adjustment beside SciPy's, the tumbling block, the sheet
of 250.
"""

import contextlib
import io
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform

from rig.formats.rig_toml import design_from_rig_toml
from rig.model.calibration_board_layout_and_description_parsing import parse_board
from rig.model.design import Camera
from rig.model.pose import exp
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from tests.conftest import SHARED
from tests.vision.drawn_observations import scene
from vision.bundle.adjustment_cross_validation_and_determined_unknowns import crossvalidate_adjustment
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    estimate_after_step,
    estimate_offset_from_stated,
)
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import adjustment_unknowns_and_start_estimate
from vision.bundle.bundle_adjustment import adjust_bundle
from vision.bundle.marker_and_target_displacements import compare_stated_and_adjusted_places
from vision.corner_observations_and_merging import observations_from_corners, whitener_of_observations
from vision.corners.marker_detection_and_corner_fit import detect_markers
from vision.lenses import calibration_board_corner_detection_in_photograph as boards
from vision.lenses.lens_calibration_from_board_views import (
    calibrate_lens,
    cross_validate_lens,
    observations_from_board_views,
)
from vision.marker_corner_prediction import MarkerMap, State, marker_map, predict_corners
from vision.recording_adjustment_with_hand_and_stages import measure_observations

BOARD = "charuco:5x7:0.036195:0.018256:DICT_6X6_250"
FEW = 3  # frames that SciPy, with differences for derivatives, is asked to adjust
EVERYTHING = ("poses", "lenses", "markers", "targets")


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    yield from _chessboard()
    yield from _sheet()
    yield from _adjustment()
    yield from _block()


def _chessboard():
    board = parse_board(BOARD)
    theirs = cv2.aruco.CharucoDetector(
        cv2.aruco.CharucoBoard(
            (board.columns, board.rows),
            board.pitch,
            board.side,
            cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary)),
        )
    )
    images = [
        cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted((SHARED / "photos" / "charuco").glob("*.png"))
    ]
    height, width = images[0].shape
    K = [[1.2 * width, 0, width / 2], [0, 1.2 * width, height / 2], [0, 0, 1]]
    camera = Camera("cam0", width, height, K, np.zeros(5), RigidTransform.identity())
    ours, opencv, found, total = [], [], 0, 0
    for image in images:
        view = boards.find_board_corners(image, board, camera)
        corners, ids, _, _ = theirs.detectBoard(image)
        ids, corners = ids.ravel(), corners.reshape(-1, 2).astype(float)
        both = np.intersect1d(ids, view.corner)
        found, total = found + len(view.corner), total + len(ids)
        even = np.tile(0.01 * np.eye(2), (len(both), 1, 1))  # all corners weigh alike, theirs as ours
        ours.append(boards.BoardView(both, view.uv[np.searchsorted(view.corner, both)], even, ()))
        opencv.append(boards.BoardView(both, np.array([corners[ids == k][0] for k in both]).reshape(-1, 2), even, ()))
    yield f"photos/charuco, {len(images)} photographs: corners found, ours / OpenCV's", f"{found} / {total}", ""
    seen = [observations_from_board_views(views, board) for views in (ours, opencv)]
    for terms in (4, 5):
        fits = [calibrate_lens(o, width, height, terms) for o in seen]
        for name, inliers in (
            ("inliers of both", fits[0].inliers & fits[1].inliers),
            ("every common corner", np.ones(len(seen[0]), bool)),
        ):
            held = [cross_validate_lens(o, width, height, terms, inliers).rms for o in seen]
            yield (
                f"photos/charuco: held out, {terms} terms, {inliers.sum()} corners ({name}), ours / OpenCV's ChArUco",
                f"{held[0]:.4f} / {held[1]:.4f} px = {held[0] / held[1]:.3f}",
                "< 1",
            )


def _sheet():
    image = cv2.imread(str(SHARED / "photos" / "aruco-250.jpg"), cv2.IMREAD_UNCHANGED)
    height, width = image.shape[:2]
    markers = MarkerMap(
        np.arange(250),
        np.zeros(250, bool),
        RigidTransform.from_matrix(np.tile(np.eye(4), (250, 1, 1))),
        np.full(250, 0.02),
        np.full(250, 0.003),
        ["DICT_6X6_250"] * 250,
        ["sheet"] * 250,
        np.zeros(250, int),
    )
    camera = Camera(
        "cam0",
        width,
        height,
        [[1.2 * width, 0, width / 2], [0, 1.2 * width, height / 2], [0, 0, 1]],
        np.zeros(5),
        RigidTransform.identity(),
    )
    found = detect_markers(image, camera, markers)
    place = np.stack([found.marker // 20, -(found.marker % 20)], axis=1).astype(
        float
    )  # columns of twenty, from the lowest up
    middle = found.corners.mean(axis=1)
    H, _ = cv2.findHomography(place, middle, cv2.RANSAC, 20.0)
    off = np.linalg.norm(cv2.perspectiveTransform(place[:, None], H)[:, 0] - middle, axis=1)
    pitch = np.linalg.norm(found.corners[:, 1] - found.corners[:, 0], axis=1).mean()
    right = off < pitch / 4
    yield (
        "photos/aruco-250.jpg: markers found and where the sheet has them, false ones",
        f"{len(set(found.marker[right].tolist()))} of 250, {(~right).sum()} false",
        "250 of 250, none false",
    )


def _adjustment():
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(
            hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(
                0.3, cameras=3, width=1280, height=1024, cubes=4
            )
        )
        design = design_from_rig_toml.load_design(path)
    observations, stated, _, T = scene(design, 1, frames=380)
    observations = replace(
        observations, covariance=np.tile(0.04**2 * np.eye(2), (len(observations), 1, 1))
    )  # the noise that it was drawn with
    start = State(
        stated.cameras, T * exp(1e-3 * np.random.default_rng(0).normal(size=(len(T), 6))), {}, marker_map(design)
    )
    spent, busy = [], []
    for _ in range(3):
        begun, worked = time.perf_counter(), time.process_time()
        result = adjust_bundle(observations, start, EVERYTHING)
        spent.append(time.perf_counter() - begun)
        busy.append(time.process_time() - worked)
    yield (
        f"adjustment of everything, 380 frames x 3 cameras, {len(observations)} corners, "
        f"{result.unknowns.shared} shared unknowns, median of 3",
        f"{np.median(spent):.2f} s ({np.median(busy):.2f} s of processor)",
        "<= 4 s",
    )
    held = crossvalidate_adjustment(observations, result)
    yield (
        "held-out stretches: residuals over the covariance predicted for them",
        f"{held.ratio:.3f} +- {2 * held.scatter:.3f}",
        "1",
    )
    few = observations.take(observations.frame < FEW)
    few, start = replace(few, frames=few.frames[:FEW]), start.at(np.arange(FEW))
    mine = adjust_bundle(few, start, EVERYTHING)
    yield (
        f"the same problem, {FEW} frames: cost at the start, and where the adjustment ends",
        f"{_cost(few, start):.6g}; {mine.cost:.9g}",
        "",
    )
    theirs = _scipys(few, start, start)
    yield (
        f"the same problem, {FEW} frames: cost that SciPy's least_squares reaches from the same start, "
        "relative difference",
        f"{theirs:.9g}; {abs(mine.cost / theirs - 1):.1e}",
        "<= 1e-6",
    )
    onward = _scipys(few, mine.state, start)
    yield (
        f"the same problem, {FEW} frames: SciPy's from our optimum on, relative difference",
        f"{onward:.9g}; {abs(mine.cost / onward - 1):.1e}",
        "<= 1e-6",
    )


def _cost(observations, state):
    W = whitener_of_observations(observations)
    return float((W(observations.uv - predict_corners(observations, state)[0]) ** 2).sum())


def _scipys(observations, begin, stated):
    """Cost at which SciPy's trust region, its Jacobian by differences, ends. begin : State to start from;
    stated : State as stated.
    """
    u, estimate = adjustment_unknowns_and_start_estimate(observations, begin, stated, EVERYTHING)
    W, k, frames = whitener_of_observations(observations), u.basis.shape[1], len(observations.frames)

    def residual(p):
        moved = estimate_after_step(estimate, u, u.basis @ p[:k], p[k:].reshape(frames, u.local))
        seen = W(observations.uv - predict_corners(observations, moved.state)[0]).ravel()
        return np.r_[seen, (u.prior * estimate_offset_from_stated(moved, stated, u))[u.prior > 0]]

    return (
        2
        * least_squares(
            residual, np.zeros(k + frames * u.local), method="trf", x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12
        ).cost
    )


def _block():
    from rig.cli.command_line import main

    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        begun = time.perf_counter()
        main(["measure", str(SHARED / "recordings" / "tumbling-block"), "--out", folder])
        seconds = time.perf_counter() - begun
    block = recording_folder.load_recording(SHARED / "recordings" / "tumbling-block")
    frames, t = block.exposures.times()
    markers = marker_map(block.design)
    observed = observations_from_corners(block.corners, frames, block.design, markers)
    plain, free = (
        measure_observations(observed, block.design, markers, groups, t=t)
        for groups in (("lenses",), ("lenses", "markers"))
    )
    found, held = compare_stated_and_adjusted_places(free, t), crossvalidate_adjustment(free.used(), free.adjustment)
    yield (
        "tumbling-block: frames solved, places as stated / as adjusted",
        f"{len(plain.frames)} / {len(free.frames)} of {len(frames)}",
        "",
    )
    yield (
        "tumbling-block: residual of the block per frame, median RMS, places as stated / as adjusted",
        f"{np.median(found.before):.3f} / {np.median(found.after):.3f} px",
        "reported",
    )
    yield (
        "tumbling-block: squares over degrees of freedom, by each frame's scatter, stated / adjusted",
        f"{found.weighted[0]:.2f} / {found.weighted[1]:.2f}",
        "",
    )
    yield (
        "tumbling-block: held-out stretches, residuals over predicted",
        f"{held.ratio:.3f} +- {2 * held.scatter:.3f}",
        "1",
    )
    largest = max(found.moves, key=lambda one: np.linalg.norm(one.by[:3]))
    by = np.linalg.norm(largest.by[:3]) * 1e3
    yield (
        f"tumbling-block: tags that moved; farthest {largest.place}",
        f"{sum(m.moved for m in found.moves)} of {len(found.moves)}; {by:.2f} mm",
        "",
    )
    yield "tumbling-block: frames flipped", f"{len(found.odd)}", "0"
    yield "tumbling-block: rig measure, start included", f"{seconds:.0f} s", ""
