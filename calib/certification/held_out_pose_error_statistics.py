"""Held-out pose errors before and after correction.

Their statistics, and the significance of the gain.

Nothing is assumed of where the errors come from, so that what no model has (friction, play, sag, gears) is in it. Few
configurations tell a mean square badly, and badly told it is more often too small: draws are of the mean square over
chi-square, its degrees of freedom those that the squares themselves scatter by (Satterthwaite), never more than
INDEPENDENT a configuration. docs/mathematics.md (21)
Source: Satterthwaite, An approximate distribution of estimates of variance components, Biometrics 1946
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.held_out_pose_errors_and_distinct_configurations import LEAST
from calib.correction.machine_correction import AnyCorrection
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats, Integers
from rig.model import mechanisms
from rig.model.pose import direction_difference, pose_difference, rms_uncertainty

BOOTSTRAP_DRAWS = 1000  # of the bootstrap
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
    """before : with the nominal model; after : corrected; both against the measured poses, which were not used in
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
    """Statistics (Figures) of pose errors (n, 6).

    Position (m) and rotation (rad), NaN where these were not measured.
    """

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
    """Comparison of errors before and after on the same poses, as HeldOut.

    covariance : (n, 6, 6)
    label : (n,) configuration of each pose, each its own by default; rng : numpy Generator, for the bootstrap
    """
    label = np.arange(len(errors_before)) if label is None else np.unique(label, return_inverse=True)[1]
    before, after = error_statistics(errors_before), error_statistics(errors_after)
    count, size = label.max() + 1, np.bincount(label)
    turned = bool(np.isnan(errors_after[:, :3]).any())
    part = slice(3, 6) if turned else slice(0, 3)
    squares = [np.bincount(label, weights=(e[:, part] ** 2).sum(axis=1)) for e in (errors_before, errors_after)]
    picks = rng.integers(count, size=(BOOTSTRAP_DRAWS, count))
    draws = np.sqrt(squares[0][picks].sum(axis=1) / np.maximum(squares[1][picks].sum(axis=1), 1e-300))
    low, high = np.quantile(draws, [0.025, 0.975]) if count >= LEAST else (np.nan, np.nan)
    sizes = [(one.rotation if turned else one.position)[0] for one in (before, after)]
    ratio = (sizes[0] / max(sizes[1], 1e-300), float(low), float(high))
    return HeldOut(before, after, rms_uncertainty(covariance), ratio, len(size))


def errors_before_and_after_correction(correction: AnyCorrection, samples: Samples) -> tuple[Floats, Floats]:
    """Pose errors (before, after) correction, both (n, 6): measured against the nominal and the corrected model."""
    if samples.hand is not None:
        before, after = np.empty((len(samples), 6)), np.empty((len(samples), 6))
        for number, own, alone in samples.by_hand():
            before[own], after[own] = errors_before_and_after_correction(correction.of_hand(number), alone)
        return before, after
    nominal = mechanisms.kinematics_of(correction.nominal).forward(samples.commanded, correction.nominal)
    return pose_errors(nominal, samples), pose_errors(predicted_poses(correction, samples), samples)


def predicted_poses(correction: AnyCorrection, samples: Samples) -> RigidTransform:
    """Poses (n,) that the corrected model predicts for samples.

    Each is of its own hand.
    """
    if samples.hand is None:
        return correction.predict(samples.effective)
    matrices = np.empty((len(samples), 4, 4))
    for number, own, alone in samples.by_hand():
        matrices[own] = correction.of_hand(number).predict(alone.effective).as_matrix()
    return RigidTransform.from_matrix(matrices)


def pose_errors(T_base_platform: RigidTransform, samples: Samples) -> Floats:
    """Pose errors (n, 6) of measured samples against predicted poses (n,).

    NaN where not measured.
    """
    if samples.measured == "distance":
        error = np.full((len(samples), 6), np.nan)
        error[:, 0] = samples.T_base_platform.translation[:, 0] - np.linalg.norm(T_base_platform.translation, axis=1)
        error[:, 1:3] = 0.0
        return error
    if samples.measured == "direction":
        error = np.full((len(samples), 6), np.nan)
        error[:, 3:5], error[:, 5] = direction_difference(T_base_platform, samples.T_base_platform), 0.0
        return error
    error, spread = (
        pose_difference(T_base_platform, samples.T_base_platform),
        samples.covariance[:, [3, 4, 5], [3, 4, 5]],
    )
    error[:, 3:][np.isinf(spread) | (spread == 0)] = np.nan
    error[:, :3][np.isinf(samples.covariance[:, [0, 1, 2], [0, 1, 2]])] = np.nan
    return error


def is_significant_gain(gain: Floats) -> bool:
    """Whether the gain of held-out poses (n,) is significant.

    Beyond GAIN standard errors, autocorrelation included.
    """
    return bool(gain.mean() > GAIN * gain.std() / np.sqrt(len(gain) / variance_inflation_by_autocorrelation(gain)))


