"""Smooth functions of struts, cameras and markers.

They have no name, and are functions of pose, time, history, speed and sensors.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import null_space

from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    axis_speeds,
    centred_and_scaled_to_plus_minus_one,
    scaled_powers,
    time_cosines,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel, linearise
from calib.diagnosis.problems.platform.linearised_corners import edge_shift_pixel_derivatives
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import camera_mount_pixel_derivatives
from rig.array_and_json_types import Floats, Integers
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import image_warp_columns
from rig.model.pose import pose_difference

SLOW, FAST = 8, 24  # cosines of a smooth function of time
WARP = 6  # degree of a smooth warp of an image
ROUNDS = 3  # of taking what smooth functions explain off the corners
SEEN = 1e-3  # share of a function's square that the nuisances must leave for it to be taken off


def strut_deviation_basis_functions_by_covariate(point: OperatingPoint) -> list[tuple[str, list[tuple[Place, Floats]]]]:
    """Smooth basis functions of strut deviations by what they depend on, at an OperatingPoint.

    Returns [(depends on, [(place, (F, axes, q) m)])]
    """
    F, ones = len(point.t), np.ones(point.axes)
    bases = [
        ("pose", _alike(_pose(point), ones)),
        ("time", _alike(time_cosines(point.t, SLOW), ones)),
        ("time", _alike(time_cosines(point.t, FAST), ones)),
    ]
    for name, values, times in (
        ((n, v, point.sensors.t) for n, v in point.sensors.channels.items()) if point.sensors is not None else ()
    ):
        series = np.interp(point.t, times, values)
        if np.ptp(series) > 0:
            bases.append((name, _alike(scaled_powers(series, 2), ones)))
    motion = point.motion(())
    lengths, last_direction = motion.lengths, motion.path.direction
    for j in range(point.axes):
        bases.append((f"strut {j + 1}'s position", _alike(scaled_powers(lengths[:, j], 4), ones)))
    scaled = np.stack([centred_and_scaled_to_plus_minus_one(column) for column in lengths.T], axis=1)
    bases.append(("history", np.stack([last_direction, last_direction * scaled], axis=2)))
    travel = motion.path.way
    if np.ptp(travel, axis=0).min(initial=np.inf) > 0:
        bases.append(("way travelled", np.stack([scaled_powers(column, 2) for column in travel.T], axis=1)))
    pace = axis_speeds(point.commanded, point.t)
    speeds = np.stack([pace, pace * np.abs(pace) / max(np.abs(pace).max(), 1e-300)], axis=2)
    if pace.any():
        bases.append(("speed", speeds))
    out = []
    for depends, functions in bases:  # (F, axes, q), each strut's own
        strutwise = []
        for i in range(point.axes):
            weights = np.zeros((F, point.axes, functions.shape[2]))
            weights[:, i] = functions[:, i]
            strutwise.append((point.places[i], weights))
        out.append((depends, strutwise))
    if pace.any():
        out.append(("speed", [(Place("rig"), speeds)]))
    return out


def camera_mount_and_focal_pixel_derivatives(model: LinearisedModel, camera: Place) -> Floats:
    """Derivatives (n, 2, 7) of corner pixels by a camera's mount and focal length.

    By the tangent of the mount and by the focal length's share.
    """
    k = model.point
    o = k.observed.observations
    i = _camera_index(k, camera)
    rows, out = o.camera == i, np.zeros((len(o), 2, 7))
    out[..., :6] = camera_mount_pixel_derivatives(model, camera)
    out[rows, :, 6] = k.pixels()[rows] - k.design.cameras[i].matrix[:2, 2]
    return out


def _camera_index(k: OperatingPoint, place: Place) -> int:
    return [c.name for c in k.design.cameras].index(place.name)


def mount_and_focal_length_time_cosines(point: OperatingPoint, count: int) -> Floats:
    """Cosines of time (F, 7, 7 count) for each parameter of a camera's mount and focal length."""
    return np.einsum("fk,ab->fabk", time_cosines(point.t, count), np.eye(7)).reshape(len(point.t), 7, -1)


def image_warp_pixel_derivatives(point: OperatingPoint, camera: int) -> Floats:
    """Derivatives (n, 2, q) of corner pixels by smooth warps of a camera's image.

    At predicted pixels: where corners are seen holds their noise.
    """
    rows = point.observed.observations.camera == camera
    moved = image_warp_columns(point.design.cameras[camera], point.pixels()[rows], WARP)
    pixels = np.zeros((len(rows), *moved.shape[1:]))
    pixels[rows] = moved
    return pixels


def _marker_pixels(k: OperatingPoint, ids: Integers) -> Floats:
    """(n, 2, 8 len(ids)) px of corners: each corner of each marker moved along its two edges, per side."""
    edges = edge_shift_pixel_derivatives(k)
    out = np.zeros((len(edges), 2, 8 * len(ids)))
    for j, number in enumerate(ids):
        rows, moved = corner_rows_and_shift_pixel_derivatives(k, edges, number)
        out[rows, :, 8 * j : 8 * j + 8] = moved
    return out


