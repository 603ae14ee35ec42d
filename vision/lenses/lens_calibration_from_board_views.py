"""Lens calibration from views of a board."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats
from rig.errors import NotEnoughData
from rig.model.calibration_board_layout_and_description_parsing import Board
from rig.model.design import Camera
from vision import opencv_lens_model as lens
from vision.bundle.bundle_adjustment import Adjustment, adjust_bundle
from vision.corner_observations_and_merging import Observations, observations_of_frames
from vision.lenses.calibration_board_corner_detection_in_photograph import BoardView
from vision.marker_corner_prediction import State, predict_corners
from vision.pose.pose_refinement_and_choice_by_neighbour_frames import GATE, MEDIAN

MODELS = (0, 4, 5, 8, 12, 14)  # distortion terms, OpenCV's order; 0: a pinhole
ROUNDS = 6
LEAST_CORNERS = 6  # in a photograph that counts
LEAST_IMAGES = 3
WIDE = {
    "k1": 1.0,
    "k2": 2.0,
    "p1": 0.05,
    "p2": 0.05,
    "k3": 5.0,
    "k4": 0.5,
    "k5": 0.5,
    "k6": 0.5,
    "s1": 0.02,
    "s2": 0.02,
    "s3": 0.02,
    "s4": 0.02,
    "tau_x": 0.03,
    "tau_y": 0.03,
}  # nothing is stated: these only keep a term finite
UNMODELLED = 0.1  # px, a first guess of what board, print and lens add to every corner beyond its own covariance
PINNED = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """One lens model fitted. terms : distortion terms adjusted; camera : Camera; residuals : (n, 2) px, of all corners
    inliers : (n,) bool; rms : px per axis, of the inliers it was fitted to; adjustment : Adjustment."""

    terms: int
    camera: Camera
    residuals: Floats
    inliers: Booleans
    rms: float
    adjustment: Adjustment


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A model on photographs held out in turn. terms; rms : px per axis, over all; by_image : px per axis;
    corners : how many.
    """

    terms: int
    rms: float
    by_image: tuple[float, ...]
    corners: int


def observations_from_board_views(views: Sequence[BoardView], board: Board) -> Observations:
    """Observations from BoardViews, one frame each.

    Corners count four to a `marker`.
    Raises NotEnoughData where too few are usable.
    """
    usable = [(f, view) for f, view in enumerate(views) if len(view.corner) >= LEAST_CORNERS]
    if len(usable) < LEAST_IMAGES:
        raise NotEnoughData(
            f"{len(usable)} photographs show {LEAST_CORNERS} corners of the board or more; a lens requires at "
            f"least {LEAST_IMAGES}"
        )
    corner = np.concatenate([view.corner for _, view in usable])
    covariance = np.concatenate([view.covariance for _, view in usable])
    frames = np.array([f for f, _ in usable])
    frame = np.repeat(np.arange(len(usable)), [len(view.corner) for _, view in usable])
    order = np.lexsort((corner, frame))
    return Observations(
        frames,
        frame[order],
        np.zeros(len(corner), int),
        corner[order] // 4,
        corner[order] % 4,
        np.concatenate([view.uv for _, view in usable])[order],
        covariance[order],
        board.points[corner[order]],
        np.zeros(len(corner), bool),
        True,
    )


def calibrate_lens(
    observations: Observations, width: int, height: int, terms: int, name: str = "cam0", inliers: Booleans | None = None
) -> Fit:
    """Calibrated lens (Fit) with that many distortion terms.
    inliers : (n,) bool to hold to, or None: found here

    Raises NotEnoughData where corners do not determine it.
    """
    o = observations
    start = _start(o, width, height, max(terms, 4), name)
    stated, state, good = start, start, np.ones(len(o), bool) if inliers is None else inliers
    unmodelled = UNMODELLED**2
    for k in range(ROUNDS):
        weighed = replace(o, covariance=o.covariance + unmodelled * np.eye(2))
        result = adjust_bundle(
            weighed.take(good),
            state,
            ("lenses",),
            stated=stated,
            lens_prior_sigmas=lambda camera: _lens_prior_sigmas(camera, terms),
        )
        state = result.state
        residuals = o.uv - predict_corners(o, state)[0]
        square = (residuals**2).sum(axis=1)
        before, unmodelled = unmodelled, max((square[good] - np.einsum("nii->n", o.covariance)[good]).mean() / 2, 0.0)
        near = square < GATE**2 * np.median(square) / MEDIAN if inliers is None else good
        if k and (near == good).all() and abs(unmodelled - before) <= 0.05 * before:
            break
        good = near
    return Fit(terms, state.cameras[0], residuals, good, float(np.sqrt((residuals[good] ** 2).mean())), result)


