"""Scatter of an arm's held-out poses beyond its geometry and its instrument's stated covariance."""

from dataclasses import replace

import numpy as np

from calib.certification.held_out_error_statistics import (
    HeldErrors,
    held_out_error_statistics,
    held_out_parameter_error_squares,
    standardised_residuals,
)
from calib.models.arm import error_model
from calib.models.arm.correction import ArmCorrection
from calib.models.arm.identification import Identified
from calib.models.arm.instrument_observations import sample_observations
from calib.samples.pose_samples import Samples
from rig.arrays import Floats, Integers

UNSTATED = 1.2  # times what is stated, from which a scatter is unexplained


def held_out_geometry_errors(
    identified: Identified, correction: ArmCorrection, fitted_samples: Samples, label: Integers
) -> HeldErrors:
    """Held-out errors (HeldErrors) of an arm's geometry at each configuration. label : (m,) configuration of each
    fitted_samples : Samples that it was fitted to; label : (m,) configuration of each
    """
    freed = standardised_residuals(
        identified.residuals[identified.inliers], *_fitted(identified, correction, fitted_samples), label
    )
    return held_out_error_statistics(freed, fitted_samples, label)


def held_out_arm_parameter_error_squares(
    identified: Identified, correction: ArmCorrection, fitted_samples: Samples, folds: Integers
) -> Floats:
    """Mean squares (2,) of held-out errors caused by the parameters, m^2 and rad^2.
    folds : (m,) which are held out together
    """
    return held_out_parameter_error_squares(*_fitted(identified, correction, fitted_samples), folds)


def _fitted(found: Identified, correction: ArmCorrection, agreed: Samples) -> tuple[Floats, Floats, Floats]:
    """(jacobian (m, 6, p), covariance (p, p), noise (m, 6, 6)) of a fit."""
    J = error_model.parameter_jacobian(agreed.commanded, correction.fitted)
    return J, found.covariance, sample_observations(agreed).covariance + np.diag(found.scatter**2)


def identification_with_held_out_scatter(
    identified: Identified, held_out_errors: HeldErrors, rng: np.random.Generator
) -> Identified:
    """Identification with its scatter raised to that of held-out poses beyond the parameters' errors."""
    if len(identified.scatter) != 6:
        return identified
    return replace(
        identified, scatter=np.maximum(identified.scatter, np.sqrt(np.repeat(held_out_errors.shown(rng) / 3, 3)))
    )


def unexplained_scatter_sentences(scatter: Floats, covariance: Floats) -> tuple[str, ...]:
    """Sentences on scatter unexplained by the instrument's statement, one for positions and one for rotations.

    scatter : (k,) m and rad beyond; covariance : (n, k, k) as stated
    """
    out = []
    for part, name, unit in ((slice(0, 3), "positions", "mm"), (slice(3, 6), "rotations", "mrad")):
        beyond = float(np.sqrt((scatter[part] ** 2).sum()))
        stated = float(np.sqrt(np.einsum("nkk->nk", covariance)[:, part].sum(axis=1).mean())) if beyond else 0.0
        if np.hypot(beyond, stated) > UNSTATED * stated:
            out.append(
                f"{name} of the hand scatter by {beyond * 1e3:.3g} {unit} beyond the {stated * 1e3:.3g} "
                f"{unit} that is stated for them, which "
                "nothing in this calibration explains"
            )
    return tuple(out)
