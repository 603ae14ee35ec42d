"""Simultaneous fit of cameras and geometry to corners.

Cameras, lenses and hexapod geometry, and the correction refined by it.

No frame has unknowns of its own: its pose is the forward kinematics of its command. Two steps (poses first,
parameters after, calib/models/platform/platform_identification.py) agree with this to second order where the poses'
shared errors are solved for with the parameters, and fall behind it where they are pooled with the poses' own.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.correction.interpolation.gaussian_process_interpolation import Radial
from calib.correction.machine_correction import Correction
from calib.identify.bounded_and_robust_least_squares_fit import Linear, fit_least_squares
from calib.models.platform.platform_identification import PRIOR, Identified, pose_parameter_jacobian
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.design import Camera, Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod as mechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    geometric_parameters,
    mechanism_with_parameters,
    require_hexapod,
)
from rig.model.pose import exp, skew
from vision import opencv_lens_model as lens
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import stated_lens_prior_sigmas
from vision.corner_observations_and_merging import Observations
from vision.marker_corner_prediction import (
    State,
    base_points_in_camera_frame,
    iterate_observed_cameras,
    observed_points_base,
)
from vision.recording_adjustment_with_hand_and_stages import Measurement


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """mechanism : Hexapod as fitted; cameras : as fitted; covariance : (42, 42) m^2 of the parameters, cameras' and
    lenses' included;
    root : (42, 42) 1/m, square root of the information in the corners and the lens priors; residuals : (n, 2)
        whitened"""

    mechanism: Hexapod
    cameras: tuple[Camera, ...]
    covariance: Floats
    root: Floats
    residuals: Floats


def fit_cameras_and_geometry(
    observations: Observations,
    commanded: Floats,
    state: State,
    stated: tuple[Camera, ...],
    nominal: Hexapod,
    start: Hexapod | None = None,
) -> Joint:
    """Simultaneous fit of cameras and geometry to corners of commanded frames.

    Every camera fixed.
    observations : Observations, outliers taken out, covariance to weigh by; commanded : (F, 6) m of its frames
    state : State to start from (cameras as adjusted); stated : Cameras as their owner has them, the lenses' prior
    nominal : Hexapod, the geometry's prior (5 mm); start : Hexapod to start from, nominal by default
    Raises RigError for moving cameras or base targets that are not there.
    """
    if state.moving:
        raise RigError("a joint solve requires fixed cameras; moving ones are located frame by frame")
    if observations.on_platform.all():
        raise RigError("a joint solve requires targets on the base: without them the base frame is undefined")
    whitener = np.linalg.inv(np.linalg.cholesky(observations.covariance))
    sizes = [6 + len(stated_lens_prior_sigmas(camera)) for camera in stated]
    starts = 42 + np.r_[0, np.cumsum(sizes)]
    mean = np.concatenate([geometric_parameters(nominal), *[np.r_[np.zeros(6), _lens(c)] for c in stated]])
    sigma = np.concatenate(
        [np.full(42, PRIOR), *[np.r_[np.full(6, np.inf), stated_lens_prior_sigmas(c)] for c in stated]]
    )
    begin = np.concatenate(
        [
            geometric_parameters(nominal if start is None else start),
            *[np.r_[np.zeros(6), _lens(c)] for c in state.cameras],
        ]
    )
    guess = [state.platform]

    def at(p: Floats) -> State:
        cameras = tuple(_camera(c, p[a : a + size]) for c, a, size in zip(state.cameras, starts, sizes))
        guess[0] = mechanism.forward(commanded, mechanism_with_parameters(nominal, p[:42]), guess[0])
        return State(cameras, guess[0], {})

    def linearise(p: Floats) -> Linear:
        now = at(p)
        residual, J = np.empty((len(observations), 2)), np.zeros((len(observations), 2, len(p)))
        base, J_pose = (
            observed_points_base(observations, now),
            pose_parameter_jacobian(now.platform, mechanism_with_parameters(nominal, p[:42])),
        )
        R_platform = now.platform.rotation.as_matrix()
        for i, camera, rows in iterate_observed_cameras(observations, now):
            frame, on = observations.frame[rows], observations.on_platform[rows]
            ahead = base_points_in_camera_frame(base[rows], frame, now, i)
            uv, J_point, J_lens = lens.projected_pixels_and_jacobians(ahead, camera.matrix, camera.distortion)
            W = whitener[rows]
            residual[rows] = (W @ (observations.uv[rows] - uv)[..., None])[..., 0]
            J_point = W @ J_point
            turned = J_point[on] @ (camera.pose.rotation.as_matrix().T @ R_platform[frame[on]])
            of_pose = np.concatenate([turned, -turned @ skew(observations.points[rows][on])], axis=-1)
            start = rows.start + np.flatnonzero(on)
            J[start, :, :42] = of_pose @ J_pose[frame[on]]
            J[rows, :, starts[i] : starts[i] + 6] = np.concatenate([-J_point, J_point @ skew(ahead)], axis=-1)
            J[rows, :, starts[i] + 6 : starts[i + 1]] = W @ J_lens
        return Linear(residual, J, np.zeros((len(observations), 2, 0)))

    order = np.r_[42 : len(begin), :42]  # the geometry last, so that its block of the triangle is what is left to it

    def ordered(p: Floats) -> Linear:
        now = linearise(p[np.argsort(order)])
        return Linear(now.residual, now.jacobian[..., order], now.common)

    found = fit_least_squares(ordered, begin[order], mean[order], sigma[order])
    p = found.parameters[np.argsort(order)]
    done = at(p)
    return Joint(
        mechanism_with_parameters(nominal, p[:42]),
        done.cameras,
        found.covariance[-42:, -42:],
        found.root[-42:, -42:],
        found.residual,
    )


def inputs_of_camera_and_geometry_fit(measured: Measurement, samples: Samples) -> tuple[Observations, Floats, State]:
    """Inputs of the simultaneous camera and geometry fit.

    measured : vision Measurement; samples : Samples of it
    Returns (Observations, commanded (F, 6) m, State) in the commanded frames
    """
    used = measured.used()
    keep = np.isin(used.frames, samples.frame)
    rows = keep[used.frame]
    retained = replace(used.take(rows), frames=used.frames[keep], frame=(np.cumsum(keep) - 1)[used.frame[rows]])
    commanded = samples.effective[np.searchsorted(samples.frame, retained.frames)]
    return (
        retained,
        commanded,
        State(measured.adjustment.state.cameras, measured.T_base_platform[np.flatnonzero(keep)], {}),
    )


def _lens(camera: Camera) -> Floats:
    return np.r_[camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2], camera.distortion]


def _camera(camera: Camera, q: Floats) -> Camera:
    """The camera moved by the tangent q[:6] with the lens q[6:]."""
    fx, fy, cx, cy = q[6:10]
    return replace(
        camera, pose=camera.pose * exp(q[:6]), matrix=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), distortion=q[10:]
    )


def refine_correction_with_cameras(
    sampled: Sampled, design: Design, correction: Correction[Parallel, Radial], identified: Identified
) -> tuple[Correction[Parallel, Radial], Identified]:
    """Correction refined with cameras, by a simultaneous fit to a recording's corners.

    sampled : Sampled; design : Design as stated; correction, found : as `calibrate` gives them
    Returns (Correction, Identified)
    Raises RigError for a machine that is not a hexapod, for poses that no camera saw, or where struts
    scatter, so that a command does not give a frame's pose
    """
    if sampled.measurement is None:
        raise RigError(f"a joint solve requires corners or images; these poses came from {sampled.source}")
    if identified.scatter.any():
        i = int(np.argmax(identified.scatter))
        raise RigError(
            f"a joint solve requires struts that follow their commands; strut {i + 1} scatters by "
            f"{identified.scatter[i] * 1e6:.1f} um beyond the poses"
        )
    corners, commanded, state = inputs_of_camera_and_geometry_fit(
        sampled.measurement, sampled.samples.take(identified.inliers)
    )
    done = fit_cameras_and_geometry(
        corners,
        commanded - correction.rho(commanded),
        state,
        design.cameras,
        require_hexapod(correction.nominal),
        require_hexapod(identified.mechanism),
    )
    return replace(correction, fitted=done.mechanism), replace(
        identified, mechanism=done.mechanism, covariance=done.covariance, root=done.root
    )
