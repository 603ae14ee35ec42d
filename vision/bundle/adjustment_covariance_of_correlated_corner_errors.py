"""Covariance of an adjustment whose corner errors are correlated.

They are correlated within an image, or larger in some places.

The optimum stays where equal and independent errors put it; its covariance is White's, of the errors that its residuals
show (see `pose_covariance_of_correlated_corner_errors`). Where corners err alike at the same place of a camera's image
in every frame, as under a lens that is not as it was adjusted, no number of frames averages that: cameras and poses
follow it, and what they cannot follow stays in the residuals. From there the errors are estimated, along polynomials of
the place, each camera's of the likeliest size (Patterson and Thompson, Biometrika 58, 1971, 545-554); what they move
poses by is part of what all frames share.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import minimize

from rig.array_and_json_types import Booleans, Floats, Integers
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    POSE_SCALE,
    Unknowns,
    estimate_offset_from_stated,
)
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import adjustment_unknowns_and_start_estimate
from vision.bundle.bundle_adjustment import Adjustment
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    Derivatives,
    whitened_residuals_and_derivatives,
)
from vision.bundle.pose_covariance_of_correlated_corner_errors import (
    image_places_and_smooth_error_columns,
    own_and_smooth_corner_error_variances,
    pose_covariance_from_corner_error_variances,
    smooth_image_error_model_of_corners,
)
from vision.corner_observations_and_merging import Observations, whitener_of_observations

PROOF = 30.0  # twice the logarithm of the likelihood by which errors common to all frames must be likelier than none
WEAK = 1e-2  # of the greatest information; combinations that adjusting takes up nearly whole say too little of errors
ALONG = 1e-9  # of the greatest mean square of columns; combinations of less are rounding
SIZES, START = (1e-4, 3.0), 0.03  # px, of a camera's errors; and where their search begins


@dataclass(frozen=True, slots=True, eq=False)
class _CornerRows:
    """Whitened derivatives of n corners, frame by frame and camera by camera.

    order : (n,) of the observations; edges : (F + 1,) where frames begin in it; place : (n,) of each observation in it
    own : (n, 2, l) to the unknowns of a corner's frame; root : (F, l, l) inverse Cholesky factors of their information
    """

    order: Integers
    edges: Integers
    place: Integers
    own: Floats
    root: Floats

    def basis(self) -> Floats:
        """(2n, l) orthonormal basis of each frame's own unknowns."""
        out = np.empty((2 * len(self.order), self.own.shape[2]))
        for f, (a, b) in enumerate(zip(self.edges[:-1], self.edges[1:])):
            out[2 * a : 2 * b] = self.own[a:b].reshape(2 * (b - a), -1) @ self.root[f].T
        return out


@dataclass(frozen=True, slots=True, eq=False)
class _Corners:
    """n corners of an adjustment, frame by frame and camera by camera.

    rows : _CornerRows; basis : (2n, l) as they have it; shared_rows : yields of each frame ((2m, s) whitened
    derivatives to what frames share, the frame's own unknowns taken out, the slice of its corners)
    camera : (n,) index; residual : (2n,) whitened; own : (n,) whether a corner's covariance is that of its own errors
    pixels : (n, 2, K) px of errors along the place in the image; columns : the same whitened
    pull : (s,) of what is stated of the shared unknowns, on their gradient
    """

    rows: _CornerRows
    basis: Floats
    shared_rows: Callable[[], Iterator[tuple[Floats, slice]]]
    camera: Integers
    residual: Floats
    own: Booleans
    pixels: Floats
    columns: Floats
    pull: Floats


