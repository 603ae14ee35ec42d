"""Excess of pose noise over what is stated.

Factors, estimated from residuals, by which the noise of measured poses exceeds the stated noise.

Noise of a pose moves all closures of struts together, as the geometry has them, and all numbers of an arm's pose alike;
what scatters at one strut or joint moves that one alone. The likelihood of the residuals' covariance distinguishes
them. Its variances are estimated together by Fisher scoring (Jennrich and Sampson, Technometrics 18, 1976, 11-17), and
the Bayesian criterion chooses which of them are needed. Noise is white: residuals that resemble those before them, or
those near them in configuration, refute it.
"""

from typing import NamedTuple

import numpy as np
import scipy
import scipy.sparse.csgraph

from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import MATERIAL
from calib.diagnosis.problems.evidence_interface_and_requested_effects import Value
from rig.array_and_json_types import Booleans, Floats, Integers

KINDS = {"position": slice(0, 3), "rotation": slice(3, 6)}  # of the numbers of a pose
DIRECTION = {"direction": slice(0, 2)}  # of a direction's
CRITERION = 10.0  # of Schwarz, by which common factors must be better than the stated noise
MISSTATED = 5.0  # times the stated noise, beyond which scatter is no mistake about it and stays unexplained
STEPS = 60
SETTLED = 1e-7
SEEN = 1e-6  # share of a residual's variance that a kind of pose noise must make up
REFUTED = 1e-3  # chance that repeated poses agree so well under the noise, or that residuals resemble neighbours so


class PoseResiduals(NamedTuple):
    """Residuals whose covariance is examined. left : (F, a); columns : (F, a, g) their derivatives by what was fitted
    information : (g,) inverse squares of the sizes that priors expect of it, 0 for none
    noise : {position, rotation or direction: (F, a, a)} covariance that the stated noise gives them
    sources : (s, F, a) directions in which a strut or joint alone moves them
    configuration : (F, axes) where they stand; repeated : (k, 2) indices of frames with the same command"""

    left: Floats
    columns: Floats
    information: Floats
    noise: dict[str, Floats]
    sources: Floats
    configuration: Floats
    repeated: Integers


class _Variances(NamedTuple):
    """values : of each matrix' coefficient; likelihood : minus twice its logarithm; information : Fisher's."""

    values: Floats
    likelihood: float
    information: Floats


def noise_factors(residuals: PoseResiduals) -> dict[str, Value] | None:
    """Noise factors: standard deviations over those stated.

    None where these suffice, where struts or joints scatter each for itself, and where what scatters is not white

    Returns {kind of noise: Value with 95 % interval}
    """
    left, columns = residuals.left, residuals.columns
    whole = sum(float(np.einsum("fii->", K)) for K in residuals.noise.values())
    names = [name for name, K in residuals.noise.items() if np.einsum("fii->", K) > SEEN * whole]
    noise = [residuals.noise[name] for name in names]
    own = [np.einsum("fi,fj->fij", v, v) for v in residuals.sources]
    parts, count = np.array([*noise, *own, sum(own)]), len(noise)
    freedom = left.size - columns.shape[2]
    if freedom <= 0:
        return None
    at = np.arange(len(parts))
    common, each, alike = at < count, (at >= count) & (at < len(parts) - 1), at == len(parts) - 1
    start = common.astype(float)

    def criterion(which: Booleans) -> tuple[float, _Variances]:
        found = _variances(residuals, parts, which, start)
        return found.likelihood + which.sum() * np.log(freedom), found

    stated = criterion(at < 0)[0]
    alone = min(criterion(which)[0] for which in (each, alike, *(at == i for i in np.flatnonzero(each))))
    best, found = min((criterion(common | which) for which in (each, alike, at < 0)), key=lambda one: one[0])
    greatest = np.sqrt(found.values[:count].max())
    if best > min(stated - CRITERION, alone) or not MATERIAL <= greatest <= MISSTATED:
        return None
    if _refuted(residuals, np.einsum("p,pfij->fij", found.values, parts)):
        return None
    used = (found.values > start) | common
    error = np.zeros(len(parts))
    error[used] = np.sqrt(np.diag(np.linalg.inv(found.information[np.ix_(used, used)])))
    out = {}
    for name, value, width in zip(names, found.values, error):
        factor, half = float(np.sqrt(value)), float(1.96 * width / (2 * np.sqrt(value)))
        out[name] = Value(factor, "", [max(factor - half, 0.0), factor + half])
    return out


