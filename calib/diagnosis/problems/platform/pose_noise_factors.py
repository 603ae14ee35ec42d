"""Factors by which the noise of measured poses exceeds what is stated, estimated from closures of struts.

Noise of a pose moves all struts together, as its geometry has them; a strut's own scatter moves that strut alone. The
likelihood of the closures' covariance distinguishes them. Its variances are estimated together by Fisher scoring
(Jennrich and Sampson, Technometrics 18, 1976, 11-17), and the Bayesian criterion chooses which of them are needed.
"""

from typing import NamedTuple

import numpy as np
import scipy

from calib.diagnosis.engine.lack_of_fit_by_smooth_functions import MATERIAL
from calib.diagnosis.problems.evidence_interface_and_requested_effects import Value
from calib.diagnosis.problems.platform.lack_of_fit import closure_residuals
from calib.diagnosis.problems.platform.linearised_residuals import LinearisedModel
from calib.models.platform.identification import PRIOR
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.mechanisms.mechanism_kinds_and_kinematics import loop_closure_parameter_jacobian, strut_length_jacobian

KINDS = ("position", "rotation")
CRITERION = 10.0  # of Schwarz, by which common factors must be better than without
STEPS = 60
SETTLED = 1e-7
SEEN = 1e-6  # share of a closure's variance that a kind of pose noise must make up
REFUTED = 1e-3  # chance that repeated poses agree so well under the noise estimated


class _Variances(NamedTuple):
    """values : of each matrix' coefficient; likelihood : minus twice its logarithm; information : Fisher's."""

    values: Floats
    likelihood: float
    information: Floats


def noise_factors_of_poses(
    model: LinearisedModel, effect_parameters: int, repeated: Integers
) -> dict[str, Value] | None:
    """{position or rotation: Value with 95 % interval} of the standard deviations over those stated; None where these
    suffice, or where struts scatter each for itself.

    effect_parameters : fitted in all; repeated : (k, 2) indices of frames with the same command
    """
    k = model.point
    if k.own is None:
        return None
    A, left = strut_length_jacobian(k.T, k.platform), closure_residuals(model)
    kinds = []
    for part in (slice(0, 3), slice(3, 6)):
        C = np.zeros_like(k.own)
        C[:, part, part] = k.own[:, part, part]
        kinds.append(A @ C @ np.swapaxes(A, 1, 2))
    whole = np.einsum("fii->", kinds[0] + kinds[1])
    names = [name for name, K in zip(KINDS, kinds) if np.einsum("fii->", K) > SEEN * whole]
    noise = [K for name, K in zip(KINDS, kinds) if name in names]
    own = [np.broadcast_to(np.diag(row), noise[0].shape) for row in np.eye(k.axes)]
    parts, count = np.array([*noise, *own, np.broadcast_to(np.eye(k.axes), noise[0].shape)]), len(noise)
    geometry = loop_closure_parameter_jacobian(k.T, k.platform)
    freedom = left.size - geometry.shape[2] - effect_parameters
    if freedom <= 0:
        return None
    left = left / np.sqrt(1 - effect_parameters / (left.size - geometry.shape[2]))
    at = np.arange(len(parts))
    common, each, alike = at < count, (at >= count) & (at < len(parts) - 1), at == len(parts) - 1
    start = common.astype(float)

    def criterion(which: Booleans) -> tuple[float, _Variances]:
        found = _variances(left, geometry, parts, which, start)
        return found.likelihood + which.sum() * np.log(freedom), found

    without = min(criterion(which)[0] for which in (each, alike, each & False))
    best, found = min((criterion(common | which) for which in (each, alike, each & False)), key=lambda one: one[0])
    if best > without - CRITERION or np.sqrt(found.values[:count].max()) < MATERIAL:
        return None
    used = (found.values > start) | common
    error = np.zeros(len(parts))
    error[used] = np.sqrt(np.diag(np.linalg.inv(found.information[np.ix_(used, used)])))
    if len(repeated) and _agree_too_well(left[repeated[:, 0]] - left[repeated[:, 1]], repeated, parts, found.values):
        return None
    out = {}
    for name, value, width in zip(names, found.values, error):
        factor, half = float(np.sqrt(value)), float(1.96 * width / (2 * np.sqrt(value)))
        out[name] = Value(factor, "", [max(factor - half, 0.0), factor + half])
    return out