def cross_validate_lens(observations: Observations, width: int, height: int, terms: int, inliers: Booleans) -> HeldOut:
    """Cross-validation of a lens model (HeldOut).

    Each photograph predicted by a lens from the others.

    The photograph's own pose alone is fitted to it. inliers : (n,) bool
    """
    o, by_image, total, count = observations, [], 0.0, 0
    for f in range(len(o.frames)):
        own = o.frame == f
        rest = np.delete(np.arange(len(o.frames)), f)
        fitted = calibrate_lens(observations_of_frames(o, rest), width, height, terms, inliers=inliers[~own])
        alone = observations_of_frames(o, np.array([f])).take(inliers[own])
        start = _start(alone, width, height, max(terms, 4), "held out", fitted.camera)
        state = adjust_bundle(alone, start, ()).state
        square = (alone.uv - predict_corners(alone, state)[0]) ** 2
        by_image.append(float(np.sqrt(square.mean())))
        total, count = total + square.sum(), count + len(alone)
    return HeldOut(terms, float(np.sqrt(total / (2 * count))), tuple(by_image), count)


def choose_simplest_adequate_lens_model(held_out_errors: Sequence[HeldOut]) -> HeldOut:
    """Choose the simplest adequate lens model.

    The simplest whose held-out error is within one standard error of the best.
    held_out_errors : one per model, simplest first
    """
    best = min(held_out_errors, key=lambda one: one.rms)
    for one in held_out_errors:
        worse = np.square(one.by_image) - np.square(best.by_image)
        if worse.mean() <= worse.std(ddof=1) / np.sqrt(len(worse)):
            return one
    return best