def adjustment_with_correlated_error_covariance(
    observations: Observations, adjustment: Adjustment, own: Booleans
) -> Adjustment:
    """The Adjustment with the covariance that unlike corner errors give it.

    It is as it was where they are equal and independent, or too few to show otherwise.
    observations : Observations that were adjusted; own : (n,) whether a corner's covariance is that of its own errors
    alone
    Errors of one frame move its pose and, a little, what all frames share: both are taken as independent.
    """
    u, estimate = adjustment_unknowns_and_start_estimate(
        observations, adjustment.state, adjustment.stated, adjustment.free, printing=adjustment.printing
    )
    whitener = whitener_of_observations(observations)
    residual, derivatives = whitened_residuals_and_derivatives(observations, estimate, u, whitener)
    rows, cameras = _rows(observations, derivatives, u), adjustment.state.cameras

    def whiten(columns: Floats) -> Floats:
        return whitener.mix(whitener.own @ columns[rows.place], slice(None))[rows.order]

    basis = rows.basis()
    errors = smooth_image_error_model_of_corners(
        observations, cameras, rows.order, rows.edges, whiten, basis, own[rows.order]
    )
    taken = np.sqrt((2 * len(observations) - u.used.sum()) / adjustment.dof)  # of the residuals by what frames share
    sizes = own_and_smooth_corner_error_variances(errors, taken * residual[rows.order].ravel(), rows.edges)
    # corners whose covariance is not their own see the same air; places as predicted, which corners' own errors do not
    # move: these would show themselves along any columns that spread
    predicted = replace(observations, uv=observations.uv - adjustment.residuals)
    pixels = image_places_and_smooth_error_columns(predicted, cameras, rows.order)[1]
    columns = whiten(pixels)
    shared_rows = partial(_shared_rows_without_own, observations, derivatives, rows, basis, u)
    corners = _Corners(
        rows,
        basis,
        shared_rows,
        observations.camera[rows.order],
        residual[rows.order].ravel(),
        own[rows.order],
        pixels,
        columns,
        u.prior * estimate_offset_from_stated(estimate, adjustment.stated, u),
    )
    if sizes is None:
        return _with_common_image_errors(adjustment, adjustment, corners, u.scale)
    white, smooth = np.where(own[rows.order], sizes[0], 1.0), sizes[1]
    spread = pose_covariance_from_corner_error_variances(errors, white, smooth, basis, rows.edges)
    given = (np.swapaxes(rows.root, 1, 2) @ spread @ rows.root)[:, :6, :6] * POSE_SCALE**2
    factor = adjustment.shared_factor / u.scale[:, None]
    scatter = np.diag(u.prior)
    for rest, at in shared_rows():
        scatter += rest.T @ (np.repeat(white[at], 2)[:, None] * rest)
        for image in np.unique(corners.camera[at]):
            some = corners.camera[at] == image
            along = rest[np.repeat(some, 2)].T @ columns[at][some].reshape(2 * some.sum(), -1)
            scatter += along @ smooth @ along.T
    turn = np.linalg.cholesky(factor.T @ scatter @ factor)
    widened = replace(
        adjustment,
        platform_given_cameras=given,
        platform_common=adjustment.platform_common @ turn,
        shared_factor=adjustment.shared_factor @ turn,
    )
    return _with_common_image_errors(widened, adjustment, corners, u.scale)


def _rows(observations: Observations, derivatives: dict[int, Derivatives], u: Unknowns) -> _CornerRows:
    order = np.lexsort((observations.camera, observations.frame))
    edges = np.searchsorted(observations.frame[order], np.arange(len(observations.frames) + 1))
    place = np.argsort(order)
    own = np.zeros((len(order), 2, u.local))
    for found in derivatives.values():
        own[place[found.rows][:, None, None], np.arange(2)[:, None], found.own_columns] = found.own
    local = np.array([np.einsum("nij,nik->jk", own[a:b], own[a:b]) for a, b in zip(edges[:-1], edges[1:])])
    local[:, np.arange(u.local), np.arange(u.local)] += ~u.used
    return _CornerRows(order, edges, place, own, np.linalg.inv(np.linalg.cholesky(local)))


def _shared_rows_without_own(
    observations: Observations, derivatives: dict[int, Derivatives], rows: _CornerRows, basis: Floats, u: Unknowns
) -> Iterator[tuple[Floats, slice]]:
    """Yield of each frame ((2m, s) derivatives to what frames share, the frame's own unknowns taken out, where its
    corners stand in the order).
    """
    for a, b in zip(rows.edges[:-1].tolist(), rows.edges[1:].tolist()):
        at, out = rows.order[a:b], np.zeros((b - a, 2, u.shared))
        for i in np.unique(observations.camera[at]).tolist():
            mine, found = np.flatnonzero(observations.camera[at] == i), derivatives[i]
            columns = found.shared_columns[observations.marker[at[mine]]]
            out[mine[:, None, None], np.arange(2)[:, None], columns[:, None]] = found.shared[
                at[mine] - found.rows.start
            ]
        rest, own = out.reshape(2 * (b - a), -1), basis[2 * a : 2 * b]
        yield rest - own @ (own.T @ rest), slice(a, b)


