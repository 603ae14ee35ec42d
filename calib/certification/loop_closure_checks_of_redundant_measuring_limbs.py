"""Checks of redundant measuring limbs by loop closure.

Six give the platform's pose, each other limb checks it.

A check's own joints and zero are fitted to the poses that the six told while vision held them, so that what it does
not close by later is no matter of vision's frame: the reading of some limb has changed. Source: Merlet, Parallel
Robots, 2nd ed., ch. 9 (redundant sensors).
"""

from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from calib.identify.bounded_and_robust_least_squares_fit import time_block_folds
from calib.models.platform.platform_identification import PRIOR, pose_parameter_jacobian
from rig.array_and_json_types import Floats, Integers
from rig.errors import NotConverged, RigError
from rig.model.design import Design, MeasuringLimbs
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod as mechanism
from rig.model.mechanisms import redundant_strut_best_six_legs_and_loop_closures


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """k limbs beyond the six. limbs : (k,) their numbers among all, from 0; base, platform : (k, 3) m; zeros : (k,) m
    covariance : (k, 7, 7) m^2 of base joint, platform joint and zero; sigma : (k,) m of a reading, what the fit leaves
        included"""

    limbs: Integers
    base: Floats
    platform: Floats
    zeros: Floats
    covariance: Floats
    sigma: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Limbs:
    """A measuring rig that can be read: hexapod : Hexapod of the six limbs that tell poses; covariance : (42, 42) m^2
    of that; sigma : (6,) m of a reading; chosen : (6,) their numbers among all limbs, from 0; checks : Checks, the
    others, or None where nobody has fitted them"""

    hexapod: Hexapod
    covariance: Floats
    sigma: Floats
    chosen: Integers | Integers = field(default_factory=lambda: np.arange(6))
    checks: Checks | None = None

    def pose(self, lengths: Floats, guess: RigidTransform | None = None) -> RigidTransform:
        """T_base_platform (...) of readings (..., limbs) m. Raises NotConverged like the mechanism."""
        return mechanism.forward(np.asarray(lengths)[..., self.chosen], self.hexapod, guess)

    def uncertainty(self, T_base_platform: RigidTransform) -> tuple[Floats, Floats]:
        """(own (..., 6, 6) covariance of a pose's readings, common (..., 6, 42) factor of what the limbs' geometry adds
        to all poses).
        """
        back = np.linalg.inv(mechanism.jacobian(T_base_platform, self.hexapod))
        own = back @ np.diag(self.sigma**2) @ np.swapaxes(back, -1, -2)
        half = np.linalg.cholesky((self.covariance + self.covariance.T) / 2)
        return cast(Floats, own), pose_parameter_jacobian(T_base_platform, self.hexapod) @ half


STEPS, SETTLED = 20, 1e-11  # of fitting a leg; m at which it ends
FOLDS = 4  # stretches of poses, each told by what was fitted to the others
RARE = 1e-6  # share of honest poses at which the checks do not close
IN_A_ROW = 3  # poses that do not close, from which it is no single wrong reading
WHO = "The measuring limbs no longer agree with one another"
CLEAR = 0.5  # share of the squares that one limb must explain to be named


@dataclass(frozen=True, slots=True)
class UnclosedLimb:
    """at : index of the pose at which it is sure; limb : number (from 1) of the limb that explains best what does not
    close, None where none does alone; size : m by which that one is longer than it reads."""

    at: int
    limb: int | None
    size: float

    def __str__(self) -> str:
        if self.limb is None:
            return f"{IN_A_ROW} consecutive poses do not close, and no single limb explains it"
        return (
            f"the limbs do not close: limb {self.limb} is longer by {self.size * 1e6:+.1f} um than it reads, or "
            "its reading has changed"
        )


def best_six_limbs(stated: MeasuringLimbs, home: RigidTransform, T: RigidTransform) -> Integers:
    """Numbers (6,), from 0, of the six limbs that determine poses (n,) best.
    Raises RigError for fewer than six, and where no six hold the platform.
    """
    of = leg_set_of_stated_limbs(stated, home)
    return (
        np.arange(redundant_strut_best_six_legs_and_loop_closures.SIX)
        if len(of.names) == redundant_strut_best_six_legs_and_loop_closures.SIX
        else redundant_strut_best_six_legs_and_loop_closures.best_six_leg_indices(of, T)
    )


