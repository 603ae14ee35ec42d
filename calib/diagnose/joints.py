"""An arm's poses -> whitened residuals with calibration's freedoms and admitted terms taken out, ready to be searched joint by joint.

A term moves one joint's angle (or, for what moves the whole arm, the target's pose) by a few columns, each of unknown size; sizes
have loose normal priors, so that what the data cannot see stays near nothing. Scatter beyond the instrument's own is estimated.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from calib.samples import blocks

ROUNDS = 6  # of weighing anew
SETTLED = 1e-3  # share by which the scatter may still change
GATE = 6.0  # standard deviations beyond which a pose is left out
LOOSE = 1e-12  # share of a freedom's information that stands for no prior at all


@dataclass(frozen=True, slots=True, eq=False)
class Arms:
    """What is known of n poses of an arm. frame : (n,); t : (n,) s; q : (n, joints) rad, commanded; left : (n, k) m and rad, what
    the geometry left (k = 6, or 3 for positions); freedoms : (n, k, p) change with calibration's parameters; joints : (n, k, joints)
    with the angles; own : (n, k, k) the instrument's covariance; moments : per joint (values (n, columns), names)
    path : effects' Path; channels : {name: (n,)}; lengths : (n, k) change where every link grows by the unit; gate : (n,) bool, poses
    that may be fitted"""

    frame: np.ndarray
    t: np.ndarray
    q: np.ndarray
    left: np.ndarray
    freedoms: np.ndarray
    joints: np.ndarray
    own: np.ndarray
    moments: tuple
    path: object
    channels: dict
    lengths: np.ndarray

    def __len__(self):
        return len(self.t)


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """An admitted hypothesis. family : Family; shape : {name: value}; weights : (n, q) rad per unit at its joint; prior : (q,) sizes"""

    family: object
    shape: dict
    weights: np.ndarray
    prior: np.ndarray

    def columns(self, arms):
        """(n, k, q) m and rad per unit of each coefficient."""
        return columns(arms, self.family.joint, self.weights)


def columns(arms, joint, weights):
    """(n, k, q) change of what is measured with weights (n, q) at a joint (index), or of all links' lengths where joint is None."""
    direction = arms.lengths if joint is None else arms.joints[..., joint]
    return direction[..., None] * weights[:, None, :]


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Freedoms and terms at their best on the poses `used` (n,) bool, weighted by W (n, k, k).

    X : (n, k, p + c) whitened columns; half : (p + c, p + c) upper triangular, half.T half = information with priors; theta : the sizes
    left : (n, k) residual, m and rad, of all poses; y : (n, k) the same whitened; scatter : (k,) beyond the instrument's own
    terms : the admitted; slices : where each one's sizes are in theta
    """

    arms: Arms
    terms: tuple
    used: np.ndarray
    W: np.ndarray
    X: np.ndarray
    half: np.ndarray
    theta: np.ndarray
    left: np.ndarray
    y: np.ndarray
    scatter: np.ndarray
    slices: tuple

    @property
    def size(self):
        """How many independent numbers there are."""
        return int(self.used.sum()) * self.y.shape[1] - self.arms.freedoms.shape[2]

    def taken(self, products):
        """(m, p + c): inner products of columns with X (m, p + c), turned into those with an orthonormal basis of what is taken out."""
        return solve_triangular(self.half, products.T, trans="T", lower=False, check_finite=False).T

    def information(self):
        """(p + c, p + c), priors included."""
        return self.half.T @ self.half

    def inverse(self):
        """(p + c, p + c) upper triangular R, R R.T the covariance of the sizes."""
        return solve_triangular(self.half, np.eye(len(self.half)), lower=False, check_finite=False)

    def covariance(self, number):
        """(c, c) of one term's sizes."""
        part = self.inverse()[self.slices[number]]
        return part @ part.T

    def known(self):
        """How many numbers of the terms the data determine, priors aside."""
        prior = self.prior()
        return float((prior > 0).sum() - prior @ (self.inverse() ** 2).sum(axis=1))

    def prior(self):
        """(p + c,) inverse squares of the sizes that priors expect, 0 for the freedoms."""
        return np.concatenate([np.zeros(self.arms.freedoms.shape[2])] + [1 / term.prior**2 for term in self.terms])

    def cost(self):
        """Whitened squares and the priors' part: what a term's drop is a drop of."""
        return float((self.y[self.used] ** 2).sum() + self.prior() @ self.theta**2)

    def without(self, numbers):
        """The Fit of the other terms with weights and poses as they are: rows and columns of the information struck out."""
        keep = np.ones(self.X.shape[2], bool)
        for number in numbers:
            keep[self.slices[number]] = False
        terms = tuple(term for i, term in enumerate(self.terms) if i not in numbers)
        return self._solved(terms, self.X[..., keep], self.information()[np.ix_(keep, keep)])

    def beside(self, terms):
        """The Fit with more terms, weights and poses as they are."""
        more = np.concatenate([self.W @ term.columns(self.arms) for term in terms], axis=2)
        flat, old = more[self.used].reshape(-1, more.shape[2]), self.X[self.used].reshape(-1, self.X.shape[2])
        cross, own = old.T @ flat, flat.T @ flat
        own[np.diag_indices_from(own)] += np.concatenate([1 / term.prior**2 for term in terms]) + LOOSE * np.diag(own) + 1e-300
        H = np.block([[self.information(), cross], [cross.T, own]])
        return self._solved((*self.terms, *terms), np.concatenate([self.X, more], axis=2), H)

    def _solved(self, terms, X, H):
        target = (self.W @ self.arms.left[..., None])[..., 0]
        factor = cho_factor(H)
        theta = cho_solve(factor, X[self.used].reshape(-1, X.shape[2]).T @ target[self.used].ravel())
        y = target - X @ theta
        return replace(self, terms=terms, X=X, half=np.triu(factor[0]), theta=theta, left=np.linalg.solve(self.W, y[..., None])[..., 0], y=y,
                       slices=_slices(self.arms, terms))

    def part(self, number):
        """(n, q) . sizes: rad (or unit) by which a term moves its joint in every pose."""
        return self.terms[number].weights @ self.theta[self.slices[number]]