def _with_common_image_errors(
    adjustment: Adjustment, plain: Adjustment, corners: _Corners, scale: Floats
) -> Adjustment:
    """The Adjustment with what errors common to all frames add to its covariance; as it was where corners show none.

    plain : Adjustment by equal and independent errors; scale : (s,) of the shared unknowns
    """
    cameras, width = len(adjustment.state.cameras), corners.columns.shape[2]
    basis, count, shared = corners.basis, cameras * width, len(scale)
    factor = plain.shared_factor / scale[:, None]
    even = np.array([_unit_mean_square(corners.pixels[corners.camera == i]) for i in range(cameras)])
    columns = corners.columns @ even[corners.camera]
    onto, information = np.zeros((shared, count)), np.zeros((count, count))
    of_repeats = np.zeros((count + shared, count + shared))
    scores, repeats, moved = [], np.zeros(count + shared), []
    for f, (rest, at) in enumerate(corners.shared_rows()):
        rows = slice(2 * at.start, 2 * at.stop)
        B = np.zeros((rest.shape[0] // 2, 2, cameras, width))
        B[np.arange(len(B)), :, corners.camera[at]] = columns[at]
        B = B.reshape(-1, count)
        along = basis[rows].T @ B
        moved.append(POSE_SCALE * (corners.rows.root[f].T @ along)[:6])
        both = np.concatenate([B - basis[rows] @ along, rest], axis=1)
        onto += rest.T @ both[:, :count]
        information += both[:, :count].T @ both[:, :count]
        single = np.repeat(corners.own[at], 2)
        scores.append(both[single].T @ corners.residual[rows][single])
        repeats += both[~single].T @ corners.residual[rows][~single]
        of_repeats += both[~single].T @ both[~single]
    follow = factor @ (factor.T @ onto)  # of the shared unknowns, per px
    reduce = np.concatenate([np.eye(count), -follow])
    information -= onto.T @ follow
    size, turn = np.linalg.eigh(information)
    if size[-1] <= 0:
        return adjustment
    turn, size = turn[:, size > WEAK * size[-1]], size[size > WEAK * size[-1]]
    to_unit = reduce @ turn / np.sqrt(size)
    by_frame = np.array(scores) @ to_unit
    # what stated figures pull is no corner's error
    seen = by_frame.sum(axis=0) + (repeats - np.r_[np.zeros(count), corners.pull]) @ to_unit
    apart = by_frame - by_frame.mean(axis=0)
    spread, axes = np.linalg.eigh(apart.T @ apart + to_unit.T @ of_repeats @ to_unit)
    noise = (axes * np.maximum(spread, 1.0)) @ axes.T  # frames scatter by no less than equal errors make them
    found = _common_errors(np.sqrt(size)[:, None] * turn.T, seen, noise, cameras)
    if found is None:
        return adjustment
    mean, posterior = found
    squares, axes = np.linalg.eigh(np.outer(mean, mean) + posterior)
    draws = axes * np.sqrt(np.maximum(squares, 0.0))  # what is well determined may be negative by rounding
    poses = np.array(moved) + plain.platform_common @ (factor.T @ onto)
    return replace(
        adjustment,
        platform_common=np.concatenate([adjustment.platform_common, poses @ draws], axis=2),
        shared_factor=np.concatenate([adjustment.shared_factor, scale[:, None] * follow @ draws], axis=1),
        common_image_errors=_sizes_by_camera(corners, (even @ mean.reshape(cameras, width, 1))[..., 0]),
    )


def _unit_mean_square(pixels: Floats) -> Floats:
    """(K, K) by which columns (n, 2, K) px become such that are orthogonal over the corners, of 1 px RMS each; none for
    combinations that so few places cannot tell from others."""
    flat = pixels.reshape(-1, pixels.shape[2])
    squares, axes = np.linalg.eigh(flat.T @ flat / max(len(pixels), 1))
    apart = squares > ALONG * max(squares[-1], ALONG)
    return axes * np.where(apart, 1 / np.sqrt(np.where(apart, squares, 1.0)), 0.0)


def _common_errors(model: Floats, seen: Floats, noise: Floats, cameras: int) -> tuple[Floats, Floats] | None:
    """(mean (w,), covariance (w, w) px of errors along the columns, given what is seen (r,) = model (r, w) errors with
    a noise (r, r)), each camera's of a size of its own, the likeliest; None where none are likely."""
    by_camera = model.reshape(len(seen), cameras, -1)
    each = np.einsum("rck,sck->crs", by_camera, by_camera)

    def cost(log_sizes: Floats) -> float:
        root = np.linalg.cholesky(noise + np.einsum("c,crs->rs", np.exp(2 * log_sizes), each))
        return float(2 * np.log(np.diag(root)).sum() + (np.linalg.solve(root, seen) ** 2).sum())

    start = np.where(np.trace(each, axis1=1, axis2=2) > 0, START, SIZES[0])  # of what is not seen nothing is assumed
    found = minimize(cost, np.log(start), method="L-BFGS-B", bounds=[np.log(SIZES)] * cameras)
    if cost(np.full(cameras, -np.inf)) - found.fun < PROOF:
        return None
    prior = np.repeat(np.exp(2 * found.x), by_camera.shape[2])
    gain = prior[:, None] * model.T @ np.linalg.inv(noise + (model * prior) @ model.T)
    return gain @ seen, np.diag(prior) - gain @ (model * prior)


def _sizes_by_camera(corners: _Corners, errors: Floats) -> tuple[float, ...]:
    """Px RMS of each camera's errors (C, K) over its corners."""
    pixels = [corners.pixels[corners.camera == i] @ one for i, one in enumerate(errors)]
    return tuple(float(np.sqrt(np.mean(px**2))) if px.size else 0.0 for px in pixels)
