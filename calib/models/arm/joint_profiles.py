"""Profile of each joint's error as a Fourier series, fitted to what an arm's geometry leaves.

Of a slide a metre stands for a radian, and 2 pi metres for a turn.
A joint's real angle differs from its command by gears, encoder and the load that its posture brings. The summand
rho_j(q) = commanded - effective is a series in the joint's own angle, as fine as the poses can tell (an encoder's error
has tens of waves a turn), and, more weakly, in its neighbours'. How large each octave of waves is, is found by the
evidence, and one that does not stand out is left out.
Sources: configuration-space patent [0024]-[0031] (the summand); MacKay, Bayesian interpolation, Neural Computation 1992
(sizes by the evidence).
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from calib.models.arm.identification import Identified
from calib.models.arm.instrument_observations import Observations
from rig.arrays import Floats, Integers

FINEST = 45.0  # waves per turn of the joint; shorter ones are left out
MARGIN = 1.15  # of the joint's travel, half the longest wave: so the ends need not meet
SHARE = 0.1  # of the measured numbers, as many as there may be features
OCTAVES = (0.0, 1.5, 3.0, 6.0, 12.0, 24.0, np.inf)  # waves per turn; each has a size of its own
START = 1e-4  # rad; size of a part before the data speak
ROUNDS = 40
LARGEST = 2e-4  # rad; where a joint hardly moves, a larger part is geometry in disguise and goes astray outside
SMALLEST = 3e-6  # rad; a part that shrinks below is nothing
SETTLED = 3e-2


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """rho of one joint. axis : its index; orders : (k,) waves per turn of its own angle; own : (2 k,) rad, their sines,
    then cosines
    others : (n, 2) rad, sine and cosine of every joint's angle (its own row is 0)."""

    axis: int
    orders: Floats
    own: Floats
    others: Floats

    def __call__(self, q: Floats) -> Floats:
        """(...,) rad at joint angles q (..., n) rad."""
        q = np.asarray(q, float)
        return (
            _waves(q[..., self.axis], self.orders) @ self.own
            + np.sin(q) @ self.others[:, 0]
            + np.cos(q) @ self.others[:, 1]
        )


def fit_joint_profiles(observations: Observations, identified: Identified) -> tuple[Profile | None, ...]:
    """Joint profiles fitted to residuals of an Identified arm: a Profile or None per joint.

    The geometry's own freedoms are solved for beside the profiles and thrown away, so that neither takes the other's
    part.
    """
    good = identified.inliers
    q, n = observations.q[good], observations.q.shape[1]
    W = np.linalg.inv(np.linalg.cholesky(observations.covariance[good] + np.diag(identified.scatter**2)))
    y = (W @ identified.residuals[good][..., None]).ravel()
    orders = [_orders(q[:, j], SHARE * len(y) / n) for j in range(n)]
    features = [-_features(q, j, orders[j]) for j in range(n)]
    J = W @ observations.joint_jacobian(identified.arm)[good]
    A = np.concatenate([(J[..., j : j + 1] * features[j][:, None, :]).reshape(len(y), -1) for j in range(n)], axis=1)
    kinds = len(OCTAVES) + 1
    group = np.concatenate(
        [j * kinds + np.r_[np.tile(np.digitize(orders[j], OCTAVES), 2), np.zeros(2 * (n - 1), int)] for j in range(n)]
    )
    B = (W @ observations.jacobian(identified.arm)[good][..., identified.free]).reshape(len(y), -1)
    Q = np.linalg.qr(B)[0]
    A, y = A - Q @ (Q.T @ A), y - Q @ (Q.T @ y)
    weights = _evidence(A, y, np.unique(group, return_inverse=True)[1])
    parts = []
    for j, w in enumerate(np.split(weights, np.cumsum([f.shape[1] for f in features])[:-1])):
        k = 2 * len(orders[j])
        others = np.zeros((n, 2))
        others[np.arange(n) != j] = w[k:].reshape(-1, 2)
        parts.append(Profile(j, orders[j], w[:k], others) if w.any() else None)
    return tuple(parts)


def _orders(angle: Floats, most: float) -> Floats:
    """(k,) waves per turn, evenly from the longest that the joint's travel tells, at most `most` features of them."""
    step = np.pi / (MARGIN * max(np.ptp(angle), np.pi / FINEST))
    return cast(Floats, step * np.arange(1, max(min(int(FINEST / step), int(most / 2)), 1) + 1))


def _waves(angle: Floats, orders: Floats) -> Floats:
    turned = np.asarray(angle)[..., None] * orders
    return np.concatenate([np.sin(turned), np.cos(turned)], axis=-1)


def _features(q: Floats, axis: int, orders: Floats) -> Floats:
    """(m, 2 k + 2 (n - 1)) waves of the own angle, then sine and cosine of the other angles."""
    rest = np.delete(q, axis, axis=1)
    return np.concatenate(
        [_waves(q[:, axis], orders), np.stack([np.sin(rest), np.cos(rest)], axis=-1).reshape(len(q), -1)], axis=1
    )


def _solved(M: Floats, right: Floats) -> tuple[Floats, Floats]:
    """(M^-1 right, diagonal of M^-1), both (k,), of a positive definite M (k, k). Raises LinAlgError where it is
    none.
    """
    half, failed = dpotrf(M)  # upper; its lower triangle is zero
    if failed:
        raise np.linalg.LinAlgError(f"the matrix of {len(M)} weights is not positive definite")
    w, _ = dpotrs(half, right)
    inverse, _ = dpotri(half)
    return w, np.diag(inverse)


def _evidence(A: Floats, y: Floats, group: Integers) -> Floats:
    """(features,) weights of greatest evidence: each group's size set by the fixed point of its well-determined
    share.
    """
    H, right = A.T @ A, A.T @ y
    size = np.full(group.max() + 1, START)
    for _ in range(ROUNDS):
        alive = size[group] > 0
        prior = 1 / size[group][alive] ** 2
        w, known = np.zeros(len(group)), np.zeros(len(group))
        w[alive], variances = _solved(H[np.ix_(alive, alive)] + np.diag(prior), right[alive])
        known[alive] = 1 - prior * variances
        before = size.copy()
        for g in np.flatnonzero(size):
            share = known[group == g].sum()
            size[g] = min(np.sqrt((w[group == g] ** 2).sum() / max(share, 1e-12)), LARGEST)
            if size[g] < SMALLEST or share < 1e-3:
                size[g] = 0.0
        if not size.any() or np.allclose(size, before, rtol=SETTLED):
            break
    return np.where(size[group] > 0, w, 0.0)
