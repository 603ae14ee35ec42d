"""Corners linearised at an operating point.

Whitened residuals and derivatives, freedoms of cubes and edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.engine.linear_residual_model import orthonormal_combinations
from calib.diagnosis.problems.platform.linearisation_operating_point import EDGE_SHIFT, OperatingPoint
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.parallel_map_and_dask_cluster import thread_map
from rig.effects.framework.effect_base_class import MOTION_STAGES, Effect
from rig.model.arm_hands_effect_places_and_tolerances import FINDER, SEAT, Place
from rig.model.design import Design
from vision import opencv_lens_model as lens
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import stated_lens_prior_sigmas
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    corner_jacobians_to_poses_and_lens_by_camera,
    iterate_camera_jacobians,
    rotate_jacobian,
    small_motion_jacobian,
)
from vision.bundle.pose_covariance_of_correlated_corner_errors import (
    SmoothImageErrors,
    smooth_image_error_model_of_corners,
)
from vision.corner_observations_and_merging import Observations, group_sums, repeated_base_corner_rows_and_groups

CLIP = 5.0  # standard deviations for which a corner's residual counts at most
EDGES = "edges"  # name of that freedom of each camera: a bias of all its edges, which the corner finder brings
SEAT_LABELS = tuple(
    f"seat {part}" for part in ("x", "y", "z", "rx", "ry", "rz")
)  # of where a cube sits that was put back
MEDIAN = 0.4549364  # of chi-square with one degree of freedom
REPEATS = 5  # of a standing corner from which its mean counts
NEAR = 0.1  # px that corners may move for their derivatives to hold: these change by a part in ten thousand
PARTS = 4  # of a long table, multiplied side by side; as many on any number of cores, so that sums are rounded alike
STANDING_GROUPS, STANDING_PROOF = 20, 4.0  # standing corners, and standard errors by which they must be off together


@dataclass(frozen=True, slots=True, eq=False)
class CornerDerivatives:
    """Whitened derivatives of n corners, frame by frame, with the nuisances at an OperatingPoint.

    point : OperatingPoint; pixels : (n, 2) px that it predicts, in the observations' order; order : (n,) of the
        observations; edges : (F + 1,) where frames begin in it; whiten : (n, 2, 2) 1/px
    table : (2n, p) derivatives, each frame's own poses taken out; inner : (F, L, p) what these take of them
    gram : (p, p) products of the table's columns; free : (p, r) orthonormal combinations of them, priors counted
    own : (2n,) bool, whether a corner's covariance stands as stated
    local : (2n, L) orthonormal basis of each frame's own poses; to_local : (F, L, L) from its coordinates to tangents
    names : (camera, what) of the nuisances; priors : (p,) 1 / standard deviation; camera_columns : {camera's index: its
        nuisances}"""

    point: OperatingPoint
    pixels: Floats
    order: Integers
    edges: Integers
    whiten: Floats
    table: Floats
    inner: Floats
    gram: Floats
    free: Floats
    own: Booleans
    local: Floats
    to_local: Floats
    names: list[tuple[str, str]]
    priors: list[float]
    camera_columns: dict[int, list[int]]
    smooth: SmoothImageErrors

    def without_nuisances(self, left: Floats) -> Floats:
        """(2n,) whitened residuals left with what the nuisances explain of them taken out."""
        return left - self.table @ (self.free @ (self.free.T @ (self.table.T @ left)))

    def holds_at(self, point: OperatingPoint, pixels: Floats) -> bool:
        """Whether the derivatives hold at another OperatingPoint that predicts pixels (n, 2) px: the same corners, as
        they count here, seen through the same effects, nearly where they are here. Cameras may take up so much of an
        effect on what is seen that corners stay near, and derivatives do not.
        """
        known = self.point
        return (
            point.seen is known.seen
            and point.standing == known.standing
            and point.moving.keys() == known.moving.keys()
            and [seat.place for seat in point.seats] == [seat.place for seat in known.seats]
            and bool((np.abs(pixels - self.pixels) < NEAR).all())
            and self._holds_with_effects_of(point)
        )

    def _holds_with_effects_of(self, point: OperatingPoint) -> bool:
        own, others = _effects_on_what_is_seen(self.point), _effects_on_what_is_seen(point)
        if own == others:
            return True
        if [(e.name, e.place) for e in own] != [(e.name, e.place) for e in others]:
            return False
        moved = self.point.with_effects(point.effects).pixels() - self.pixels
        return bool((np.abs(moved) < NEAR).all())


@dataclass(frozen=True, slots=True, eq=False)
class CornerFrames:
    """Corners' rows frame by frame, and what each frame's own poses take of them.

    order : (n,) of the observations; edges : (F + 1,) where frames begin in it; whiten : (n, 2, 2) 1/px
    local : (2n, L) orthonormal basis of each frame's own poses; to_local : (F, L, L) from its coordinates to tangents
    inner : (F, L, 1 + camera nuisances) the residual's and those nuisances' coordinates in it
    sigma : px, noise of a corner over what its covariance said; excess : what Huber's loss of the clipped corners is
        above their squares
    clip : standard deviations for which a residual counts at most; reach : which REACHED of the residuals do not exceed
    spread : (F, L, L) covariance of the frames' own poses on that basis where corner errors are not equal and
        independent, else None
    """

    order: Integers
    edges: Integers
    whiten: Floats
    local: Floats
    to_local: Floats
    inner: Floats
    sigma: float = 1.0
    excess: float = 0.0
    clip: float = CLIP
    reach: float = 0.0
    spread: Floats | None = None

    def pose_covariance(self, along: Floats) -> Floats:
        """Covariance (F, k, k) of combinations along (F, k, L) of the coordinates of the frames' own poses."""
        return (along if self.spread is None else along @ self.spread) @ np.swapaxes(along, 1, 2)

    def total_spread(self) -> float:
        """Sum of the variances of all frames' own poses on their basis."""
        if self.spread is None:
            return float(self.local.shape[1] * (len(self.edges) - 1))
        return float(np.einsum("fll->", self.spread))


