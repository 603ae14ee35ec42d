"""How far an arm's poses scatter beyond its geometry and beyond what is stated for them, judged on configurations that
were held out.
"""

from dataclasses import replace

import numpy as np

from calib.certify.held_out_error_statistics import (
    HeldErrors,
    held_out_error_statistics,
    parameter_squares_without,
    standardised_residuals,
)
from calib.models.arm import error_model
from calib.models.arm.correction import ArmCorrection
from calib.models.arm.identification import Identified
from calib.models.arm.instrument_observations import of_samples
from calib.samples.pose_samples import Samples

UNSTATED = 1.2  # times what is stated, from which a scatter is unexplained


def beyond_geometry(found: Identified, correction: ArmCorrection, agreed: Samples, label: np.ndarray) -> HeldErrors:
    """HeldErrors of an arm's geometry at each configuration. agreed : Samples that it was fitted to; label : (m,)
    configuration of each
    """
    freed = standardised_residuals(found.residuals[found.inliers], *_fitted(found, correction, agreed), label)
    return held_out_error_statistics(freed, agreed, label)


def by_parameters(found: Identified, correction: ArmCorrection, agreed: Samples, parts: np.ndarray) -> np.ndarray:
    """(2,) m^2 and rad^2, mean square of errors at samples held out that comes of the parameters. parts : (m,) which
    are held out together
    """
    return parameter_squares_without(*_fitted(found, correction, agreed), parts)


def _fitted(found: Identified, correction: ArmCorrection, agreed: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(jacobian (m, 6, p), covariance (p, p), noise (m, 6, 6)) of a fit."""
    J = error_model.parameter_jacobian(agreed.commanded, correction.fitted)
    return J, found.covariance, of_samples(agreed).covariance + np.diag(found.scatter**2)


def as_held_out(found: Identified, left: HeldErrors, rng: np.random.Generator) -> Identified:
    """The Identified, its scatter no less than poses held out show beyond the parameters' errors: what a model lacks a
    fit takes into itself.
    """
    if len(found.scatter) != 6:
        return found
    return replace(found, scatter=np.maximum(found.scatter, np.sqrt(np.repeat(left.shown(rng) / 3, 3))))


def unexplained(scatter: np.ndarray, covariance: np.ndarray) -> tuple[str, ...]:
    """A sentence for positions, and one for rotations, that scatter beyond what their instrument states by more than a
    fifth of that.

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