def leg_set_of_stated_limbs(
    stated: MeasuringLimbs, home: RigidTransform
) -> redundant_strut_best_six_legs_and_loop_closures.RedundantLegs:
    """Legs of all limbs as stated in rig.toml.

    home : T_base_platform.
    Raises RigError for fewer than six
    """
    _require_six_limbs(stated)
    n = len(stated.channels)
    return redundant_strut_best_six_legs_and_loop_closures.combine_leg_sets(
        [("m", stated, np.full(n, stated.length_sigma), np.zeros((7 * n, 7 * n)))], home
    )


def _require_six_limbs(stated: MeasuringLimbs) -> None:
    """Raise RigError for limbs that tell no pose."""
    n = len(stated.channels)
    if n < redundant_strut_best_six_legs_and_loop_closures.SIX:
        raise RigError(
            f"rig.toml has {n} measuring limb{'s' * (n > 1)} in [insitu], and a platform has six freedoms: "
            "fewer than six lengths determine no "
            "pose. `rig limbs closures` uses them as checks in addition to the struts"
        )


def has_six_measuring_limbs(design: Design) -> bool:
    """Whether a design has six measuring limbs that give its platform's pose."""
    return (
        design.insitu is not None
        and design.mechanism.plates is not None
        and len(design.insitu.channels) >= redundant_strut_best_six_legs_and_loop_closures.SIX
    )


def fit_redundant_limb_checks(limbs: Limbs, stated: MeasuringLimbs, lengths: Floats) -> Checks:
    """Checks of redundant limbs, fitted to lengths.

    Joints and zeros of all limbs but the six, fitted to lengths (n, limbs) m.
    """
    others = np.setdiff1d(np.arange(len(stated.channels)), limbs.chosen)
    T = limbs.pose(lengths)
    start = Checks(
        others,
        stated.base_joints[others],
        stated.platform_joints[others],
        stated.zeros[others],
        np.zeros((len(others), 7, 7)),
        np.full(len(others), stated.length_sigma),
    )
    if not len(others):
        return start
    spread = np.einsum("nii->ni", _closures(limbs, start, lengths).covariance)
    p, covariance, sigma = zip(
        *(
            _leg(T, lengths[:, i], np.r_[start.base[k], start.platform[k], start.zeros[k]], spread[:, k])
            for k, i in enumerate(others)
        )
    )
    found = np.array(p)
    return Checks(
        others, found[:, :3], found[:, 3:6], found[:, 6], np.array(covariance), np.hypot(stated.length_sigma, sigma)
    )


def _leg(T: RigidTransform, read: Floats, stated: Floats, variance: Floats) -> tuple[Floats, Floats, float]:
    """(joints and zero (7,) m, covariance (7, 7) m^2, scatter m beyond what is expected) of one leg that read (n,) m at
    poses (n,).

    stated : (7,) m, where it starts and PRIOR holds it; variance : (n,) m^2 of what it reads less what the pose says
    """
    p, weight = stated.copy(), 1 / np.sqrt(variance)
    for _ in range(STEPS):
        one = redundant_strut_best_six_legs_and_loop_closures.RedundantLegs(
            ("m",), p[None, :3], p[None, 3:6], p[6:], T[0], np.ones(1), np.zeros((7, 7))
        )
        predicted, A = (
            redundant_strut_best_six_legs_and_loop_closures.leg_lengths_and_pose_and_base_jacobians(one, T)[0][:, 0],
            redundant_strut_best_six_legs_and_loop_closures.leg_parameter_jacobians(one, T)[:, 0],
        )
        rows = np.concatenate([A * weight[:, None], np.eye(7) / PRIOR])
        right = np.concatenate([(read - predicted) * weight, (stated - p) / PRIOR])
        step = np.linalg.lstsq(rows, right)[0]
        p = p + step
        if np.abs(step).max() < SETTLED:
            left = (read - predicted - A @ step) * weight
            excess = (left**2).sum() / max(len(read) - 7, 1) - 1
            surely = excess > 3 * np.sqrt(2 / len(read))
            return p, np.linalg.inv(rows.T @ rows), float(np.sqrt(excess * variance.mean())) if surely else 0.0
    raise NotConverged(
        f"the joints of a measuring limb do not settle: the last step was {np.abs(step).max():.3g} m",
        np.zeros(0, int),
        stated,
        np.abs(step),
    )