def projection_pixels_and_uncertainty(fit: Fit, step: int = 40) -> tuple[Floats, Floats]:
    """Pixels over the image, and the standard uncertainty of the lens's projection there.

    The part that a small turn of the camera would undo is taken out, for a camera's pose is always found with its lens.

    Returns uv (r, c, 2) px, sigma (r, c) px
    Source: mrcal, projection uncertainty
    """
    camera = fit.camera
    u, v = (np.linspace(0, size - 1, max(size // step, 2) + 1) for size in (camera.width, camera.height))
    u, v = np.meshgrid(u, v)
    uv = np.stack([u, v], axis=-1)
    ideal = lens.undistort(uv, camera.matrix, camera.distortion)
    points = np.concatenate([np.nan_to_num(ideal), np.ones((*u.shape, 1))], axis=-1)
    _, J_point, J_lens = lens.projected_pixels_and_jacobians(points, camera.matrix, camera.distortion)
    inside = np.isfinite(ideal[..., 0])
    J_turn = J_point @ _cross(points)
    A, B = J_turn[inside].reshape(-1, 3), J_lens[inside].reshape(-1, J_lens.shape[-1])
    J = J_lens - J_turn @ np.linalg.lstsq(A, B, rcond=None)[0]
    scale = fit.adjustment.cost / fit.adjustment.dof
    C = scale * np.einsum("...ij,jk,...lk->...il", J, fit.adjustment.shared_covariance, J)
    return uv, np.where(inside, np.sqrt(np.trace(C, axis1=-2, axis2=-1) / 2), np.nan)


def _cross(points: Floats) -> Floats:
    out = np.zeros((*points.shape, 3))
    x, y, z = np.moveaxis(points, -1, 0)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def _lens_prior_sigmas(camera: Camera, terms: int) -> Floats:
    """(4 + terms,) standard deviations before the images: next to nothing known, or pinned."""
    names = lens.lens_parameter_names(camera.distortion)[4:]
    return np.array(
        [camera.matrix[0, 0], camera.matrix[1, 1], camera.width, camera.width]
        + [WIDE[name] if k < terms else PINNED for k, name in enumerate(names)]
    )


def _start(o: Observations, width: int, height: int, terms: int, name: str, camera: Camera | None = None) -> State:
    """State with a first guess of the lens, unless a Camera is given, and of the board's pose in every photograph."""
    frames = range(len(o.frames))
    if camera is None:
        flat = [o.points[o.frame == f].astype(np.float32) for f in frames]
        seen = [o.uv[o.frame == f].astype(np.float32) for f in frames]
        K = cast(Floats, cv2.initCameraMatrix2D(flat, seen, (width, height), 1.0))
        if not (np.isfinite(K).all() and 0.1 * width < K[0, 0] < 50 * width):
            K = np.array([[1.2 * width, 0, (width - 1) / 2], [0, 1.2 * width, (height - 1) / 2], [0, 0, 1]])
        camera = Camera(name, width, height, K, np.zeros(terms), RigidTransform.identity(), mount="moving")
    poses = []
    for f in frames:
        rows = o.frame == f
        ideal = lens.undistort(o.uv[rows], camera.matrix, camera.distortion)
        ok, turn, shift = cv2.solvePnP(o.points[rows], ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if not ok or shift[2] <= 0:
            raise NotEnoughData(f"photograph {o.frames[f]}: its {rows.sum()} corners give no pose of the board")
        poses.append(RigidTransform.from_components(shift.ravel(), Rotation.from_rotvec(turn.ravel())).inv())
    T = RigidTransform.concatenate(poses)
    return State((camera,), RigidTransform.from_matrix(np.tile(np.eye(4), (len(poses), 1, 1))), {0: T})


FACTORS = (1.0, 0.9, 1.1)  # times the stated focal length, from which lenses of which nothing is known are adjusted
UNSTATED = (
    0.2,
    0.06,
    # of the focal length and of the image's width, that a lens which nobody stated may be from the stated one and the
    # middle
)
Cameras = tuple[Camera, ...]


def alternative_initial_lenses(
    stated: Cameras, adjust_with_free_places: Callable[[Cameras], Cameras | None]
) -> Iterator[Cameras]:
    """Alternative initial lenses in turn.

    Plain ones first, then lenses adjusted with free marker places.
    adjust_with_free_places : Cameras -> these, adjusted with markers' places free, or None where that fails
    A lens far from the stated one puts corners of its camera so far off that frames or the whole camera are left out;
    with places free they are not
    """
    unknown = [_undistorted_lenses(stated, factor) for factor in FACTORS]
    yield from unknown
    for begun in (stated, unknown[0]):
        found = adjust_with_free_places(begun)
        if found is not None:
            yield found


def _undistorted_lenses(stated: Cameras, factor: float = 1.0) -> Cameras:
    """The same cameras with no distortion, the centre in the middle of the image and a factor times the stated focal
    length.
    """
    out = []
    for c in stated:
        f = c.matrix[0, 0] * factor
        matrix = np.array([[f, 0, (c.width - 1) / 2], [0, f, (c.height - 1) / 2], [0, 0, 1.0]])
        out.append(replace(c, matrix=matrix, distortion=np.zeros(max(5, len(c.distortion)))))
    return tuple(out)


def are_lenses_plausible(adjusted: Cameras, stated: Cameras) -> bool:
    """Whether adjusted lenses are plausible.

    Near the stated focal length, centred in the image.
    """
    zoomed = [abs(float(a.matrix[0, 0] / s.matrix[0, 0]) - 1) for a, s in zip(adjusted, stated)]
    aside = [
        float(np.abs(a.matrix[:2, 2] - [(s.width - 1) / 2, (s.height - 1) / 2]).max()) / s.width
        for a, s in zip(adjusted, stated)
    ]
    return max(zoomed) < UNSTATED[0] and max(aside) < UNSTATED[1]