def corner_rows_and_shift_pixel_derivatives(
    point: OperatingPoint, edges: Floats, marker: int
) -> tuple[Integers, Floats]:
    """Derivatives (h, 2, 8) of one marker's corner pixels by shifts of corners along its edges, with rows (h,).

    Edges as `edge_shift_pixel_derivatives` has them.
    """
    seen = point.observed
    rows = np.flatnonzero((seen.markers.id == marker)[seen.sightings.marker][seen.row])
    corner, out = seen.observations.corner[rows], np.zeros((len(rows), 2, 8))
    for c in range(4):
        out[corner == c, :, 2 * c : 2 * c + 2] = edges[rows[corner == c]]
    return rows, out


def _distortions() -> Floats:
    """(8, 5) of what `_marker_pixels` moves a marker's corners by: what no shift nor turn of the marker in its plane
    does, which is no printing.
    """
    corners = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
    edges = np.stack([np.roll(corners, s, axis=0) - corners for s in (-1, 1)], axis=1)
    rigid = np.stack([np.tile([1.0, 0.0], (4, 1)), np.tile([0.0, 1.0], (4, 1)), corners[:, ::-1] * [-1, 1]], axis=-1)
    return null_space(np.einsum("csd,cdr->csr", edges, rigid).reshape(8, 3).T)


def smooth_function_pixels_and_weights(
    model: LinearisedModel, lacks_of_fit: list[LackOfFit], whole: bool
) -> tuple[Floats | None, Floats | None]:
    """Pixel columns, and weights at axes, of the smooth functions of a lack of fit.

    At all struts where it is struts, at all markers where it is one, else at the cameras themselves.
    whole : whether they are to stand beside a law of the whole machine, which such functions at all struts would
        replace: then at the struts alone where the lack of fit is

    Returns (pixels (n, 2, q) or None, weights (F, axes, r) or None)
    """
    k = model.point
    weights = (
        {
            depends: strutwise
            for depends, strutwise in strut_deviation_basis_functions_by_covariate(k)
            if len(strutwise) == k.axes
        }
        if k.axes
        else {}
    )  # the finest of each
    named: dict[str, set[Place]] = {}
    for u in lacks_of_fit:
        for d in u.depends_on if u.place.kind in ("strut", "rig") else ():
            named.setdefault("pose" if d.endswith("position") else d, set()).add(u.place)
    parts = [
        w
        for d in sorted(named.keys() & weights.keys())
        for place, w in weights[d]
        if not whole or any(one.includes(place) for one in named[d])
    ]
    pixels = []
    for u in lacks_of_fit:
        at = u.place
        if at.kind in ("camera", "cameras") and u.depends_on == ("time",):
            shapes = mount_and_focal_length_time_cosines(k, FAST)[k.observed.observations.frame]
            pixels.append(np.einsum("nca,nak->nck", camera_mount_and_focal_pixel_derivatives(model, at), shapes))
        elif at.kind in ("camera", "cameras") and u.depends_on == ("image position",):
            pixels.append(image_warp_pixel_derivatives(k, _camera_index(k, at)))
    if any(u.place.kind in ("marker", "markers") for u in lacks_of_fit):
        ids = np.unique(k.observed.markers.id[k.observed.sightings.marker])
        pixels.append(_marker_pixels(k, ids) @ np.kron(np.eye(len(ids)), _distortions()))
    return np.concatenate(pixels, axis=2) if pixels else None, np.concatenate(parts, axis=2) if parts else None


def model_with_smooth_functions(
    model: LinearisedModel, pixels: Floats | None, weights: Floats | None
) -> LinearisedModel:
    """LinearisedModel with smooth functions among its nuisances.

    pixels (n, 2, q) and weights (F, axes, r) as `smooth_function_pixels_and_weights` gives them
    What the functions explain is first taken off the pictures, so that corners far off, which count for less, do not
    keep their misfit.
    """
    if pixels is not None:
        for _ in range(ROUNDS):
            o = model.point.observed.observations
            found = model.linear.project(model.fold(pixels))
            K, b, G = found.onto, found.right, found.gram
            scale = np.sqrt(np.diag(G) + (K**2).sum(axis=0)) + 1e-300
            values, vectors = np.linalg.eigh(G / scale[:, None] / scale)
            retained = values > SEEN
            moved = pixels @ (
                vectors[:, retained] @ ((vectors[:, retained].T @ (b / scale)) / values[retained]) / scale
            )
            seen = replace(model.point.observed, observations=replace(o, uv=o.uv - moved))
            model = linearise(replace(model.point, seen=seen))
        model = model.marginalise(model.fold(pixels))
    return model if weights is None else model.marginalise(model.lengthened(weights))


def _alike(basis: Floats, ones: Floats) -> Floats:
    """(F, axes, q): the same functions (F, q) at every strut."""
    return ones[None, :, None] * basis[:, None, :]


def _pose(k: OperatingPoint) -> Floats:
    """(F, q) polynomials of the pose up to the second degree, and pure cubes, of what lies between it and its mean."""
    x = pose_difference(k.T.mean(), k.T)
    x = x / np.maximum(np.abs(x).max(axis=0), 1e-300)
    pairs = [x[:, i] * x[:, j] for i in range(6) for j in range(i, 6)]
    return np.column_stack([x, *pairs, x**3])