def _closures(
    limbs: Limbs, checks: Checks, lengths: Floats
) -> redundant_strut_best_six_legs_and_loop_closures.LegClosures:
    """Closures of the checks, poses by the six. lengths : (n, limbs) m"""
    m = limbs.hexapod
    covariance = scipy.linalg.block_diag(
        np.zeros((42, 42)), *checks.covariance
    )  # checks are fitted to what the six tell
    order = np.r_[limbs.chosen, checks.limbs].astype(int)
    of = redundant_strut_best_six_legs_and_loop_closures.RedundantLegs(
        tuple(f"m{i + 1}" for i in order),
        np.vstack([m.base_joints, checks.base]),
        np.vstack([m.platform_joints, checks.platform]),
        np.r_[m.strut_zeros, checks.zeros],
        m.home,
        np.r_[limbs.sigma, checks.sigma],
        covariance,
    )
    return redundant_strut_best_six_legs_and_loop_closures.leg_closures(of, lengths[:, order], np.arange(6))


def held_out_redundant_limb_errors_and_sigma(
    limbs: Limbs, stated: MeasuringLimbs, lengths: Floats
) -> tuple[Floats, Floats]:
    """Held-out errors (n, k) m of the redundant limbs and their expected sigma.

    Joints fitted elsewhere.
    """
    fold, count = (
        time_block_folds(len(lengths), FOLDS),
        len(stated.channels) - redundant_strut_best_six_legs_and_loop_closures.SIX,
    )
    error, sigma = np.zeros((len(lengths), count)), np.ones((len(lengths), count))
    for k in np.unique(fold) if count else ():  # of six alone nothing is over to be checked
        found = _closures(limbs, fit_redundant_limb_checks(limbs, stated, lengths[fold != k]), lengths[fold == k])
        error[fold == k], sigma[fold == k] = found.error, np.sqrt(np.einsum("nii->ni", found.covariance))
    return error, sigma


def fitted_limbs_with_sigmas_and_covariance(
    limbs: Limbs, stated: MeasuringLimbs
) -> tuple[MeasuringLimbs, Floats, Floats]:
    """Limbs as fitted, their sigmas (n,) m, and covariance.

    Sigmas are of their readings; the covariance (7 n, 7 n) m^2 is of all their parameters.
    """
    n, m, six = len(stated.channels), limbs.hexapod, limbs.chosen
    base, platform, zeros = np.array(stated.base_joints), np.array(stated.platform_joints), np.array(stated.zeros)
    base[six], platform[six], zeros[six] = m.base_joints, m.platform_joints, m.strut_zeros
    sigma, covariance = np.full(n, stated.length_sigma), np.zeros((7 * n, 7 * n))

    def places(which: Integers) -> Integers:
        """(7 k,) of the parameters of limbs (k,) among all: their base joints, platform joints, zeros."""
        joints = (3 * which[:, None] + np.arange(3)).ravel()
        return np.concatenate([joints, 3 * n + joints, 6 * n + which])

    sigma[six], covariance[np.ix_(places(six), places(six))] = limbs.sigma, limbs.covariance
    c = limbs.checks
    if c is not None:
        base[c.limbs], platform[c.limbs], zeros[c.limbs], sigma[c.limbs] = c.base, c.platform, c.zeros, c.sigma
        for i, own in zip(c.limbs, c.covariance):
            covariance[np.ix_(places(np.array([i])), places(np.array([i])))] = own
    return replace(stated, base_joints=base, platform_joints=platform, zeros=zeros), sigma, covariance


def first_unclosed_limb(limbs: Limbs, lengths: Floats) -> UnclosedLimb | None:
    """First limb whose loop does not close (UnclosedLimb).

    Its loop closure error is beyond noise at several poses in a row.
    None where all close.
    lengths : (n, limbs) m
    Raises NotConverged for readings that close on no pose
    """
    checks = limbs.checks
    if checks is None or not len(checks.limbs) or len(lengths) < IN_A_ROW:
        return None
    found = _closures(limbs, checks, lengths)
    square = np.einsum("nc,nc->n", found.error, np.linalg.solve(found.covariance, found.error[..., None])[..., 0])
    open_ = square > scipy.special.chdtri(len(checks.limbs), RARE)
    run = np.flatnonzero(np.convolve(open_, np.ones(IN_A_ROW), "valid") == IN_A_ROW)
    if not len(run):
        return None
    at = int(run[0]) + IN_A_ROW - 1
    some = _closures(limbs, checks, lengths[run[0] : at + 1])
    worst = int(some.share.argmax())
    order = np.r_[limbs.chosen, checks.limbs]
    return UnclosedLimb(at, int(order[worst]) + 1 if some.share[worst] > CLEAR else None, float(-some.off[worst]))
