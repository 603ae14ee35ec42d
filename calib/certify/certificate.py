"""What a calibration promises, from poses that it was not fitted to."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.certify.claim import LEAST, Claim, promise
from calib.certify.configurations import folds, labels, ranges, witnesses
from calib.correct.correction import Correction, calibrate
from calib.identify.geometry import Identified, identify, pose_jacobian
from calib.samples import Samples
from calib.identify.tolerance import tolerance
from rig import mechanisms
from rig.design import Hexapod
from rig.pose import difference

FOLDS = 5
DRAWS = 1000
GAIN = 2.0  # standard errors by which the remainder must pay on held-out poses to be kept


@dataclass(frozen=True, slots=True)
class Figures:
    """Pose errors: n; RMS, 95th percentile and greatest of the error's length in position (m) and rotation (rad); bias (6,);
    mean : of the length in position (m) and rotation (rad)."""

    n: int
    position: tuple[float, float, float]
    rotation: tuple[float, float, float]
    bias: tuple[float, ...]
    mean: tuple[float, float]


@dataclass(frozen=True, slots=True)
class HeldOut:
    """before : with the owner's model; after : corrected; both against the measured poses, which were not used in fitting

    floor : (m, rad) RMS standard uncertainty of the measured poses themselves
    ratio : before / after in position on these poses, with its 95 % bootstrap interval (low, high), configurations drawn, not poses
    configurations : how many distinct ones these poses are
    """

    before: Figures
    after: Figures
    floor: tuple[float, float]
    ratio: tuple[float, float, float]
    configurations: int


@dataclass(frozen=True, slots=True, eq=False)
class Certified:
    """correction : Correction of all samples; found : Identified, its geometry; label : (n,) configuration of each sample
    held_out : HeldOut, whole stretches of configurations in turn, or None for fewer than claim.LEAST of them"""

    correction: Correction
    found: Identified
    label: np.ndarray
    held_out: HeldOut | None


def figures(errors):
    """Figures of pose errors (n, 6), position (m) and rotation (rad), NaN where these were not measured."""
    def three(parts):
        length = np.linalg.norm(parts, axis=1)
        return float(np.sqrt(np.mean(length**2))), float(np.quantile(length, 0.95)), float(length.max())

    mean = tuple(float(np.linalg.norm(parts, axis=1).mean()) for parts in (errors[:, :3], errors[:, 3:]))
    return Figures(len(errors), three(errors[:, :3]), three(errors[:, 3:]), tuple(errors.mean(axis=0).tolist()), mean)


def compare(errors_before: np.ndarray, errors_after: np.ndarray, covariance: np.ndarray, rng: np.random.Generator,
            label: np.ndarray | None = None) -> HeldOut:
    """HeldOut of the errors (n, 6) on the same poses; covariance : (n, 6, 6) of the measured poses.

    label : (n,) configuration of each pose, each its own by default; rng : numpy Generator, for the bootstrap
    """
    label = np.arange(len(errors_before)) if label is None else np.unique(label, return_inverse=True)[1]
    before, after = figures(errors_before), figures(errors_after)
    count, size = label.max() + 1, np.bincount(label)
    squares = [np.bincount(label, weights=(e[:, :3] ** 2).sum(axis=1)) for e in (errors_before, errors_after)]
    picks = rng.integers(count, size=(DRAWS, count))
    draws = np.sqrt(squares[0][picks].sum(axis=1) / np.maximum(squares[1][picks].sum(axis=1), 1e-300))
    low, high = np.quantile(draws, [0.025, 0.975])
    ratio = (before.position[0] / max(after.position[0], 1e-300), float(low), float(high))
    return HeldOut(before, after, uncertainty(covariance), ratio, len(size))


def uncertainty(covariance):
    """(m, rad) RMS standard uncertainty of the length of position and rotation, of covariances (n, 6, 6)."""
    return tuple(float(np.sqrt(np.trace(covariance[:, part, part], axis1=1, axis2=2).mean())) for part in (slice(0, 3), slice(3, 6)))


def model_covariance(calibration, T_base_platform):
    """(n, 6, 6) covariance of the corrected machine's pose at poses (n,): the parameters' and the struts' own scatter.

    calibration : anything with correction, covariance (42, 42) and scatter (6,), as store.Calibration
    """
    fitted = calibration.correction.fitted
    J = pose_jacobian(T_base_platform, fitted)
    to_pose = np.linalg.inv(mechanisms.of(fitted).jacobian(T_base_platform, fitted))
    return J @ calibration.covariance @ np.swapaxes(J, 1, 2) + to_pose @ np.diag(calibration.scatter**2) @ np.swapaxes(to_pose, 1, 2)


def errors_of(correction, samples):
    """(before, after), both (n, 6): measured pose against the owner's model's and against the corrected model's; NaN where a
    rotation was not measured."""
    nominal = mechanisms.of(correction.nominal).forward(samples.commanded, correction.nominal)
    errors = difference(nominal, samples.T_base_platform), difference(correction.predict(samples.commanded), samples.T_base_platform)
    for one in errors:
        one[:, 3:][np.isinf(samples.covariance[:, [3, 4, 5], [3, 4, 5]])] = np.nan
    return errors


def certify(samples: Samples, nominal: Hexapod, rng: np.random.Generator,
            progress: Callable[[str, int, int], None] | None = None) -> Certified:
    """Certified: calibrated on all samples, and what was left at configurations held out in turn.

    The remainder is kept only where it pays on the held-out stretches by GAIN standard errors; its size and smoothness, and how good
    the owner's figures are, are those found on the whole recording. rng : numpy Generator, for the bootstrap
    progress : called with (label, done, of), or None
    """
    label = labels(samples.commanded, ranges(nominal))
    said = progress or _silent
    said("fitting the geometry", 0, 1)
    correction, found = calibrate(samples, nominal)
    said("fitting the geometry", 1, 1)
    if label.max() + 1 < LEAST:
        if any(correction.remainder):  # nothing says whether it pays
            correction, found = calibrate(samples, nominal, "none")
        return Certified(correction, found, label, None)
    before, plain = _held_out(samples, nominal, label, "none", found.prior, said)
    if any(correction.remainder):
        _, corrected = _held_out(samples, nominal, label, correction.remainder, found.prior, said)
        precision = np.linalg.inv(samples.total_covariance())
        gain = [np.einsum("ni,nij,nj->n", e, precision, e) for e in (plain, corrected)]
        gain = gain[0] - gain[1]
        if gain.mean() > GAIN * gain.std() / np.sqrt(len(gain) / correlation(gain)):
            return Certified(correction, found, label, compare(before, corrected, samples.total_covariance(), rng, label))
        correction, found = calibrate(samples, nominal, "none")
    return Certified(correction, found, label, compare(before, plain, samples.total_covariance(), rng, label))


def _silent(label: str, done: int, of: int) -> None:
    pass


def _held_out(samples, nominal, label, remainder, prior, said):
    fold = folds(label, min(FOLDS, label.max() + 1))
    before, after = np.empty((len(samples), 6)), np.empty((len(samples), 6))
    name = "holding configurations out" + ("" if remainder == "none" else ", struts corrected")
    said(name, 0, fold.max() + 1)
    for k in np.unique(fold):
        correction, _ = calibrate(samples.take(fold != k), nominal, remainder, prior)
        before[fold == k], after[fold == k] = errors_of(correction, samples.take(fold == k))
        said(name, int(k) + 1, fold.max() + 1)
    return before, after


def promised(samples: Samples, done: Certified, rng: np.random.Generator) -> Claim:
    """Claim of a certified calibration all over its workspace: each configuration counts once, however often it was visited."""
    nominal = done.correction.nominal
    good = done.found.inliers
    label = np.unique(done.label[good], return_inverse=True)[1]
    kept = samples.take(good)
    each = witnesses(kept, label, np.linalg.inv(mechanisms.of(nominal).jacobian(kept.T_base_platform, nominal)))
    offset = done.correction.rho(each.commanded)
    found = identify(each, nominal, offset, done.found.prior)
    return promise(found, tolerance(found, nominal), done.correction, each, rng)


def correlation(series):
    """How many neighbours in time say the same: 1 + 2 x the sum of the autocorrelations before they first turn negative."""
    centred = series - series.mean()
    total = (centred**2).sum()
    factor = 1.0
    for lag in range(1, len(series) // 4):
        c = (centred[lag:] * centred[:-lag]).sum() / max(total, 1e-300)
        if c <= 0:
            break
        factor += 2 * c
    return factor
