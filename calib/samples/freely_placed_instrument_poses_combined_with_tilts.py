"""Platform poses of a freely placed instrument, combined with tilt sensor readings.

The instrument stands anywhere. Where it stands, and where its target sits, is found by the stated machine at the
commands. What this leaves open, the machine's own parameters take up: its frames are those in which it fits the stated
machine best.

What tilt sensors on a platform add: the two angles against gravity, weighted by their covariance.

How the sensors are mounted, and where gravity points in the frame of poses, are solved for with the errors that all
poses share; what these leave uncertain is shared by all poses again. To first order this is the posterior of normal
errors.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.base_and_link_tilt_sensors import TiltReadings, tilt_residuals_and_jacobians
from rig.model.design import Instrument
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, is_parallel, kinematics_of
from rig.model.pose import adjoint, align_poses, exp, pose, pose_difference
from rig.recording.corner_and_pose_csv_tables import Poses
from rig.recording.recording_folder import Recording

ROUNDS = 5  # of linearising about the poses and the mounting, and of weighing readings
GATE = 6.0  # standard deviations beyond which a reading is left out
GONE = 1e6  # rad, standard deviation of a reading that is left out
UNSTATED = (1e-5, 1e-4)  # m, rad; standard deviations of poses for which nobody states any
FITS = 0.25  # of how far positions lie about their middle; an instrument's place that leaves more (medians) is none
LEVEL = 1.0  # rad; stands for the rotations of a platform that stays level, which were not measured and do not count


def has_translation_only_platform(mechanism: Mechanism) -> bool:
    """Whether a machine's platform only translates.

    It is that of a parallel machine; positions then tell all of it.
    """
    return is_parallel(mechanism) and set(mechanism.pose_coordinates) <= {0, 1, 2}


def pose_covariance(poses: Poses, instrument: Instrument | None, mechanism: Mechanism) -> Floats:
    """Covariance (n, 6, 6) of poses.

    It is their own, or what their instrument states.
    """
    if poses.covariance is not None:
        return poses.covariance
    unknown = LEVEL if has_translation_only_platform(mechanism) else np.inf
    position, rotation = (
        (instrument.position_sigma, instrument.rotation_sigma or unknown) if instrument is not None else UNSTATED
    )
    variances = np.repeat([position**2, rotation**2], 3)
    if instrument is not None and instrument.kind == "distance":
        variances[1:] = np.inf
    if instrument is not None and instrument.kind == "direction":
        variances[5] = np.inf
    return np.broadcast_to(np.diag(variances), (len(poses.frame), 6, 6))


def are_base_and_tool_frames_unknown(instrument: Instrument | None, mechanism: Mechanism) -> tuple[bool, bool]:
    """Whether the frames of a machine's base and tool are unknown.

    They are those of a parallel machine in its instrument's (2 bools).
    Where the base's is, positions alone of a platform that only translates leave the tool's place a part of the base's.
    """
    if instrument is None or not is_parallel(mechanism) or instrument.kind != "pose":
        return False, False
    base, tool = instrument.base == "free", instrument.tool == "free"
    return base, tool and not (base and instrument.rotation_sigma is None)


def recording_in_machine_frames(recording: Recording) -> Recording:
    """Recording with its poses in the machine's own frames.

    It is of a parallel machine whose instrument stands anywhere; any other is as it is. Of several recordings each has
    its own base, and the first one's tool.
    Raises RigError where no place of the instrument fits
    """
    design, poses = recording.design, recording.poses
    m, ends = design.mechanism, are_base_and_tool_frames_unknown(design.instrument, design.mechanism)
    if poses is None or not any(ends) or not is_parallel(m):
        return recording
    assert design.instrument is not None
    known, _, values = recording.commanded()
    predicted = kinematics_of(m).forward(values[np.searchsorted(known, poses.frame)], m)
    rows = 3 if design.instrument.rotation_sigma is None else 6
    number = np.searchsorted([part.frames for part in recording.parts], poses.frame, side="right")
    T, tool = poses.T_base_platform.as_matrix().copy(), RigidTransform.identity()
    for k in np.unique(number):
        own, first = number == k, k == number.min()
        base, turned = align_poses(
            predicted[own], poses.T_base_platform[own] * tool.inv(), (ends[0], ends[1] and first), rows
        )
        tool = turned if first else tool
        found = base.inv() * poses.T_base_platform[own] * tool.inv()
        off = float(np.median(np.linalg.norm(pose_difference(predicted[own], found)[:, :3], axis=1)))
        p = predicted[own].translation
        if off > FITS * float(np.median(np.linalg.norm(p - p.mean(axis=0), axis=1))):
            raise RigError(
                f"{recording.folder}: no place of {' and '.join(n for n, e in zip(('base', 'tool'), ends) if e)} fits: "
                f"{off * 1e3:.3g} mm are left (median). Are these the commands of these poses, in this order and in "
                "metres and radians, and is [mechanism] as the maker states it?"
            )
        T[own] = found.as_matrix()
    turn = adjoint(tool)
    covariance = turn @ pose_covariance(poses, design.instrument, m) @ turn.T
    common = None if poses.common is None else turn @ poses.common
    placed = replace(poses, T_base_platform=RigidTransform.from_matrix(T), covariance=covariance, common=common)
    instrument = replace(design.instrument, base="rig", tool="rig")
    return replace(recording, poses=placed, design=replace(design, instrument=instrument))


def poses_aligned_with_machine(
    T: RigidTransform, predicted: RigidTransform, ends: tuple[bool, bool], translation_only: bool
) -> tuple[RigidTransform, Floats, str]:
    """Poses (n,) aligned with what a calibrated parallel machine predicts.

    Also the (6, 6) transform of their tangents, and a sentence. What the numbers take of the noise is given back.

    ends : which are unknown; translation_only : whether the platform stays level
    """
    base, tool = align_poses(predicted, T, ends, 3 if translation_only else 6)
    numbers, figures = (6 if ends[0] else 3, 3 * len(T)) if translation_only else (6 * sum(ends), 6 * len(T))
    left = pose_difference(predicted, base.inv() * T * tool.inv()) / np.sqrt(1 - min(numbers / figures, 0.9))
    left[:, 3:] *= not translation_only
    line = (
        f"the instrument stands anywhere: {numbers} numbers were estimated from these {len(T)} poses, and what they "
        "took of the noise is given back"
    )
    return predicted * pose(left[:, :3], left[:, 3:]), np.eye(6) if translation_only else adjoint(tool), line


def poses_with_platform_tilts(
    readings: TiltReadings, T: RigidTransform, own: Floats, common: Floats, measured: str = "pose"
) -> tuple[RigidTransform, Floats, Floats]:
    """Poses of a platform with its tilts.

    Measured so, with what tilt sensors on it add.
    own, common : covariance of each pose and factor of what all share; measured : what was, as of Samples
    Readings that scatter more than poses and sensors explain count for less; one that is far off does not count.

    Returns (poses (n,), own (n, 6, 6), common (n, 6, j)) of a platform
    Raises RigError where less than poses was measured
    """
    if measured != "pose":
        raise RigError(
            f"[[tilt_sensor]]s on a platform add to poses, and this recording measures a {measured} alone: leave them "
            "out of rig.toml"
        )
    n, s = len(own), len(readings.sensors)
    sigma = np.where(np.repeat(readings.usable, 2, axis=1), np.repeat([one.sigma for one in readings.sensors], 2), GONE)
    prior = np.r_[readings.mounting_sigma, np.ones(common.shape[2])]
    x, xi, many = np.zeros(len(prior)), np.zeros((n, 6)), len(readings.mounting_sigma)
    for _ in range(ROUNDS):
        R = (T * exp(xi)).rotation.as_matrix()
        left, turns, columns = tilt_residuals_and_jacobians(readings, np.repeat(R[:, None], s, axis=1), x[:many])
        J = np.concatenate([np.zeros((n, 2 * s, 3)), (turns @ R[:, None]).reshape(n, 2 * s, 3)], axis=2)
        N = np.concatenate([columns.reshape(n, 2 * s, -1), J @ common], axis=2)
        r = left.reshape(n, 2 * s) + np.einsum("nij,nj->ni", J, xi) + columns.reshape(n, 2 * s, -1) @ x[:many]
        S = J @ own @ np.swapaxes(J, 1, 2) + np.einsum("ni,ij->nij", sigma**2, np.eye(2 * s))
        W = np.linalg.inv(S)
        H = np.einsum("nia,nij,njb->ab", N, W, N) + np.diag(prior**-2)
        factor = cho_factor(H)
        x = cho_solve(factor, np.einsum("nia,nij,nj->a", N, W, r))
        rest = r - N @ x
        K = own @ np.swapaxes(J, 1, 2) @ W
        xi = np.einsum("nij,nj->ni", K, rest) + common @ x[many:]
        sigma = _weighed(rest, S, sigma, s)
    half = np.linalg.cholesky(cho_solve(factor, np.eye(len(prior))))
    shared = np.pad(common, ((0, 0), (0, 0), (many, 0))) - K @ N
    left_own = own - K @ J @ own
    return T * exp(xi), (left_own + np.swapaxes(left_own, 1, 2)) / 2, shared @ half


def _weighed(rest: Floats, S: Floats, sigma: Floats, sensors: int) -> Floats:
    """(n, 2 s) rad, standard deviations of readings, so far sigma, by what a fit leaves of them, rest (n, 2 s) rad.

    S : (n, 2 s, 2 s) of what it leaves, as expected
    """
    out = sigma.copy()
    for k in range(sensors):
        part = slice(2 * k, 2 * k + 2)
        used = sigma[:, part].max(axis=1) < GONE
        expected = np.sqrt(np.einsum("nii->ni", S[:, part, part]))
        off = np.abs(rest[:, part]) / expected
        scale = max(1.0, 1.4826 * float(np.median(off[used]))) if used.any() else 1.0
        wild = (off > GATE * scale).any(axis=1)
        more = np.sqrt(np.maximum((scale**2 - 1) * np.median(expected[used] ** 2), 0.0)) if used.any() else 0.0
        out[:, part] = np.where((wild | ~used)[:, None], GONE, np.hypot(sigma[:, part], more))
    return out