def scaled_pose_covariance(covariance: Floats, factors: dict[str, Value]) -> Floats:
    """Covariance (F, 6, 6) of poses whose standard deviations are scaled by factors, those not estimated by 1."""
    times = np.repeat([float(factors[name].value) if name in factors else 1.0 for name in KINDS], 3)
    return covariance * times[:, None] * times


def _variances(left: Floats, geometry: Floats, parts: Floats, free: Booleans, least: Floats) -> _Variances:
    """_Variances of residuals left (F, axes) whose covariance is a sum of parts (p, F, axes, axes), most likely.

    geometry : (F, axes, g) the residuals' derivatives by what was fitted, which takes freedom from them (restricted
    likelihood: Patterson and Thompson, Biometrika 58, 1971, 545-554)

    free : (p,) which are estimated, from `least` (p,) on; the others stay there
    """
    values = least.copy()
    # struts that scatter by half of the mean square: a start from which all can grow or vanish
    scale = np.einsum("pfii->p", parts) / left.size
    values[free] += 0.5 * (left**2).mean() / scale[free] / free.sum()
    found = _at(left, geometry, parts, values)
    for _ in range(STEPS):
        gradient, information, likelihood = found
        step = np.zeros_like(values)
        bound = (values <= least) & (gradient <= 0)
        moving = free & ~bound
        if not moving.any():
            break
        step[moving] = np.linalg.solve(information[np.ix_(moving, moving)], gradient[moving])
        share = 1.0
        for _ in range(12):
            new = np.maximum(values + share * step, least)
            found = _at(left, geometry, parts, new)
            if found[2] <= likelihood + 1e-9:
                break
            share /= 2
        change = np.abs(new - values) * scale
        values = new
        if change.max() < SETTLED * (left**2).mean():
            break
    return _Variances(values, found[2], found[1])


def _at(left: Floats, geometry: Floats, parts: Floats, values: Floats) -> tuple[Floats, Floats, float]:
    """(gradient (p,) of the log-likelihood, Fisher information (p, p), minus twice the log-likelihood)."""
    S = np.einsum("p,pfij->fij", values, parts)
    inverse = np.linalg.inv(S)
    X = inverse @ geometry
    gram = np.einsum("fig,fih->gh", geometry, X) + np.eye(geometry.shape[2]) / PRIOR**2
    z = np.einsum("fij,fj->fi", inverse, left)
    z = z - X @ np.linalg.solve(gram, np.einsum("fig,fi->g", geometry, z))
    B = inverse @ parts
    moved = parts @ X  # (p, F, axes, g)
    taken = np.linalg.solve(gram, np.einsum("fig,pfih->pgh", X, moved, optimize=True))
    gradient = 0.5 * (
        np.einsum("fi,pfij,fj->p", z, parts, z, optimize=True) - np.einsum("pfii->p", B) + np.einsum("pgg->p", taken)
    )
    flat = moved.reshape(len(parts), -1)
    twice = flat @ (inverse @ moved @ np.linalg.inv(gram)).reshape(len(parts), -1).T
    information = 0.5 * (
        np.einsum("pfij,qfji->pq", B, B, optimize=True) - 2 * twice + np.einsum("pgh,qhg->pq", taken, taken)
    )
    likelihood = np.linalg.slogdet(S)[1].sum() + np.linalg.slogdet(gram)[1] + (left * z).sum()
    return gradient, information, float(likelihood)


def _agree_too_well(apart: Floats, pairs: Integers, parts: Floats, values: Floats) -> bool:
    """Whether closures of repeated commands, which differ by noise at least, differ by less than the noise estimated.

    apart : (k, axes) m
    """
    S = np.einsum("p,pfij->fij", values, parts)
    both = S[pairs[:, 0]] + S[pairs[:, 1]]
    square = float(np.einsum("fi,fi->", apart, np.linalg.solve(both, apart[..., None])[..., 0]))
    return bool(scipy.special.chdtr(apart.size, square) < REFUTED)