def _effects_on_what_is_seen(point: OperatingPoint) -> list[Effect]:
    return [effect for effect in point.effects if effect.stage not in MOTION_STAGES]


class _Nuisances:
    """What cameras, lenses and the corner finder may do to corners, gathered camera by camera: rows of corners, and
    their derivatives there.
    """

    def __init__(self) -> None:
        self.shared: list[tuple[Integers, Floats]] = []
        self.names: list[tuple[str, str]] = []
        self.priors: list[float] = []
        self.camera_columns: dict[int, list[int]] = {}

    def add(self, rows: Integers, block: Floats, camera: str, labels: tuple[str, ...], priors: list[float]) -> None:
        """Derivatives (m, 2, p) of corners (m,) rows with nuisances of a camera; priors : (p,) 1 / standard
        deviation
        """
        self.shared.append((rows, block))
        self.names += [(camera, label) for label in labels]
        self.priors += priors


def coordinates_and_rest_in_frame_bases(
    rows: Floats, frame_bases: Floats, frame_edges: Integers
) -> tuple[Floats, Floats]:
    """Rows (2n, k) split by each frame's own basis.

    Into coordinates in the basis (F, L, k) and the orthogonal rest (2n, k).

    The rows are overwritten.
    """
    inner = np.empty((len(frame_edges) - 1, frame_bases.shape[1], rows.shape[1]))
    for f, (a, b) in enumerate(zip(2 * frame_edges[:-1], 2 * frame_edges[1:])):
        inner[f] = frame_bases[a:b].T @ rows[a:b]
        rows[a:b] -= frame_bases[a:b] @ inner[f]
    return inner, rows


