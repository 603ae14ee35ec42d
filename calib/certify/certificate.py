"""What a calibration promises, from poses that it was not fitted to."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify.calibration import Calibration
from calib.certify.claim import Claim, promise
from calib.certify.configurations import LEAST, folds, labels, ranges, witnesses
from calib.certify.held_out import HeldOut, compare, errors_of, pays
from calib.correct.correction import Correction, calibrate
from calib.correct.interpolate.radial import Radial
from calib.identify.geometry import Identified, identify, pose_jacobian, to_pose
from calib.samples import Samples, precision
from calib.identify.tolerance import tolerance
from rig.kinds import Struts

Progress = Callable[[str, int, int], None]  # called with (label, done, of) as work goes on

FOLDS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Certified:
    """correction : Correction of all samples; found : Identified, its geometry; label : (n,) configuration of each sample
    held_out : HeldOut, whole stretches of configurations in turn, or None for fewer than configurations.LEAST of them"""

    correction: Correction[Struts, Radial]
    found: Identified
    label: np.ndarray
    held_out: HeldOut | None


def model_covariance(calibration: Calibration, T_base_platform: RigidTransform) -> np.ndarray:
    """(n, 6, 6) covariance of the corrected machine's pose at poses (n,): the parameters', the struts' own scatter and
    what an extension may be off.

    docs/mathematics.md (21)

    calibration : Calibration of a machine on struts
    """
    fitted = calibration.correction.fitted
    J = pose_jacobian(T_base_platform, fitted)
    back = to_pose(T_base_platform, fitted)
    own = np.broadcast_to(calibration.scatter**2, (len(J), len(fitted.axes)))
    if calibration.correction.extension is not None:
        own = own + calibration.correction.extension.error(calibration.correction.inverse(T_base_platform)) ** 2
    covariance = J @ calibration.covariance @ np.swapaxes(J, 1, 2) + (back * own[:, None]) @ np.swapaxes(back, 1, 2)
    return covariance + calibration.correction.posed_error(T_base_platform)[..., None] ** 2 * np.eye(6)


def certify(samples: Samples, nominal: Struts, rng: np.random.Generator,
            progress: Progress | None = None) -> Certified:
    """Certified: calibrated on all samples, and what was left at configurations held out in turn.

    The remainder is kept only where it `pays` on the held-out stretches; its size and smoothness, and how good
    the owner's figures are, are those found on the whole recording. rng : numpy Generator, for the bootstrap
    progress : called with (label, done, of), or None
    """
    label = labels(samples.commanded, ranges(nominal))
    said = progress or silent
    said("fitting the geometry", 0, 1)
    correction, found = calibrate(samples, nominal)
    said("fitting the geometry", 1, 1)
    if label.max() + 1 < LEAST:
        if any(correction.remainder):  # nothing says whether it pays
            correction, found = calibrate(samples, nominal, "none")
        return Certified(correction, found, label, None)
    before, plain = in_turn(samples, label, lambda some: calibrate(some, nominal, "none", found.prior)[0], "", said)
    if any(correction.remainder):
        like = correction.remainder
        _, corrected = in_turn(samples, label, lambda some: calibrate(some, nominal, like, found.prior)[0], ", struts corrected", said)
        weight = precision(samples.total_covariance())
        loss = [np.einsum("ni,nij,nj->n", e, weight, e) for e in (np.nan_to_num(plain), np.nan_to_num(corrected))]
        if pays(loss[0] - loss[1]):
            return Certified(correction, found, label, compare(before, corrected, samples.total_covariance(), rng, label))
        correction, found = calibrate(samples, nominal, "none")
    return Certified(correction, found, label, compare(before, plain, samples.total_covariance(), rng, label))


def silent(label: str, done: int, of: int) -> None:
    """A Progress that says nothing."""


def in_turn(samples: Samples, label: np.ndarray, correct: Callable[[Samples], Correction[Any, Any]], how: str,
            said: Progress) -> tuple[np.ndarray, np.ndarray]:
    """(before, after) as `errors_of`, m and rad, of whole stretches held out in turn, each by the Correction of all others.

    label : (n,) configuration of each sample; correct : a Correction by some samples; how : corrected, in words, for the Progress
    """
    fold = folds(label, min(FOLDS, label.max() + 1))
    before, after = np.empty((len(samples), 6)), np.empty((len(samples), 6))
    name, count = f"holding configurations out{how}", int(fold.max()) + 1
    said(name, 0, count)
    for k in np.unique(fold):
        before[fold == k], after[fold == k] = errors_of(correct(samples.take(fold != k)), samples.take(fold == k))
        said(name, int(k) + 1, count)
    return before, after


def promised(samples: Samples, done: Certified, rng: np.random.Generator) -> Claim:
    """Claim of a certified calibration all over its workspace: each configuration counts once, however often it was visited."""
    nominal = done.correction.nominal
    good = done.found.inliers
    label = np.unique(done.label[good], return_inverse=True)[1]
    kept = samples.take(good)
    each = witnesses(kept, label, to_pose(kept.T_base_platform, nominal))
    offset = done.correction.rho(each.effective)
    found = identify(each, nominal, offset, done.found.prior)
    return promise(found, tolerance(found, nominal), done.correction, each, rng)