def scaled_pose_covariance(covariance: Floats, factors: dict[str, Value]) -> Floats:
    """Pose covariance (F, k, k) scaled by noise factors.

    Of poses, positions or directions whose standard deviations are scaled by factors, those not estimated by 1.
    """
    times = np.ones(covariance.shape[-1])
    for name, part in slices_by_kind_of_noise(covariance.shape[-1]).items():
        times[part] = float(factors[name].value) if name in factors else 1.0
    return covariance * times[:, None] * times


def slices_by_kind_of_noise(values_per_pose: int) -> dict[str, slice]:
    """Slices of a pose's measured numbers by kind of noise.

    The kinds are position and rotation, or direction.
    Returns {kind of noise: its part} of so many numbers measured of each pose
    """
    return (
        DIRECTION
        if values_per_pose == 2
        else {name: part for name, part in KINDS.items() if part.start < values_per_pose}
    )


def noise_covariance_by_kind(covariance: Floats) -> dict[str, Floats]:
    """Noise covariance by kind of noise.

    Returns {kind of noise: (F, k, k)} that a covariance (F, k, k) is made of, without what position and rotation share
    """
    out = {}
    for name, part in slices_by_kind_of_noise(covariance.shape[-1]).items():
        out[name] = np.zeros_like(covariance)
        out[name][:, part, part] = covariance[:, part, part]
    return out


def _variances(residuals: PoseResiduals, parts: Floats, free: Booleans, least: Floats) -> _Variances:
    """_Variances of residuals whose covariance is a sum of parts (p, F, a, a), most likely.

    free : (p,) which are estimated, from `least` (p,) on; the others stay there
    """
    left, values = residuals.left, least.copy()
    # parts that scatter by half of the mean square: a start from which all can grow or vanish
    scale = np.einsum("pfii->p", parts) / left.size
    values[free] += 0.5 * (left**2).mean() / scale[free] / free.sum()
    found = _at(residuals, parts, values)
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
            found = _at(residuals, parts, new)
            if found[2] <= likelihood + 1e-9:
                break
            share /= 2
        change = np.abs(new - values) * scale
        values = new
        if change.max() < SETTLED * (left**2).mean():
            break
    return _Variances(values, found[2], found[1])


def _at(residuals: PoseResiduals, parts: Floats, values: Floats) -> tuple[Floats, Floats, float]:
    """(gradient (p,) of the log-likelihood, Fisher information (p, p), minus twice the log-likelihood).

    Of the restricted likelihood, from which the columns take freedom (Patterson and Thompson, Biometrika 58, 1971,
    545-554)
    """
    left, columns = residuals.left, residuals.columns
    S = np.einsum("p,pfij->fij", values, parts)
    inverse = np.linalg.inv(S)
    X = inverse @ columns
    gram = np.einsum("fig,fih->gh", columns, X) + np.diag(residuals.information)
    z = np.einsum("fij,fj->fi", inverse, left)
    z = z - X @ np.linalg.solve(gram, np.einsum("fig,fi->g", columns, z))
    B = inverse @ parts
    moved = parts @ X  # (p, F, axes, g)
    solution = np.linalg.solve(gram, np.einsum("fig,pfih->pgh", X, moved, optimize=True))
    gradient = 0.5 * (
        np.einsum("fi,pfij,fj->p", z, parts, z, optimize=True) - np.einsum("pfii->p", B) + np.einsum("pgg->p", solution)
    )
    flat = moved.reshape(len(parts), -1)
    twice = flat @ (inverse @ moved @ np.linalg.inv(gram)).reshape(len(parts), -1).T
    information = 0.5 * (
        np.einsum("pfij,qfji->pq", B, B, optimize=True) - 2 * twice + np.einsum("pgh,qhg->pq", solution, solution)
    )
    likelihood = np.linalg.slogdet(S)[1].sum() + np.linalg.slogdet(gram)[1] + (left * z).sum()
    return gradient, information, float(likelihood)


