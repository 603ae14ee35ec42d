"""Held-out pose errors: their figures before and after correction, and the significance of the gain."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.distinct_configurations import LEAST
from calib.correction.correction import AnyCorrection
from calib.samples.pose_samples import Samples
from rig.arrays import Floats, Integers
from rig.model import mechanisms
from rig.model.pose import pose_difference, rms_uncertainty

DRAWS = 1000  # of the bootstrap
GAIN = 2.0  # standard errors by which a correction must pay on held-out poses to be kept


@dataclass(frozen=True, slots=True)
class Figures:
    """Pose errors: n; RMS, 95th percentile and greatest of the error's length in position (m) and rotation (rad); bias
    (6,);
    mean : of the length in position (m) and rotation (rad)."""

    n: int
    position: tuple[float, float, float]
    rotation: tuple[float, float, float]
    bias: tuple[float, ...]
    mean: tuple[float, float]


@dataclass(frozen=True, slots=True)
class HeldOut:
    """before : with the owner's model; after : corrected; both against the measured poses, which were not used in
    fitting

    floor : (m, rad) RMS standard uncertainty of the measured poses themselves
    ratio : before / after in position, where that was not measured in rotation, on these poses,
    with its 95 % bootstrap interval (low, high), configurations drawn, not poses; of fewer than
    LEAST configurations it has none, NaN
    configurations : how many distinct ones these poses are
    """

    before: Figures
    after: Figures
    floor: tuple[float, float]
    ratio: tuple[float, float, float]
    configurations: int


def error_statistics(errors: Floats) -> Figures:
    """Figures of pose errors (n, 6), position (m) and rotation (rad), NaN where these were not measured."""

    def three(parts: Floats) -> tuple[float, float, float]:
        length = np.linalg.norm(parts, axis=1)
        return float(np.sqrt(np.mean(length**2))), float(np.quantile(length, 0.95)), float(length.max())

    position, rotation = (float(np.linalg.norm(parts, axis=1).mean()) for parts in (errors[:, :3], errors[:, 3:]))
    return Figures(
        len(errors),
        three(errors[:, :3]),
        three(errors[:, 3:]),
        tuple(errors.mean(axis=0).tolist()),
        (position, rotation),
    )


def compare_errors(
    errors_before: Floats,
    errors_after: Floats,
    covariance: Floats,
    rng: np.random.Generator,
    label: Integers | None = None,
) -> HeldOut:
    """Comparison of errors before and after on the same poses, as HeldOut; covariance : (n, 6, 6)

    label : (n,) configuration of each pose, each its own by default; rng : numpy Generator, for the bootstrap
    """
    label = np.arange(len(errors_before)) if label is None else np.unique(label, return_inverse=True)[1]
    before, after = error_statistics(errors_before), error_statistics(errors_after)
    count, size = label.max() + 1, np.bincount(label)
    turned = bool(np.isnan(errors_after[:, :3]).any())
    part = slice(3, 6) if turned else slice(0, 3)
    squares = [np.bincount(label, weights=(e[:, part] ** 2).sum(axis=1)) for e in (errors_before, errors_after)]
    picks = rng.integers(count, size=(DRAWS, count))
    draws = np.sqrt(squares[0][picks].sum(axis=1) / np.maximum(squares[1][picks].sum(axis=1), 1e-300))
    low, high = np.quantile(draws, [0.025, 0.975]) if count >= LEAST else (np.nan, np.nan)
    sizes = [(one.rotation if turned else one.position)[0] for one in (before, after)]
    ratio = (sizes[0] / max(sizes[1], 1e-300), float(low), float(high))
    return HeldOut(before, after, rms_uncertainty(covariance), ratio, len(size))


def errors_before_and_after_correction(correction: AnyCorrection, samples: Samples) -> tuple[Floats, Floats]:
    """Pose errors (before, after) correction, both (n, 6): measured against the nominal and the corrected model."""
    nominal = mechanisms.kinematics_of(correction.nominal).forward(samples.commanded, correction.nominal)
    return pose_errors(nominal, samples), pose_errors(correction.predict(samples.effective), samples)


def pose_errors(T_base_platform: RigidTransform, samples: Samples) -> Floats:
    """Pose errors (n, 6) of measured samples against predicted poses (n,), NaN where not measured."""
    if samples.measured == "distance":
        error = np.full((len(samples), 6), np.nan)
        error[:, 0] = samples.T_base_platform.translation[:, 0] - np.linalg.norm(T_base_platform.translation, axis=1)
        error[:, 1:3] = 0.0
        return error
    error, spread = (
        pose_difference(T_base_platform, samples.T_base_platform),
        samples.covariance[:, [3, 4, 5], [3, 4, 5]],
    )
    error[:, 3:][np.isinf(spread) | (spread == 0)] = np.nan
    error[:, :3][np.isinf(samples.covariance[:, [0, 1, 2], [0, 1, 2]])] = np.nan
    return error


def is_significant_gain(gain: Floats) -> bool:
    """Whether the gain of held-out poses (n,) is significant: beyond GAIN standard errors, autocorrelation included."""
    return bool(gain.mean() > GAIN * gain.std() / np.sqrt(len(gain) / autocorrelation_factor(gain)))


def autocorrelation_factor(series: Floats) -> float:
    """Autocorrelation factor of a series (n,): 1 + 2 x the sum of its first positive autocorrelations."""
    centred = series - series.mean()
    total = (centred**2).sum()
    factor = 1.0
    for lag in range(1, len(series) // 4):
        c = (centred[lag:] * centred[:-lag]).sum() / max(total, 1e-300)
        if c <= 0:
            break
        factor += 2 * c
    return factor