def fit(arms, terms=(), train=None, scatter=None, rounds=ROUNDS):
    """Fit of terms on the poses of a mask train (n,), all by default; scatter : (k,) where it starts; rounds : of weighing anew."""
    train = np.ones(len(arms), bool) if train is None else train
    parts = [arms.freedoms] + [term.columns(arms) for term in terms]
    raw = np.concatenate(parts, axis=2)
    free = arms.freedoms.shape[2]
    prior = np.concatenate([np.zeros(free)] + [1 / term.prior**2 for term in terms])
    used, k = train.copy(), arms.left.shape[1]
    scatter = _scatter(arms.left[used], arms.own[used]) if scatter is None else scatter
    for _ in range(rounds):
        W = np.linalg.inv(np.linalg.cholesky(arms.own + np.diag(scatter**2)))
        X = W @ raw
        flat = X[used].reshape(-1, X.shape[2])
        H = flat.T @ flat
        H[np.diag_indices_from(H)] += prior + LOOSE * np.diag(H) + 1e-300
        factor = cho_factor(H)
        theta = cho_solve(factor, flat.T @ (W[used] @ arms.left[used][..., None]).ravel())
        left = arms.left - raw @ theta
        inverse = solve_triangular(factor[0], np.eye(len(H)), lower=False, check_finite=False)
        taken = len(H) - (prior * (inverse**2).sum(axis=1)).sum()
        new = _scatter(left[used], arms.own[used], min(taken / flat.shape[0], 0.8))
        sigma = np.sqrt(np.einsum("nkk->nk", arms.own) + new**2)
        good = train & (np.abs(left) < GATE * sigma).all(axis=1)
        if (good == used).all() and np.allclose(new, scatter, rtol=SETTLED, atol=1e-9):
            break
        used, scatter = good, new
    y = (W @ left[..., None]).reshape(-1, k)
    return Fit(arms, tuple(terms), used, W, X, np.triu(factor[0]), theta, left, y, scatter, _slices(arms, terms))


def _slices(arms, terms):
    edges = np.cumsum([arms.freedoms.shape[2], *(len(term.prior) for term in terms)])
    return tuple(slice(a, b) for a, b in zip(edges[:-1], edges[1:]))


def stretches(count, number):
    """(count,) fold of each pose: whole stretches in time."""
    return blocks(count, min(number, max(count // 4, 2)))


def _scatter(left, own, share=0.0):
    """(k,) scatter beyond the instrument's, one figure for positions, one for rotations; share : of the numbers that were fitted."""
    out = np.zeros(left.shape[1])
    for part in (slice(0, 3), slice(3, 6)):
        if left[:, part].size:
            seen, stated = (left[:, part] ** 2).mean() / (1 - share), np.einsum("nkk->nk", own)[:, part].mean()
            if seen > stated * (1 + 3 * np.sqrt(2 / left[:, part].size)):
                out[part] = np.sqrt(seen - stated)
    return out