def corner_derivatives(point: OperatingPoint, predicted_pixels: Floats) -> CornerDerivatives:
    """Whitened CornerDerivatives at an OperatingPoint whose predicted pixels are (n, 2) px."""
    o = point.observed.observations
    n, L = len(o), 6 + 6 * len(point.moving)
    weights = _weights(o, point)
    whitener = np.linalg.inv(np.linalg.cholesky(weights))
    order = np.lexsort((o.camera, o.frame))
    edges = np.searchsorted(o.frame[order], np.arange(len(point.t) + 1))
    at = np.argsort(order)  # where each corner stands, frame by frame
    J_local, found = np.zeros((n, 2, L)), _Nuisances()
    for i, rows, J_platform, J_camera, J_lens in corner_jacobians_to_poses_and_lens_by_camera(o, point.state):
        camera = point.stated.cameras[i]
        J_local[at[rows], :, :6] = whitener[rows] @ J_platform
        blocks = [
            (J_lens, lens.lens_parameter_names(camera.distortion), (1 / stated_lens_prior_sigmas(camera)).tolist())
        ]
        if i in point.moving:
            own = 6 + 6 * sorted(point.moving).index(i)
            J_local[at[rows], :, own : own + 6] = whitener[rows] @ J_camera
        else:
            blocks.insert(0, (J_camera, ("x", "y", "z", "rx", "ry", "rz"), [0.0] * 6))
        for block, labels, prior in blocks:
            found.camera_columns.setdefault(i, []).extend(range(len(found.names), len(found.names) + len(labels)))
            found.add(at[rows], whitener[rows] @ block, camera.name, labels, prior)
    _add_finder(point, found, at, whitener)
    _add_seats(point, found, at, whitener)
    table, start = np.zeros((n, 2, len(found.names))), 0
    for at_rows, block in found.shared:
        table[at_rows, :, start : start + block.shape[2]] = block
        start += block.shape[2]
    local, to_local = _own_basis(J_local.reshape(2 * n, L), edges)
    stated = np.repeat((weights[order] == o.covariance[order]).all(axis=(1, 2)), 2)
    inner, derivatives = coordinates_and_rest_in_frame_bases(table.reshape(2 * n, -1), local, edges)
    gram = np.sum(thread_map(lambda part: part.T @ part, np.array_split(derivatives, PARTS)), axis=0)
    return CornerDerivatives(
        point,
        predicted_pixels,
        order,
        edges,
        whitener[order],
        derivatives,
        inner,
        gram,
        orthonormal_combinations(gram + np.diag(np.square(found.priors))),
        stated,
        local,
        to_local,
        found.names,
        found.priors,
        found.camera_columns,
        smooth_image_error_model_of_corners(
            o, point.stated.cameras, order, edges, lambda columns: whitener[order] @ columns, local, stated[::2]
        ),
    )


def _add_finder(k: OperatingPoint, found: _Nuisances, at: Integers, whitener: Floats) -> None:
    """Add each camera's bias of edges that small that it is the corner finder's own. at : (n,) rows of corners;
    whitener : (n, 2, 2)
    """
    seen = k.observed
    o, quads = seen.observations, k.pixels(rows=np.arange(len(seen.sightings.frame)))
    for i in sorted(found.camera_columns):
        camera, seen_by = k.stated.cameras[i], seen.sightings.camera == i
        moved = np.zeros_like(quads)
        moved[seen_by] = (
            EDGE_SHIFT.of_numbers(str(Place("camera", camera.name)), [1.0]).print_(camera, quads[seen_by])
            - quads[seen_by]
        )
        rows = np.flatnonzero(o.camera == i)
        found.add(
            at[rows],
            whitener[rows] @ moved[seen.row[rows], o.corner[rows]][..., None],
            camera.name,
            (EDGES,),
            [1 / FINDER.sigma],
        )


def _add_seats(k: OperatingPoint, found: _Nuisances, at: Integers, whitener: Floats) -> None:
    """Add where each cube sits that was put back, as far as remounting may move it. at : (n,) rows of corners;
    whitener : (n, 2, 2)
    """
    o, markers = k.observed.observations, k.observed.markers
    R = k.T.rotation.as_matrix()
    for seat in k.seats:
        own = np.array([seat.at(Place("target", target)) for target in markers.target])
        rows = np.flatnonzero(own[o.marker])
        if not len(rows):
            continue
        part, block = o.take(rows), np.empty((len(rows), 2, 6))
        middle = markers.T_body_marker.translation[own].mean(axis=0)
        for _, some, _, J_base, _, _ in iterate_camera_jacobians(part, k.state):
            block[some] = small_motion_jacobian(
                rotate_jacobian(J_base, R, part.frame[some], part.on_platform[some]), part.points[some] - middle
            )
        found.add(at[rows], whitener[rows] @ block, seat.place, SEAT_LABELS, np.repeat(1 / np.array(SEAT), 3).tolist())


