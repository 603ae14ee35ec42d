"""Calibration of measuring limbs, their agreement with vision, and their slips.

Limbs are calibrated against vision, and agreement is on held-out poses; slips of a limb.

The limbs' own joints and zeros are found as the struts' are, from poses that vision measured. Agreement is judged on
poses that were not used for that: bias, scatter, and limits of agreement, axis by axis, against a tolerance that is
stated. Sources: the on-line learning patent for Stewart platforms, [0016]-[0021]; Bland and Altman, Lancet 327, 1986
(limits of agreement).

All poses at once, by the likelihood ratio of every limb and every onset, with geometry and the errors that vision's
poses share solved for beside it. Source: Basseville and Nikiforov, Detection of Abrupt Changes, 1993, ch. 7 (additive
changes, known noise).
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from calib.certification import loop_closure_checks_of_redundant_measuring_limbs
from calib.certification.loop_closure_checks_of_redundant_measuring_limbs import Limbs
from calib.identify.bounded_and_robust_least_squares_fit import time_block_folds
from calib.models.platform.platform_identification import PRIOR, Identified, identify_platform
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import NotEnoughData, RigError
from rig.model.design import Design, MeasuringLimbs
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod as mechanism
from rig.model.mechanisms import redundant_strut_best_six_legs_and_loop_closures
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod
from rig.model.pose import pose_difference, pose_to_vector
from rig.recording.recording_folder import Recording

AXES = ("x", "y", "z", "rx", "ry", "rz")
LONGEST_GAP = 0.5  # s; readings further apart about an exposure say nothing of it
FOLDS = 4  # stretches in time, each judged by limbs that were fitted to the others
COVERAGE = 1.96  # standard deviations: the limits that 95 % of differences keep
MOVES = 20.0  # tolerances over which each axis must move for its agreement to be shown
FEWEST = 20  # poses from which limits of agreement mean anything
TRUST = 1e-6  # share of honest checks that fail


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Limbs less vision on n poses, by axis (x y z rx ry rz, m and rad, in the platform's frame).

    bias, scatter : (6,); limits : (2, 6) lower and upper limit of agreement; proven_limits : (6,) what these stay
        within, with 97.5 %
    expected : (6,) scatter that vision's and the limbs' own covariances account for; moved : (6,) range over which each
        axis went
    tolerance : (6,); passed : (6,) bool
    """

    n: int
    bias: Floats
    scatter: Floats
    limits: Floats
    proven_limits: Floats
    expected: Floats
    moved: Floats
    tolerance: Floats

    @property
    def passed(self) -> Booleans:
        """(6,) bool, whether each axis agrees within its tolerance, shown over a range that says so."""
        return (self.proven_limits <= self.tolerance) & (self.moved >= MOVES * self.tolerance)


def stated_limbs(design: Design) -> MeasuringLimbs:
    """Measuring limbs as rig.toml states them.

    Raises RigError for a rig without [insitu].
    """
    if design.insitu is None:
        raise RigError(
            "rig.toml has no [insitu] table with the measuring limbs' base_joints, platform_joints and length_sigma"
        )
    return design.insitu


def hexapod_of_six_limbs(design: Design, limb_numbers: Integers | None = None) -> Hexapod:
    """Hexapod of six of the measuring limbs as rig.toml has them.

    limb_numbers : (6,) their numbers, from 0, the first six by default
    Raises RigError for a rig without [insitu], with fewer than six limbs, or that is not a hexapod
    """
    limbs = stated_limbs(design)
    hexapod = require_hexapod(design.mechanism, "measuring limbs require a hexapod, not a mechanism of kind {kind!r}")
    return loop_closure_checks_of_redundant_measuring_limbs.leg_set_of_stated_limbs(limbs, hexapod.home).six(
        np.arange(6) if limb_numbers is None else limb_numbers
    )