def variance_inflation_by_autocorrelation(series: Floats) -> float:
    """Factor by which a series' (n,) autocorrelation raises its mean's variance.

    It is 1 + 2 x the sum of its first positive autocorrelations.
    """
    centred = series - series.mean()
    total = (centred**2).sum()
    factor = 1.0
    for lag in range(1, len(series) // 4):
        c = (centred[lag:] * centred[:-lag]).sum() / max(total, 1e-300)
        if c <= 0:
            break
        factor += 2 * c
    return factor


INDEPENDENT = (
    1.5  # degrees of freedom that a configuration is worth at the most: the three of a position would be of noise alone
)
TRUSTED = 20  # degrees of freedom that the stated covariance of measured poses is worth
LEAST_FREEDOM = 3.0
# share of a combination's information in the samples held out, from which the others count as telling nearly nothing of
# it
ALL_OWN = 0.99
# by which the logarithm of errors' mean square elsewhere may differ: what a model lacks goes by the place, of which few
# are known
ELSEWHERE = 0.5
DRAWS = 1000
PARTS = (slice(0, 3), slice(3, 6))


@dataclass(frozen=True, slots=True, eq=False)
class HeldErrors:
    """Of c configurations held out: squares (c, 2) m^2 and rad^2, mean over each one's visits, NaN where none was
    measured; noise (c, 2), what measuring adds to these; stated : m^2, mean square by which the correction itself said
    that these positions may be off, 0 where it said nothing
    scale : by which what it says was multiplied since; fitted : m^2, what it leaves at the poses it was fitted to
    parameters : (2,) m^2 and rad^2, mean square that comes of fitted parameters.

    Rows in order of their first visit."""

    squares: Floats
    noise: Floats
    stated: float = 0.0
    scale: float = 1.0
    fitted: float = 0.0
    parameters: Floats = field(default_factory=lambda: np.zeros(2))

    def elsewhere(self, stated: float, count: int, rng: np.random.Generator) -> Floats:
        """(count, 1) draws of the errors' mean square where the correction says that positions may be off by `stated`
        (m^2), over that of those held out.

        What depends on the place grows as that does; what is left where it was fitted as well, as friction, does not.
        """
        share, beyond = 1.0, float(self.beyond()[0])
        if self.stated and self.scale:
            own = 1 - min(1.0, self.fitted / beyond) if beyond else 1.0
            share = 1 - own + own * stated / (self.stated * self.scale**2)
        return np.asarray(share * np.exp(ELSEWHERE * rng.normal(size=(count, 1))))

    def draws(self, count: int, rng: np.random.Generator) -> Floats:
        """(count, 2) m^2 and rad^2, draws of the true errors' mean square; 0 for what was not measured."""
        out = np.zeros((count, 2))
        for k in range(2):
            squares, noise = self.squares[:, k], float(self.noise[:, k].mean())
            if np.isnan(squares).any() or not squares.any():
                continue
            freedom = _degrees_of_freedom(squares)
            seen = squares.mean() * freedom / rng.chisquare(freedom, count)
            out[:, k] = np.maximum(seen - noise * TRUSTED / rng.chisquare(TRUSTED, count), 0.0)
        return out

    def own_draws(self, stated: float, count: int, rng: np.random.Generator) -> Floats:
        """(count, 2) m^2 and rad^2, draws of the mean square that no model corrects, where the correction says that
        positions may be off by `stated` (m^2): beyond what comes of the parameters."""
        return np.maximum(self.draws(count, rng) - self.parameters, 0.0) * self.elsewhere(stated, count, rng)

    def own(self, stated: float, rng: np.random.Generator) -> Floats:
        """(2,) m^2 and rad^2, the mean of these draws."""
        return np.asarray(self.own_draws(stated, DRAWS, rng).mean(axis=0))

    def shown(self, rng: np.random.Generator) -> Floats:
        """(2,) m^2 and rad^2, the mean of these draws where three of four show anything at all, else nothing."""
        draws = self.own_draws(0.0, DRAWS, rng)
        return np.asarray(np.where(np.quantile(draws, 0.25, axis=0) > 0, draws.mean(axis=0), 0.0))

    def unnoticed(self) -> float:
        """m^2, mean square of position errors that so many poses held out do not tell from the noise of measuring
        them.
        """
        return float(self.noise[:, 0].mean() * np.sqrt(2 / _degrees_of_freedom(self.squares[:, 0])))

    def beyond(self) -> Floats:
        """(2,) m^2 and rad^2, mean square of the true errors as estimated; 0 for what was not measured."""
        return np.nan_to_num(np.maximum(self.squares.mean(axis=0) - self.noise.mean(axis=0), 0.0))


def mean_square_held_out_errors_by_configuration(
    errors: Floats, samples: Samples, label: Integers, stated: float = 0.0, parameters: Floats | None = None
) -> HeldErrors:
    """Mean squares by configuration (HeldErrors) of held-out errors (n, 6) m and rad.

    NaN where not measured.
    samples : Samples that they are of; label : (n,) configuration of each
    stated, parameters : as there, nothing by default
    """
    label = np.unique(label, return_inverse=True)[1]
    size = np.bincount(label)
    variances = np.einsum("nii->ni", samples.covariance).copy()
    if samples.measured == "direction":
        variances[:, 5] = 0.0  # about itself a direction has no error

    def means(values: Floats) -> Floats:
        each = np.stack([values[:, part].sum(axis=1) for part in PARTS], axis=1)
        return np.stack([np.bincount(label, weights=column) for column in each.T], axis=1) / size[:, None]

    first = np.argsort(np.unique(label, return_index=True)[1])
    return HeldErrors(
        means(errors**2)[first],
        means(np.where(np.isinf(variances), np.nan, variances))[first],
        stated,
        parameters=np.zeros(2) if parameters is None else parameters,
    )


def residuals_corrected_for_absorbed_noise(
    residuals: Floats, jacobian: Floats, covariance: Floats, noise: Floats, label: Integers
) -> Floats:
    """Residuals (n, 6) of a linear fit, corrected for the noise it absorbed.

    They are standardised.

    Corrected for the noise that the fit absorbed, m and rad.
    residuals : (n, 6); label : (n,) configuration of each sample
    The rest as `mean_square_pose_errors_caused_by_parameters` has it.
    Source: Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.1, by blocks
    """
    out = np.empty_like(residuals)
    for own, L, U, share in _leverages(jacobian, covariance, noise, label):
        left = np.linalg.solve(L, residuals[own, :, None]).ravel()
        left += U @ ((1 / np.sqrt(1 - share) - 1) * (U.T @ left))
        out[own] = (L @ left.reshape(-1, 6, 1))[..., 0]
    return out


def mean_square_pose_errors_caused_by_parameters(
    jacobian: Floats, covariance: Floats, noise: Floats, held_out_group: Integers
) -> Floats:
    """Mean squares (2,) of held-out pose errors caused by the fitted parameters, m^2 and rad^2.

    The parameters are fitted without the samples of the same held-out group.
    jacobian : (n, 6, p) of poses with the parameters; covariance : (p, p) of the parameters of a fit of all samples;
        noise : (n, 6, 6) by which that
    fit weighed them; held_out_group : (n,) which are held out together
    Source: Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.2, by blocks
    """
    out = np.empty(jacobian.shape[:2])
    for own, L, U, share in _leverages(jacobian, covariance, noise, held_out_group):
        out[own] = ((L @ (U * np.sqrt(share / (1 - share))).reshape(len(L), 6, -1)) ** 2).sum(axis=2)
    return np.asarray(out.mean(axis=0).reshape(2, 3).sum(axis=1))


def _leverages(
    jacobian: Floats, covariance: Floats, noise: Floats, part: Integers
) -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
    """Of each part (its samples (n,) bool, roots of their noise (m, 6, 6), k <= p directions (6 m, k) of their whitened
    poses, and of each direction the share, 0 to ALL_OWN, of what is known of it that these samples tell themselves).
    Of directions across these the share is 0."""
    none = np.diag(1.0 * ~noise.any(axis=(0, 1)))  # directions in which a machine has no freedom: nothing moves them
    scale = np.sqrt(np.diag(covariance))
    scale[scale == 0] = 1.0
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, None] * axes * np.sqrt(variances.clip(0))  # (p, p): the parts' poses outnumber the parameters
    for each in np.unique(part):
        own = part == each
        L = np.linalg.cholesky(noise[own] + none)
        white = np.linalg.solve(L, jacobian[own]).reshape(-1, jacobian.shape[2])
        U, sizes, _ = np.linalg.svd(white @ root, full_matrices=False)
        yield own, L, U, (sizes**2).clip(0, ALL_OWN)


def _degrees_of_freedom(squares: Floats) -> float:
    """Degrees of freedom of the mean of squares (c,), in order of time, as they scatter and as neighbours say the
    same.
    """
    variance = squares.var(ddof=1) / len(squares) * variance_inflation_by_autocorrelation(squares)
    most = INDEPENDENT * len(squares)
    return float(np.clip(2 * squares.mean() ** 2 / max(variance, 1e-300), LEAST_FREEDOM, most))


def draw_mean_square_common_pose_errors(samples: Samples, count: int, rng: np.random.Generator) -> Floats:
    """Draws (count, 2) of the mean square of pose errors common to the samples, m^2 and rad^2."""
    drawn = np.einsum("nik,kd->dni", samples.common, rng.normal(size=(samples.common.shape[2], count)))
    return np.stack([(drawn[..., part] ** 2).sum(axis=2).mean(axis=1) for part in PARTS], axis=1)
