"""Covariance of an adjustment whose corner errors are correlated within an image, or larger in some places.

The optimum stays where equal and independent errors put it; its covariance is White's, of the errors that its residuals
show (see `pose_covariance_of_correlated_corner_errors`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Integers
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import POSE_SCALE, Unknowns
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import adjustment_unknowns
from vision.bundle.bundle_adjustment import Adjustment
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    Derivatives,
    whitened_residuals_and_derivatives,
)
from vision.bundle.pose_covariance_of_correlated_corner_errors import (
    own_and_smooth_corner_error_variances,
    places_and_smooth_columns,
    pose_covariance_from_corner_error_variances,
    smooth_image_error_model_of_corners,
)
from vision.corner_observations import Observations, whitener_of_observations


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


def with_covariance_of_unlike_errors(observations: Observations, adjustment: Adjustment, own: Booleans) -> Adjustment:
    """The Adjustment with the covariance that errors of its corners give it; as it was where they are equal and
    independent, or too few to show otherwise.

    observations : Observations that were adjusted; own : (n,) whether a corner's covariance is that of its own errors
    alone
    Errors of one frame move its pose and, a little, what all frames share: both are taken as independent.
    """
    u, estimate = adjustment_unknowns(
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
    if sizes is None:
        return adjustment
    white, smooth = np.where(own[rows.order], sizes[0], 1.0), sizes[1]
    spread = pose_covariance_from_corner_error_variances(errors, white, smooth, basis, rows.edges)
    given = (np.swapaxes(rows.root, 1, 2) @ spread @ rows.root)[:, :6, :6] * POSE_SCALE**2
    factor = adjustment.shared_factor / u.scale[:, None]
    # corners whose covariance is not their own see the same air
    columns = whiten(places_and_smooth_columns(observations, cameras, rows.order)[1]).reshape(len(basis), -1)
    scatter = np.diag(u.prior)
    for rest, at in _shared_rows_without_own(observations, derivatives, rows, basis, u):
        scatter += rest.T @ (np.repeat(white[at], 2)[:, None] * rest)
        for image in np.unique(observations.camera[rows.order[at]]):
            some = np.repeat(observations.camera[rows.order[at]] == image, 2)
            along = rest[some].T @ columns[2 * at.start : 2 * at.stop][some]
            scatter += along @ smooth @ along.T
    turn = np.linalg.cholesky(factor.T @ scatter @ factor)
    return replace(
        adjustment,
        platform_given_cameras=given,
        platform_common=adjustment.platform_common @ turn,
        shared_factor=adjustment.shared_factor @ turn,
    )


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
