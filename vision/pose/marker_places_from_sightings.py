"""Marker places on a body from sightings.

From the images alone: relative poses of markers seen together, averaged over images.

Every image of a marker gives its pose in the camera, two of them where a plane's image is ambiguous. Two markers in one
image are a relative pose, whatever the camera does; of all images of a pair the one is retained that most agree with.
A spanning tree of the pairs most agreed upon places all markers of a body, and averaging over all pairs refines them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from scipy.sparse import csgraph, csr_array
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Camera
from vision.corner_observations_and_merging import Observations
from vision.marker_corner_prediction import SQUARE, MarkerMap
from vision.pose.body_pose import RIVAL, inverse_pose, undistorted_corners_and_covariance
from vision.pose.pose_refinement_and_choice_by_neighbour_frames import AHEAD

TURN = 0.2  # rad; relative poses of a pair of markers that turn by less agree
SHIFT = 0.5  # of the markers' side; and those that are closer
IMAGES = 60  # of a pair that are compared with each other
SWEEPS = 20  # of averaging
SETTLED = 1e-6  # rad; rotations that move by less in a sweep are averaged
STATED = 0.2  # of the images that need not agree with a relative pose because it is as stated
SPARE = 0.25  # mean square of a single marker's residuals over the corners' variance: of eight figures two are left


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """What images say of two markers. first, second : rows of the marker map; matrix : (4, 4) T_first_second; agreeing
    : number of images that agree
    """

    first: int
    second: int
    matrix: Floats
    agreeing: int


def marker_places_from_sightings(
    observations: Observations, cameras: Sequence[Camera], marker_map: MarkerMap
) -> tuple[MarkerMap, Booleans]:
    """MarkerMap with places found from sightings, and a mask of the markers found.

    observations : Observations; cameras : their lenses, poses are not used; marker_map : MarkerMap as stated
    Markers of each body are placed relative to each other by images that show two or more of them, and then, as a
    whole, where the stated places of those found lie, in the least-squares sense; by the first of them where none of
    these is stated. A marker without a link to the largest group of its body's remains where it is stated, and is not
    found.
    Returns (MarkerMap with places found from the images, (m,) bool which were found)
    Source: spanning tree and averaging as in Hartley et al., Rotation averaging, IJCV 2013; poses of single markers by
    Collins and Bartoli, Infinitesimal plane-based pose estimation, IJCV 2014
    """
    matrices, found = marker_map.T_body_marker.as_matrix().copy(), np.zeros(len(marker_map.id), bool)
    seen = _poses_of_sightings(observations, cameras, marker_map)
    for on in (False, True):
        body = [one for one in seen if marker_map.on_platform[one[1]] == on and not marker_map.stage[one[1]]]
        pairs = _agreed_pairs(body, marker_map)
        rows = _largest_group(pairs, len(matrices))
        if not len(rows):
            continue
        own = [pair for pair in pairs if pair.first in rows]
        placed = _averaged(own, rows, _along_tree(own, rows))
        matrices[rows], found[rows] = _at_stated_places(placed, rows, marker_map), True
    return replace(marker_map, T_body_marker=RigidTransform.from_matrix(matrices)), found


_Sighting = tuple[int, int, Floats]  # image, row of the marker map, (k, 4, 4) T_camera_marker


def _poses_of_sightings(o: Observations, cameras: Sequence[Camera], markers: MarkerMap) -> list[_Sighting]:
    """Poses of every marker that an image shows with its four corners: two where both fit them equally well."""
    ideal, _ = undistorted_corners_and_covariance(o.uv, o.covariance, o.camera, cameras)
    image, out = o.camera * len(o.frames) + o.frame, []
    order = np.lexsort((o.corner, o.marker, image))
    key = (image * len(markers.id) + o.marker)[order]
    for rows in np.split(order, np.flatnonzero(np.diff(key)) + 1):
        if len(rows) != 4 or not np.isfinite(ideal[rows]).all():
            continue
        row, focal = int(o.marker[rows[0]]), cameras[o.camera[rows[0]]].matrix[0, 0]
        count, turns, shifts, errors = cv2.solvePnPGeneric(
            markers.side[row] * SQUARE, ideal[rows], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        T = np.tile(np.eye(4), (count, 1, 1))
        for k in range(count):
            T[k, :3, :3], T[k, :3, 3] = cv2.Rodrigues(turns[k])[0], shifts[k].ravel()
        ahead = np.isfinite(T).all(axis=(1, 2)) & (T[:, 2, 3] > AHEAD)
        if ahead.any():
            out.append((int(image[rows[0]]), row, T[ahead], (focal * np.ravel(errors)[ahead]) ** 2))
    if not out:
        return []
    variance = np.median([miss.min() for *_, miss in out]) / (np.log(2) * SPARE)
    return [(i, row, T[8 * (miss - miss.min()) <= RIVAL * variance]) for i, row, T, miss in out]


def _agreed_pairs(sightings: Sequence[_Sighting], markers: MarkerMap) -> list[_Pair]:
    """Pairs of markers that images show together, with the relative pose that most images agree with."""
    images: dict[int, list[_Sighting]] = {}
    for one in sightings:
        images.setdefault(one[0], []).append(one)
    together: dict[tuple[int, int], list[Floats]] = {}
    for shown in images.values():
        for (_, a, Ts_a), (_, b, Ts_b) in combinations(sorted(shown, key=lambda one: one[1]), 2):
            together.setdefault((a, b), []).append((np.linalg.inv(Ts_a)[:, None] @ Ts_b).reshape(-1, 4, 4))
    stated = markers.T_body_marker.as_matrix()
    return [
        _agreed(
            a,
            b,
            of_images,
            SHIFT * float(np.mean(markers.side[[a, b]])),
            np.linalg.inv(stated[a]) @ stated[b] if markers.stated[[a, b]].all() else None,
        )
        for (a, b), of_images in together.items()
    ]


def _agreed(a: int, b: int, of_images: list[Floats], shift: float, stated: Floats | None) -> _Pair:
    """The pair's relative pose: of all candidates the one that images contradict least, averaged over those that agree.

    of_images : (k, 4, 4) candidates of each; shift : m within which poses agree; stated : (4, 4) or None, which decides
    where images hardly do
    """
    if len(of_images) > IMAGES:
        of_images = [of_images[k] for k in np.linspace(0, len(of_images) - 1, IMAGES).astype(int)]
    T = np.concatenate(of_images)
    edges = np.cumsum([0, *(len(relative) for relative in of_images[:-1])])
    apart = np.minimum(_squares_apart(T, T, shift), 1)  # (candidate, other)
    against = np.minimum.reduceat(apart, edges, axis=1).sum(axis=1)
    if stated is not None:
        against += STATED * len(of_images) * np.minimum(_squares_apart(T, stated[None], 2 * shift)[:, 0], 1)
    best = T[np.argmin(against)]
    for _ in range(3):
        own = _squares_apart(best[None], T, shift)[0]
        nearest = np.array([start + np.argmin(part) for start, part in zip(edges, np.split(own, edges[1:]))])
        nearest = nearest[own[nearest] < 1]
        if not len(nearest):
            break
        best = np.eye(4)
        best[:3, :3] = Rotation.from_matrix(T[nearest, :3, :3]).mean().as_matrix()
        best[:3, 3] = np.median(T[nearest, :3, 3], axis=0)
    return _Pair(a, b, best, max(len(nearest), 1))


def _squares_apart(some: Floats, others: Floats, shift: float) -> Floats:
    """(k, n) how far poses some (k, 4, 4) are from others (n, 4, 4), squared, in what is allowed."""
    trace = np.einsum("kij,nij->kn", some[:, :3, :3], others[:, :3, :3])
    turn = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    away = np.linalg.norm(some[:, None, :3, 3] - others[:, :3, 3], axis=2)
    return (turn / TURN) ** 2 + (away / shift) ** 2


def _largest_group(pairs: Sequence[_Pair], count: int) -> Integers:
    """Rows of the largest group of markers that pairs link, in order; none without a pair. count : of all markers"""
    if not pairs:
        return np.zeros(0, int)
    _, label = csgraph.connected_components(_graph(pairs, count), directed=False)
    return np.flatnonzero(label == np.argmax(np.bincount(label)))


def _graph(pairs: Sequence[_Pair], count: int) -> csr_array:
    """Links of markers, the shorter the more images agree."""
    length = [1 / pair.agreeing for pair in pairs]
    return csr_array((length, ([p.first for p in pairs], [p.second for p in pairs])), shape=(count, count))


def _along_tree(pairs: Sequence[_Pair], rows: Integers) -> Floats:
    """(r, 4, 4) T_root_marker of rows (r,) along the tree of pairs with most images; the root is the best linked."""
    links = {(p.first, p.second): p.matrix for p in pairs}
    links |= {(p.second, p.first): inverse_pose(p.matrix) for p in pairs}
    tree = csgraph.minimum_spanning_tree(_graph(pairs, int(rows.max()) + 1))
    agreeing = np.zeros(len(rows))
    for pair in pairs:
        agreeing[np.searchsorted(rows, [pair.first, pair.second])] += pair.agreeing
    root = int(rows[np.argmax(agreeing)])
    order, before = csgraph.breadth_first_order(tree, root, directed=False)
    placed = {root: np.eye(4)}
    for row in order[1:].tolist():
        placed[row] = placed[int(before[row])] @ links[int(before[row]), row]
    return np.array([placed[row] for row in rows.tolist()])


def _averaged(pairs: Sequence[_Pair], rows: Integers, start: Floats) -> Floats:
    """(r, 4, 4) places of rows (r,) that agree with all pairs best, each counted by its images; pairs that contradict
    the start count nothing.
    """
    i, j = (np.searchsorted(rows, [getattr(pair, end) for pair in pairs]) for end in ("first", "second"))
    relative, weight = np.array([pair.matrix for pair in pairs]), np.array([float(pair.agreeing) for pair in pairs])
    R = start[:, :3, :3].copy()
    for _ in range(SWEEPS):
        expected = R[i] @ relative[:, :3, :3]
        angle = Rotation.from_matrix(np.swapaxes(expected, 1, 2) @ R[j]).magnitude()
        share = weight / (1 + (angle / TURN) ** 2) ** 2
        total = np.zeros_like(R)
        np.add.at(total, j, share[:, None, None] * expected)
        np.add.at(total, i, share[:, None, None] * (R[j] @ np.swapaxes(relative[:, :3, :3], 1, 2)))
        total += R * 1e-9  # a marker whose pairs all contradict the tree remains on it
        U, _, Vt = np.linalg.svd(total)
        U[..., -1] *= np.linalg.det(U @ Vt)[:, None]
        moved = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ (U @ Vt)).magnitude().max()
        R = U @ Vt
        if moved < SETTLED:
            break
    step, links = (R[i] @ relative[:, :3, 3:])[..., 0], np.zeros((len(pairs) + 1, len(rows)))
    links[np.arange(len(pairs)), i], links[np.arange(len(pairs)), j], links[-1, 0] = -1, 1, 1
    out, scale = start.copy(), np.ones(len(pairs))
    out[:, :3, :3] = R
    for _ in range(SWEEPS // 4):
        root = np.sqrt(np.append(share * scale, 1.0))[:, None]
        out[:, :3, 3] = np.linalg.lstsq(root * links, root * np.vstack([step, np.zeros(3)]), rcond=None)[0]
        miss = np.linalg.norm(links[:-1] @ out[:, :3, 3] - step, axis=1)
        scale = 1 / (1 + (miss / max(float(np.median(miss)), 1e-9)) ** 2)
    return out


def _at_stated_places(placed: Floats, rows: Integers, markers: MarkerMap) -> Floats:
    """(r, 4, 4) of places (r, 4, 4) in any frame: in the body's, where the stated corners of rows (r,) lie."""
    own = RigidTransform.from_matrix(placed)
    known = markers.stated[rows]
    if not known.any():
        return (own[0].inv() * own).as_matrix()
    square = markers.in_marker[rows[known]]
    stated_points = np.concatenate([T.apply(points) for T, points in zip(own[np.flatnonzero(known)], square)])
    stated = markers.corners[rows[known]].reshape(-1, 3)
    turn, _ = Rotation.align_vectors(stated - stated.mean(axis=0), stated_points - stated_points.mean(axis=0))
    return (
        RigidTransform.from_components(stated.mean(axis=0) - turn.apply(stated_points.mean(axis=0)), turn) * own
    ).as_matrix()
