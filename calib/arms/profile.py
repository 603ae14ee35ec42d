"""What the geometry leaves, as a correction over the configuration space: every joint's own profile, as a Fourier series.

A joint's real angle differs from its command by gears, encoder and the load that its posture brings; all of these are
periodic in angles. The summand rho_j(q) = commanded - effective is a series in the joint's own angle and, more weakly, in its
neighbours'; how large each part is, is found by the evidence, and a part that does not stand out is left out.
Sources: configuration-space patent [0024]-[0031] (the summand); MacKay, Bayesian interpolation, Neural Computation 1992
(sizes by the evidence).
"""

from dataclasses import dataclass

import numpy as np

ORDER = 6  # harmonics of the joint's own angle
START = 1e-4  # rad; size of a part before the data speak
ROUNDS = 60
LARGEST = 2e-4  # rad; where a joint hardly moves, a larger part is geometry in disguise and goes astray outside
SMALLEST = 3e-6  # rad; a part that shrinks below is nothing
SETTLED = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """rho of one joint. axis : its index; own : (2 ORDER,) rad, sine and cosine by harmonic of its own angle;
    others : (n, 2) rad, sine and cosine of every joint's angle (its own row is 0)."""

    axis: int
    own: np.ndarray
    others: np.ndarray

    def __call__(self, q):
        """(...,) rad at joint angles q (..., n) rad."""
        q = np.asarray(q, float)
        own = np.einsum("...f,f->...", _harmonics(q[..., self.axis], len(self.own) // 2), self.own)
        return own + np.sin(q) @ self.others[:, 0] + np.cos(q) @ self.others[:, 1]


def fit(observations, found):
    """A Profile or None per joint, of what an Identified arm leaves in observations of whole poses.

    The geometry's own freedoms are solved for beside the profiles and thrown away, so that neither takes the other's part.
    """
    good = found.inliers
    q, n = observations.q[good], observations.q.shape[1]
    W = np.linalg.inv(np.linalg.cholesky(observations.covariance[good] + np.diag(found.scatter**2)))
    y = (W @ found.residuals[good][..., None]).ravel()
    features = [-_features(q, j) for j in range(n)]
    J = W @ observations.joint_jacobian(found.arm)[good]
    A = np.concatenate([(J[..., j : j + 1] * features[j][:, None, :]).reshape(len(y), -1) for j in range(n)], axis=1)
    group = np.concatenate([2 * j + np.r_[np.zeros(2 * ORDER, int), np.ones(2 * (n - 1), int)] for j in range(n)])
    B = (W @ observations.jacobian(found.arm)[good][..., found.free]).reshape(len(y), -1)
    Q = np.linalg.qr(B)[0]
    A, y = A - Q @ (Q.T @ A), y - Q @ (Q.T @ y)
    weights = _evidence(A, y, group, np.concatenate([_shares(n) for _ in range(n)]))
    parts = []
    for j, w in enumerate(np.split(weights, n)):
        others = np.zeros((n, 2))
        others[np.arange(n) != j] = w[2 * ORDER :].reshape(-1, 2)
        parts.append(Profile(j, w[: 2 * ORDER], others) if w.any() else None)
    return tuple(parts)


def _harmonics(angle, order):
    k = np.arange(1, order + 1)
    turned = np.asarray(angle)[..., None] * k
    return np.stack([np.sin(turned), np.cos(turned)], axis=-1).reshape(*turned.shape[:-1], 2 * order)


def _features(q, axis):
    """(m, 2 ORDER + 2 (n - 1)) harmonics of the own angle, then sine and cosine of the other angles."""
    rest = np.delete(q, axis, axis=1)
    return np.concatenate([_harmonics(q[:, axis], ORDER), np.stack([np.sin(rest), np.cos(rest)], axis=-1).reshape(len(q), -1)], axis=1)


def _shares(n):
    """Relative prior size of the features: a smooth profile's harmonics fall off with their number."""
    return np.concatenate([np.repeat(1 / np.arange(1, ORDER + 1), 2), np.ones(2 * (n - 1))])


def _evidence(A, y, group, shares):
    """(features,) weights of greatest evidence: each group's size set by the fixed point of its well-determined share."""
    A = A * shares
    H, right = A.T @ A, A.T @ y
    size = np.full(group.max() + 1, START)
    for _ in range(ROUNDS):
        alive = size[group] > 0
        prior = 1 / size[group][alive] ** 2
        S = np.linalg.inv(H[np.ix_(alive, alive)] + np.diag(prior))
        w = np.zeros(len(group))
        w[alive] = S @ right[alive]
        known = np.zeros(len(group))
        known[alive] = 1 - prior * np.diag(S)
        before = size.copy()
        for g in np.flatnonzero(size):
            share = known[group == g].sum()
            size[g] = min(np.sqrt((w[group == g] ** 2).sum() / max(share, 1e-12)), LARGEST)
            if size[g] < SMALLEST or share < 1e-3:
                size[g] = 0.0
        if not size.any() or np.allclose(size, before, rtol=SETTLED):
            break
    return np.where(size[group] > 0, w, 0.0) * shares