def frames_and_limb_readings(recording: Recording) -> tuple[Integers, Floats]:
    """Frames of a recording whose exposures have readings of the measuring limbs, and these readings.

    Returns (frames (f,) of exposures with readings, readings (f, limbs) m)
    Raises RigError where sensors.csv lacks a channel, NotEnoughData where no exposure has readings within half a second
    """
    sensors, channels = recording.sensors, stated_limbs(recording.design).channels
    source = (
        f"{recording.folder}: measuring limbs are read from sensors.csv, columns {channels[0]}..{channels[-1]} (m); "
    )
    if sensors is None:
        raise RigError(source + "there is no sensors.csv")
    missing = [name for name in channels if name not in sensors.channels]
    if missing:
        raise RigError(source + f"{missing[0]!r} is missing")
    frames, t = recording.exposures.times()
    after = np.clip(np.searchsorted(sensors.t, t), 1, len(sensors.t) - 1)
    exact = np.isclose(sensors.t[after], t, atol=1e-6) | np.isclose(sensors.t[after - 1], t, atol=1e-6)
    good = exact | (
        (sensors.t[after] - sensors.t[after - 1] <= LONGEST_GAP) & (sensors.t[0] <= t) & (t <= sensors.t[-1])
    )
    if not good.any():
        raise NotEnoughData(
            f"{recording.folder}: none of {len(t)} exposures has readings of the limbs within "
            f"{LONGEST_GAP:g} s before and after it"
        )
    return frames[good], np.stack([np.interp(t[good], sensors.t, sensors.channels[name]) for name in channels], axis=1)


def samples_with_limb_readings_as_commands(samples: Samples, frames: Integers, lengths: Floats) -> Samples:
    """Samples with the measuring limbs' readings as commands, the poses those of vision.
    samples : Samples by vision; frames (f,), lengths (f, 6) m : as `frames_and_limb_readings` gives them, of six.

    Raises NotEnoughData where no frame has both
    """
    both = np.isin(samples.frame, frames)
    if not both.any():
        raise NotEnoughData("no frame has both a pose by vision and readings of the limbs")
    retained = samples.take(both)
    return replace(retained, commanded=lengths[np.searchsorted(frames, retained.frame)])


def calibrated_limbs_and_identification(samples: Samples, nominal: Hexapod, sigma: float) -> tuple[Limbs, Identified]:
    """Measuring limbs calibrated on samples, and their identification.

    nominal : Hexapod as stated; sigma : m of one reading
    Returns (Limbs, Identified)
    """
    found: Identified = identify_platform(_add_reading_noise(samples, nominal, sigma), nominal)
    return Limbs(require_hexapod(found.mechanism), found.covariance, np.hypot(found.scatter, sigma)), found


def _add_reading_noise(samples: Samples, nominal: Hexapod, sigma: float) -> Samples:
    """The Samples with what the readings' own noise (m) does to a pose added to vision's covariance."""
    back = np.linalg.inv(mechanism.jacobian(samples.T_base_platform, nominal))
    return replace(samples, covariance=samples.covariance + sigma**2 * back @ np.swapaxes(back, 1, 2))


def held_out_limb_poses_and_expected_covariance(
    samples: Samples, nominal: Hexapod, sigma: float
) -> tuple[RigidTransform, Floats]:
    """Poses by limbs fitted to other stretches of samples, and the expected covariance of their differences.

    The expectation holds what the limbs' fit to the same cameras shares with vision once only: vision's shared errors
    go into the limbs, so that they do not show in the difference. Raises NotEnoughData for fewer than FEWEST poses

    Returns (T_limbs (n,), expected covariance)
    """
    if len(samples) < FEWEST:
        raise NotEnoughData(f"{len(samples)} poses by vision with readings; limits of agreement need at least {FEWEST}")
    fold = time_block_folds(len(samples), FOLDS)
    matrices, expected = np.empty((len(samples), 4, 4)), np.empty((len(samples), 6, 6))
    alone = replace(samples, common=samples.common[:, :, :0])
    for k in np.unique(fold):
        limbs, _ = calibrated_limbs_and_identification(samples.take(fold != k), nominal, sigma)
        part = samples.take(fold == k)
        T = limbs.pose(part.commanded)
        apart, _ = calibrated_limbs_and_identification(
            alone.take(fold != k), nominal, sigma
        )  # what the fit's own noise adds, vision's shared errors aside
        own, common = apart.uncertainty(T)
        matrices[fold == k] = T.as_matrix()
        expected[fold == k] = own + part.covariance + common @ np.swapaxes(common, 1, 2)
    return type(samples.T_base_platform).from_matrix(matrices), expected


