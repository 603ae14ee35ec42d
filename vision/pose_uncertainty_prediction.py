"""Prediction of the uncertainty of poses.

Of those not yet measured, and the errors that they share.
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import RigError
from rig.model.design import Design
from rig.model.pose import adjoint
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import POSE_SCALE, Estimate, Unknowns
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    normal_equations,
    schur_complement,
    whitened_residuals_and_derivatives,
)
from vision.corner_observations_and_merging import Observations, whitener_of_observations
from vision.marker_corner_prediction import (
    SQUARE,
    Sightings,
    State,
    is_inside_image,
    predict_sightings,
    sightings_facing_cameras_anywhere,
)
from vision.recording_adjustment_with_hand_and_stages import Measurement, has_hand_cameras

LEAST = 2  # sightings of markers; one alone leaves two poses alike


@dataclass(frozen=True, slots=True, eq=False)
class PredictedUncertainty:
    """seen : (n,) bool, poses of which cameras will see enough, m of them; covariance : (m, 6, 6) of each one's own
    error, m and rad, on the right
    common : (m, 6, k) factor of what they share with each other and, by the same draws, with the poses of the
        Measurement."""

    seen: Booleans
    covariance: Floats
    common: Floats


def predict_pose_uncertainty(
    measured: Measurement, design: Design, T_base_platform: RigidTransform
) -> PredictedUncertainty:
    """Predicted uncertainty of poses (n,) (PredictedUncertainty).

    It is by cameras, lenses and corners' noise as a recording's Measurement has them.
    design : as its owner states it

    Raises RigError for cameras that stand elsewhere in every frame, and where places of markers were adjusted
    """
    if measured.adjustment.unknowns.local_poses or measured.places_free:
        raise RigError(
            "future poses are predicted for fixed or hand-mounted cameras and markers at their stated positions"
        )
    body = T_base_platform.inv() if has_hand_cameras(design) else T_base_platform
    sightings, uv = _sightings(measured, body)
    share = _share(measured)
    seen = share * np.bincount(sightings.frame, minlength=len(body)) >= LEAST
    retained = seen[sightings.frame]
    own, common = _covariances(
        measured, body[seen], sightings.take(retained), uv[retained], (np.cumsum(seen) - 1, share)
    )
    k = measured.common.shape[2]
    rest = common[..., k:]
    covariance, common = own + rest @ np.swapaxes(rest, 1, 2), common[..., :k]
    if has_hand_cameras(design):
        inverted = adjoint(body[seen])
        covariance, common = inverted @ covariance @ np.swapaxes(inverted, 1, 2), -inverted @ common
    return PredictedUncertainty(seen, covariance, common)


def _share(measured: Measurement) -> float:
    """Share of the sightings that the recording's own poses let expect that were there: others had something before
    them.
    """
    found, _ = _sightings(measured, measured.adjustment.state.platform)
    used = measured.used()
    return min(1.0, int((used.on_platform & (used.corner == 0)).sum()) / max(len(found.frame), 1))


def _sightings(measured: Measurement, body: RigidTransform) -> tuple[Sightings, Floats]:
    """(Sightings of the moving body's markers, those measured, at poses (n,), were nothing in the way; their corners
    (k, 4, 2) px), in order.
    """
    a = measured.adjustment
    state, markers = State(a.state.cameras, body, {}, a.state.placed), a.state.placed
    found = sightings_facing_cameras_anywhere(state, markers)
    found = found.take(
        np.isin(found.camera, list(a.unknowns.poses))
        & np.isin(found.marker, a.unknowns.seen)
        & markers.on_platform[found.marker]
    )
    uv = predict_sightings(found, state, markers)
    whole = is_inside_image(found, uv, a.state.cameras)
    found, uv = found.take(whole), uv[whole]
    order = np.lexsort((found.marker, found.frame, found.camera))
    return found.take(order), uv[order]


def _covariances(
    measured: Measurement, body: RigidTransform, sightings: Sightings, uv: Floats, retained: tuple[Integers, float]
) -> tuple[Floats, Floats]:
    """((m, 6, 6) were all that is shared known, (m, 6, s) factor of what that adds) of poses (m,). retained : ((n,)
    number of each frame among them, share of the sightings that are there, so much less each tells)"""
    (number, share), a, m = retained, measured.adjustment, len(body)
    markers, u = a.state.placed, a.unknowns
    sigma2 = float(np.median(np.trace(measured.weights, axis1=1, axis2=2))) / 2 / share
    row, corner = np.repeat(sightings.marker, 4), np.tile(np.arange(len(SQUARE)), len(sightings.marker))
    corners = Observations(
        np.arange(m),
        number[np.repeat(sightings.frame, 4)],
        np.repeat(sightings.camera, 4),
        row,
        corner,
        uv.reshape(-1, 2),
        np.broadcast_to(sigma2 * np.eye(2), (len(row), 2, 2)),
        markers.corners[row, corner],
        markers.on_platform[row],
        True,
    )
    here: Unknowns = replace(u, used=np.ones((m, u.local), bool))
    estimate = Estimate(State(a.state.cameras, body, {}, markers), None, {})
    _, derivatives = whitened_residuals_and_derivatives(corners, estimate, here, whitener_of_observations(corners))
    blocks = normal_equations(corners, derivatives, here, np.zeros(u.shared))
    gain, _, _ = schur_complement(blocks)
    own = np.linalg.inv(blocks.local)[:, :6, :6] * POSE_SCALE**2
    return cast(Floats, own), (gain @ (a.shared_factor / u.scale[:, None]))[:, :6] * POSE_SCALE
