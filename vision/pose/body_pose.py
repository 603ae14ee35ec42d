"""Pose of one body from its corners.

In one or several cameras: consensus of markers, robust refinement.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, cast, final

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Camera
from vision import opencv_lens_model as lens
from vision.marker_corner_prediction import SQUARE, MarkerMap
from vision.pose.pose_refinement_and_choice_by_neighbour_frames import AHEAD, GATE, refine_pose_in_place

CONSENSUS = 10.0  # px; a corner farther than this from where a candidate puts it speaks against the candidate
FINEST = 0.02  # px; a robust scale below this is rounding, not noise
SAME = 0.05  # rad, and fraction of the distance: closer poses are one
RIVAL = 25.0  # chi-square by which the best pose must beat a different one
FIRST_SIGHTINGS = 4  # sightings tried as candidates before all the others are
AGREED = 0.8  # share of corners in consensus at which the first sightings suffice


@dataclass(frozen=True, slots=True, eq=False)
class BodyCorners:
    """Corners of one body that posed cameras see at one moment, lens taken out.

    points : (n, 3) m, body frame; normals : (n, 3) of the corner's marker, body frame
    ideal : (n, 2) image coordinates x/z, y/z, lens taken out; covariance : (n, 2, 2) of them
    camera : (n,) index; marker : (n,) row of the marker map; corner : (n,) 0..3
    focal : (c,) px; T_camera_world : (c, 4, 4) matrices
    """

    points: Floats
    normals: Floats
    ideal: Floats
    covariance: Floats
    camera: Integers
    marker: Integers
    corner: Integers
    focal: Floats
    T_camera_world: Floats


@final
@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """matrix : (4, 4) T_world_body; covariance : (6, 6) on the right, for the corners' covariance as given;
    inliers : (n,) bool.
    """

    matrix: Floats
    covariance: Floats
    inliers: Booleans

    @property
    def T_world_body(self) -> RigidTransform:
        """The pose."""
        return RigidTransform.from_matrix(self.matrix)


@dataclass(frozen=True, slots=True)
class Unsolved:
    """No pose, and why. False in a condition. candidates : Located poses that the images alone cannot decide
    between.
    """

    reason: str
    candidates: tuple[Located, ...] = ()

    def __bool__(self) -> Literal[False]:
        return False


_Sighting = tuple[int, int, Integers]  # camera, marker, rows in corner order


class _Refined(NamedTuple):
    """matrix : (4, 4) T_world_body; covariance : (6, 6); inliers : (n,) bool; square : of whitened residuals, summed;
    scale : theirs, robust.
    """

    matrix: Floats
    covariance: Floats
    inliers: Booleans
    square: float
    scale: float


def undistorted_corners_and_covariance(
    uv: Floats, covariance: Floats, camera: Integers, cameras: Sequence[Camera]
) -> tuple[Floats, Floats]:
    """Undistorted ideal coordinates (n, 2) of corners (n, 2) px, with covariance (n, 2, 2).
    Camera by camera; NaN beyond a lens.
    """
    ideal, out = np.empty_like(uv), np.empty_like(covariance)
    for i in np.unique(camera):
        rows, matrix, distortion = camera == i, cameras[i].matrix, cameras[i].distortion
        ideal[rows] = lens.undistort(uv[rows], matrix, distortion)
        points = np.concatenate([ideal[rows], np.ones((rows.sum(), 1))], axis=1)
        back = np.linalg.inv(lens.projected_pixels_and_jacobians(np.nan_to_num(points), matrix, distortion)[1][..., :2])
        out[rows] = back @ covariance[rows] @ np.swapaxes(back, -1, -2)
    return ideal, out


def body_pose_from_corners(
    body_corners: BodyCorners, marker_map: MarkerMap, outlier_floor: float = FINEST
) -> Located | Unsolved:
    """Pose of a body from its corners in all cameras at once, or why there is none (Unsolved).

    Wrong identities and outliers excluded.
    marker_map : how each marker sits on the body; outlier_floor : px, residuals smaller than this are never an
    outlier's: what the markers' stated places are uncertain by
    Returns Located, or Unsolved where nothing is seen, where one sighting of one marker cannot be checked against
    another, where the sightings contradict each other, or where two different poses fit as well
    Source: Collins and Bartoli, Infinitesimal plane-based pose estimation, IJCV 2014 (candidates); consensus as in
    Fischler and Bolles 1981, over all candidates instead of a random draw
    """
    sightings = _sightings(body_corners)
    if not sightings:
        return Unsolved(
            "no marker of the body is seen whole" if len(body_corners.points) else "no marker of the body is seen"
        )
    seen = sorted({int(marker_map.id[marker]) for _, marker, _ in sightings})
    matrices, distance = _candidates(body_corners, sightings[:FIRST_SIGHTINGS], marker_map)
    if len(sightings) == 1:
        return Unsolved(
            f"only marker {seen[0]} is seen, once: a single sighting cannot be checked against another",
            _alone(body_corners, matrices, distance, outlier_floor),
        )
    if not len(matrices) or (distance < CONSENSUS).mean(axis=1).max() < AGREED:
        matrices, distance = _candidates(body_corners, sightings, marker_map)
    if not len(matrices):
        return Unsolved("no single marker gives a pose in front of its camera")
    score = (np.minimum(distance / CONSENSUS, 1) ** 2).sum(axis=1)
    chosen = np.argmin(score)
    best = _refine(body_corners, matrices[chosen], distance[chosen] < CONSENSUS, outlier_floor)
    if best is None:
        return Unsolved(f"markers {seen} give no common pose")
    matrix, covariance, inliers, square, scale = best
    agreeing = int((inliers[np.array([rows for _, _, rows in sightings])].sum(axis=1) >= 3).sum())
    if agreeing < 2 or 2 * agreeing < len(sightings):
        return Unsolved(
            f"the markers contradict each other: {agreeing} of {len(sightings)} sightings of markers {seen} "
            "agree on a pose"
        )
    located = Located(matrix, covariance, inliers)
    alternative = _alternative(body_corners, matrices, distance, matrix, square, scale, outlier_floor)
    if alternative is not None:
        turn = np.degrees(_turn(alternative.matrix, matrix))
        return Unsolved(f"two poses {turn:.0f} degrees apart fit markers {seen} equally well", (located, alternative))
    return located


def _alone(body_corners: BodyCorners, matrices: Floats, distance: Floats, finest: float) -> tuple[Located, ...]:
    """Located poses of one sighting by itself: one, or the two that a plane's image leaves and whose fits do not differ
    enough.
    """
    refined = [_refine(body_corners, matrix, near < CONSENSUS, finest) for matrix, near in zip(matrices, distance)]
    found = sorted((one for one in refined if one is not None), key=lambda one: one[3])
    worst = (
        found[0][3] + RIVAL * max(1.0, found[0][3] / 2) if found else 0.0
    )  # eight figures less six unknowns leave two
    return tuple(
        Located(*one[:3])
        for k, one in enumerate(found)
        if one[3] < worst and all(_apart(one[0], other[0]) is not None for other in found[:k])
    )


def _sightings(body_corners: BodyCorners) -> list[_Sighting]:
    """(camera, marker, rows in corner order) of every marker seen with its four corners, largest image first."""
    order = np.lexsort((body_corners.corner, body_corners.marker, body_corners.camera))
    key = (body_corners.camera * 100_000 + body_corners.marker)[order]
    starts = np.flatnonzero(np.diff(key, prepend=-1))
    starts = starts[np.diff(starts, append=len(key)) == 4]
    whole = order[starts[:, None] + np.arange(4)]
    whole = whole[np.isfinite(body_corners.ideal[whole]).all(axis=(1, 2))]
    whole = whole[np.argsort(-np.ptp(body_corners.ideal[whole], axis=1).prod(axis=1), kind="stable")]
    camera, marker = body_corners.camera[whole[:, 0]].tolist(), body_corners.marker[whole[:, 0]].tolist()
    return list(zip(camera, marker, whole))


def _candidates(
    body_corners: BodyCorners, sightings: Sequence[_Sighting], marker_map: MarkerMap
) -> tuple[Floats, Floats]:
    """Matrices (k, 4, 4) T_world_body from each sighting by itself, and their distances (k, n) px to every corner."""
    found, Ts_body_marker = [], marker_map.T_body_marker.as_matrix()
    for camera, marker, rows in sightings:
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            marker_map.side[marker] * SQUARE, body_corners.ideal[rows], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        T_world_camera, T_marker_body = (
            inverse_pose(body_corners.T_camera_world[camera]),
            inverse_pose(Ts_body_marker[marker]),
        )
        for k in range(count):
            T_camera_marker = np.eye(4)
            T_camera_marker[:3, :3], T_camera_marker[:3, 3] = cv2.Rodrigues(rotations[k])[0], translations[k].ravel()
            if np.isfinite(T_camera_marker).all() and T_camera_marker[2, 3] > AHEAD:
                found.append(T_world_camera @ T_camera_marker @ T_marker_body)
    matrices = np.array(found).reshape(-1, 4, 4)
    return matrices, _distances(body_corners, matrices)


def inverse_pose(pose: Floats) -> Floats:
    """Inverse (4, 4) of a pose (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = pose[:3, :3].T
    out[:3, 3] = -out[:3, :3] @ pose[:3, 3]
    return out


def _distances(body_corners: BodyCorners, matrices: Floats) -> Floats:
    """(k, n) px between corners and where each pose puts them; infinite where the marker would face away."""
    to_camera = (body_corners.T_camera_world @ matrices[:, None])[:, body_corners.camera]
    R = to_camera[..., :3, :3]
    ahead = np.einsum("knij,nj->kni", R, body_corners.points) + to_camera[..., :3, 3]
    facing = np.einsum("knij,nj,kni->kn", R, body_corners.normals, ahead) < 0
    possible = facing & (ahead[..., 2] > AHEAD)
    gap = ahead[..., :2] / np.where(possible, ahead[..., 2], 1)[..., None] - body_corners.ideal
    return np.where(
        possible & np.isfinite(gap[..., 0]),
        np.linalg.norm(gap, axis=-1) * body_corners.focal[body_corners.camera],
        np.inf,
    )


def _refine(body_corners: BodyCorners, matrix: Floats, inliers: Booleans, least: float) -> _Refined | None:
    """A robust Gauss-Newton from a pose and who agrees with it; None where it falls apart. least : px, the robust
    scale's floor
    """
    matrix, inliers = matrix.copy(), inliers.copy()
    J, square = np.zeros((len(body_corners.points), 2, 6)), np.zeros(len(body_corners.points))
    try:
        scale = refine_pose_in_place(
            (body_corners.points, body_corners.ideal, body_corners.covariance, body_corners.camera),
            np.ascontiguousarray(
                body_corners.T_camera_world
            ),  # a body_corners of another layout would be compiled for once more
            body_corners.focal,
            matrix,
            inliers,
            least,
            J,
            square,
        )
    except np.linalg.LinAlgError:
        return None
    inliers &= np.isfinite(_distances(body_corners, matrix[None])[0])
    if np.isnan(scale) or inliers.sum() < 4:
        return None
    used = J[inliers].reshape(-1, 6)
    H = used.T @ used
    if np.linalg.cond(H) > 1e14:
        return None
    return _Refined(
        matrix,
        cast(Floats, np.linalg.inv(H)),
        inliers,
        float(np.minimum(square, (GATE * scale) ** 2).sum()),
        float(scale),
    )


def _alternative(
    body_corners: BodyCorners,
    matrices: Floats,
    distance: Floats,
    matrix: Floats,
    square: float,
    scale: float,
    finest: float,
) -> Located | None:
    """Located, a different pose that fits as well, or None. Only a candidate near nearly all corners can be one."""
    near = np.flatnonzero((distance < CONSENSUS).mean(axis=1) >= 0.9)
    tried, free = [matrix], max(2 * len(body_corners.points) - 6, 1)
    unit = max(scale**2, square / free)  # of a few corners the median alone says little
    worse = (
        RIVAL * (1 + RIVAL / free) * unit
    )  # a t distribution's: so far may chance set apart what few corners measure
    for at in near[np.argsort(distance[near].max(axis=1), kind="stable")]:
        if len(tried) > 3:
            break
        if any(_apart(matrices[at], other) is None for other in tried):
            continue
        tried.append(matrices[at])
        alternative = _refine(body_corners, matrices[at], distance[at] < CONSENSUS, finest)
        if (
            alternative is None
            or not alternative.square - square < worse
            or alternative.inliers.sum() < 0.9 * len(alternative.inliers) - 1
        ):
            continue
        if _apart(alternative.matrix, matrix) is not None:
            return Located(*alternative[:3])
    return None


def _apart(a: Floats, b: Floats) -> float | None:
    """Angle (rad) between two poses that differ, None for two that are the same."""
    angle = _turn(a, b)
    far = np.linalg.norm(a[:3, 3] - b[:3, 3]) > SAME * max(float(np.linalg.norm(a[:3, 3])), 0.1)
    return angle if angle > SAME or far else None


def _turn(a: Floats, b: Floats) -> float:
    """Angle (rad) between the rotations of two poses (4, 4)."""
    M = a[:3, :3].T @ b[:3, :3]
    sine = np.sqrt((M[2, 1] - M[1, 2]) ** 2 + (M[0, 2] - M[2, 0]) ** 2 + (M[1, 0] - M[0, 1]) ** 2)
    return float(np.arctan2(sine, M[0, 0] + M[1, 1] + M[2, 2] - 1))