def _own_basis(J_local: Floats, edges: Integers) -> tuple[Floats, Floats]:
    """((2n, L) orthonormal basis of each frame's own poses, (F, L, L) from its coordinates to tangents) of derivatives
    (2n, L).
    """
    frames, L = len(edges) - 1, J_local.shape[1]
    local, to_local = np.zeros(J_local.shape), np.zeros((frames, L, L))
    scale = np.sqrt((J_local**2).sum(axis=0) / frames) + 1e-300
    for f, (a, b) in enumerate(zip(edges[:-1], edges[1:])):
        u, s, vt = np.linalg.svd(J_local[2 * a : 2 * b] / scale, full_matrices=False)
        retained = s > 1e-9 * s[0]
        local[2 * a : 2 * b, : retained.sum()] = u[:, retained]
        to_local[f][:, : retained.sum()] = (vt[retained].T / s[retained]) / scale[:, None]
    return local, to_local


def camera_edge_bias_nuisances(
    nuisance_names: Sequence[tuple[str, str | int]], design: Design
) -> list[tuple[int, int]]:
    """Nuisances that are an edge bias of one camera's images, as [(camera's index, nuisance's index)]."""
    cameras = [camera.name for camera in design.cameras]
    return [(cameras.index(name), j) for j, (name, what) in enumerate(nuisance_names) if what == EDGES]


def remounted_cube_pose_nuisances(nuisance_names: Sequence[tuple[str, str | int]]) -> dict[str, list[int]]:
    """Indices of the six nuisances that are the pose of each remounted cube, {cube's place: indices}."""
    out: dict[str, list[int]] = {}
    for j, (place, what) in enumerate(nuisance_names):
        if what in SEAT_LABELS:
            out.setdefault(place, []).append(j)
    return out


def _weights(o: Observations, k: OperatingPoint) -> Floats:
    """(n, 2, 2) px^2 by which corners count: their covariance, and n times what comes back in all n repeats of a corner
    that stands still.
    """
    if not k.standing:
        return o.covariance
    rows, index, _ = repeated_base_corner_rows_and_groups(o, k.moving)
    weights = o.covariance.copy()
    weights[rows] += (np.bincount(index)[index] * k.standing**2)[:, None, None] * np.eye(2)
    return weights


def repeated_corner_error(point: OperatingPoint) -> float:
    """Repeated corner error, px.

    Standing corners are off by it alike in every frame.
    It is 0 where noise suffices.

    The middle of all of them tells it, so that a marker out of its place or a lens that bends one camera's image does
    not pass for it. See vision.bundle.robust_adjustment.repeated_corner_covariance_and_systematic_error, which asks
    the same of their mean square
    """
    k = point
    if k.seen is None:
        return 0.0
    o = k.observed.observations
    rows, index, _ = repeated_base_corner_rows_and_groups(o, k.moving)
    count = np.bincount(index)
    many = count >= REPEATS
    if many.sum() < STANDING_GROUPS:
        return 0.0
    off = (o.uv - k.pixels())[rows]
    mean = group_sums(off, index) / count[:, None]
    chance = np.median((off - mean[index])[many[index]] ** 2) / MEDIAN / np.median(count[many])
    excess = np.median(mean[many] ** 2) / MEDIAN - chance
    return float(np.sqrt(excess)) if excess > STANDING_PROOF * chance / np.sqrt(many.sum()) else 0.0


def edge_shift_pixel_derivatives(point: OperatingPoint) -> Floats:
    """Derivatives (n, 2, 2) of corner pixels by shifts along the two edges of their marker.

    Per side.
    """
    seen, quads = point.observed, point.pixels(rows=np.arange(len(point.observed.sightings.frame)))
    depth = _depths(quads)
    edges = np.stack(
        [(np.roll(depth, s, axis=1) / depth)[..., None] * (np.roll(quads, s, axis=1) - quads) for s in (-1, 1)], axis=-1
    )  # (s, 4, 2, 2)
    return edges[seen.row, seen.observations.corner]


def _depths(quads: Floats) -> Floats:
    """(s, 4) depths of the corners of squares seen as quads (s, 4, 2), the first one's 1. Source: Heckbert,
    Fundamentals of texture mapping and image warping, 1989, 2.2.3"""
    a, b = quads[:, 1] - quads[:, 2], quads[:, 3] - quads[:, 2]
    skew = quads[:, 0] - quads[:, 1] + quads[:, 2] - quads[:, 3]
    area = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
    g, h = (skew[:, 0] * b[:, 1] - b[:, 0] * skew[:, 1]) / area, (a[:, 0] * skew[:, 1] - skew[:, 0] * a[:, 1]) / area
    return np.stack([np.ones(len(g)), 1 + g, 1 + g + h, 1 + h], axis=1)