def _refuted(residuals: PoseResiduals, covariance: Floats) -> bool:
    """Whether poses of repeated commands differ by less than noise of a covariance (F, a, a), or
    residuals resemble their neighbours.
    """
    left = _fitted(residuals, covariance)
    if len(residuals.repeated) and _chance_of_repeats(left, residuals.repeated, covariance) < REFUTED:
        return True
    white = np.linalg.solve(np.linalg.cholesky(covariance), left[..., None])[..., 0]
    chances = [_chance_of_alike(white, pairs) for pairs in _neighbours(residuals.configuration)]
    return min(chances) * len(chances) < REFUTED


def _chance_of_repeats(left: Floats, pairs: Integers, covariance: Floats) -> float:
    """Chance that rows (F, a) of noise of a covariance (F, a, a) lie so close about the mean of the rows that they
    repeat. pairs : (k, 2) indices of rows with the same command; one visited m times makes m (m - 1) / 2 of them
    """
    count = len(left)
    joined = scipy.sparse.csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    group = scipy.sparse.csgraph.connected_components(joined, directed=False)[1]
    square, freedom = 0.0, 0
    for rows in (np.flatnonzero(group == one) for one in np.flatnonzero(np.bincount(group) > 1)):
        information = np.linalg.inv(covariance[rows])
        mean = np.linalg.solve(information.sum(axis=0), np.einsum("fij,fj->i", information, left[rows]))
        off = left[rows] - mean
        square += float(np.einsum("fi,fij,fj->", off, information, off))
        freedom += off.size - left.shape[1]
    return float(scipy.special.chdtr(freedom, square))


def _neighbours(configuration: Floats) -> list[Integers]:
    """[(k, 2)] indices of rows next to each other in time, in each axis of a configuration (F, axes), and in all."""
    order = np.arange(len(configuration))
    sorted_rows = [order, *np.argsort(configuration, axis=0, kind="stable").T]
    at = configuration / np.maximum(configuration.std(axis=0), 1e-12)
    nearest = scipy.spatial.cKDTree(at).query(at, k=2)[1]
    near = np.stack([order, np.where(nearest[:, 0] == order, nearest[:, 1], nearest[:, 0])], axis=1)
    return [*(np.stack([rows[:-1], rows[1:]], axis=1) for rows in sorted_rows), np.unique(np.sort(near), axis=0)]


def _chance_of_alike(white: Floats, pairs: Integers) -> float:
    """Chance that white rows (F, a) of pairs (k, 2) resemble each other so much."""
    product = (white[pairs[:, 0]] * white[pairs[:, 1]]).sum(axis=1)
    return float(scipy.special.ndtr(-product.sum() / max(np.sqrt((product**2).sum()), 1e-300)))


def _fitted(residuals: PoseResiduals, covariance: Floats) -> Floats:
    """(F, a) what the columns leave at their best under a covariance (F, a, a)."""
    X = np.linalg.solve(covariance, residuals.columns)
    gram = np.einsum("fig,fih->gh", residuals.columns, X) + np.diag(residuals.information)
    sizes = np.linalg.solve(gram, np.einsum("fig,fi->g", X, residuals.left))
    return residuals.left - residuals.columns @ sizes