def limb_agreement(
    T_vision: RigidTransform, T_limbs: RigidTransform, expected_covariance: Floats, tolerance: tuple[float, float]
) -> Agreement:
    """Agreement of limbs with vision on the same poses (n,), by axis.
    expected_covariance : (n, 6, 6) covariance of their difference
    tolerance : (m, rad) for position and rotation, each axis
    """
    d, n = pose_difference(T_vision, T_limbs), len(T_vision)
    bias, scatter = d.mean(axis=0), d.std(axis=0, ddof=1)
    limits = np.stack([bias - COVERAGE * scatter, bias + COVERAGE * scatter])
    unsure = (
        COVERAGE * scatter * np.sqrt(1 / n + COVERAGE**2 / (2 * (n - 1)))
    )  # Bland and Altman: of the limits themselves
    motion = pose_to_vector(T_vision[0].inv() * T_vision)
    return Agreement(
        n,
        bias,
        scatter,
        limits,
        np.abs(limits).max(axis=0) + unsure,
        np.sqrt(np.einsum("nii->ni", expected_covariance).mean(axis=0)),
        np.ptp(motion, axis=0),
        np.repeat(tolerance, 3),
    )


def vision_agrees_with_limbs(
    T_vision: RigidTransform,
    covariance: Floats,
    T_limbs: RigidTransform,
    limb_covariance: Floats,
    common_error_columns: Floats,
) -> bool:
    """Whether vision agrees with the limbs on one pose.

    It does within their covariances (6, 6).
    An occasional check. common_error_columns : (6, k) errors common to the limbs' poses
    """
    d = pose_difference(T_vision, T_limbs)
    return bool(
        d @ np.linalg.solve(covariance + limb_covariance + common_error_columns @ common_error_columns.T, d)
        < scipy.special.chdtri(6, TRUST)
    )


RARE = 1e-4  # share of sessions without a step in which one is found, all limbs and onsets together
LEAST = 3  # poses on either side of a step


@dataclass(frozen=True, slots=True)
class Slip:
    """limb : 1..6, of the six that give the pose
    frame : number of the first one after it; size, sigma : m by which the limb is longer than it reads since."""

    limb: int
    frame: int
    size: float
    sigma: float


def detect_limb_slip(samples: Samples, limbs: Limbs, sigma: float) -> Slip | None:
    """Likeliest slip of a measuring limb among samples.

    None where none is beyond chance.
    limbs : Limbs as fitted to these; sigma : m of one reading, as stated
    """
    n, of = (
        len(samples),
        redundant_strut_best_six_legs_and_loop_closures.combine_leg_sets(
            [("m", limbs.hexapod, np.full(6, sigma), np.zeros((42, 42)))], limbs.hexapod.home
        ),
    )
    if n < 2 * LEAST:
        return None
    predicted, J, _ = redundant_strut_best_six_legs_and_loop_closures.leg_lengths_and_pose_and_base_jacobians(
        of, samples.T_base_platform
    )
    spread = J @ samples.covariance @ np.swapaxes(J, 1, 2) + sigma**2 * np.eye(6)
    W = np.linalg.inv(np.linalg.cholesky(spread))
    y = (W @ (samples.commanded - predicted)[..., None]).reshape(-1)
    geometry = redundant_strut_best_six_legs_and_loop_closures.leg_parameter_jacobians(
        of, samples.T_base_platform
    )  # (n, 6, 42)
    known = np.concatenate([W @ geometry * PRIOR, W @ J @ samples.common], axis=2).reshape(6 * n, -1)
    known = np.vstack([known, np.eye(known.shape[1])])  # each of these is a draw of unit size
    Q = np.linalg.qr(known)[0][: 6 * n]
    onset = np.arange(LEAST, n - LEAST + 1)
    steps = np.where(np.arange(n)[:, None] >= onset, 1.0, 0.0)
    columns = (W[:, :, :, None] * steps[:, None, None, :]).reshape(6 * n, -1)  # limbs by onsets
    gram = (columns**2).sum(axis=0) - ((Q.T @ columns) ** 2).sum(axis=0)
    right = columns.T @ y - (Q.T @ columns).T @ (Q.T @ y)
    gain = right**2 / np.maximum(gram, 1e-300)
    best = int(gain.argmax())
    left = float(y @ y - (Q.T @ y) @ (Q.T @ y) - gain[best])
    scale = max(left / (6 * n - 42), 1.0)  # where the poses are worse than they say
    if gain[best] / scale < scipy.special.chdtri(1, RARE / len(gain)):
        return None
    limb, at = divmod(best, len(onset))
    return Slip(
        limb + 1, int(samples.frame[onset[at]]), float(-right[best] / gram[best]), float(np.sqrt(scale / gram[best]))
    )
