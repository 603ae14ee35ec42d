"""How much each family at an arm's joints would explain, what is admitted and the geometry's freedoms taken out."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from calib.diagnose.joints import Term
from calib.diagnose.scan import Score, davies
from calib.diagnose.sinusoids import sums

CHUNK = 96  # shapes at a time
CLUSTER = 5  # poses in a row whose errors may be alike
REFINE = 8  # halvings of the step about the best order


@dataclass(frozen=True, slots=True, eq=False)
class Atoms:
    """One joint's motion (k whitened numbers a pose), pose by pose. a : (m, k); beta, gamma : (m,) inner products with the residual and
    with itself; chi : (m, p) with the columns of the fit, kappa : (m, p) with an orthonormal basis of theirs"""

    a: np.ndarray
    beta: np.ndarray
    gamma: np.ndarray
    chi: np.ndarray
    kappa: np.ndarray


def atoms(fit, joint):
    """Atoms of the used poses for a joint (index), or for all links' lengths (None)."""
    arms, used = fit.arms, fit.used
    direction = arms.lengths if joint is None else arms.joints[..., joint]
    a = (fit.W[used] @ direction[used][..., None])[..., 0]
    everywhere = np.zeros(fit.y.shape)
    everywhere[used] = a
    chi = (everywhere[:, None, :] @ fit.X)[used, 0]
    return Atoms(a, (a * fit.y[used]).sum(axis=1), (a * a).sum(axis=1), chi, fit.taken(chi))


def normal(atom, w):
    """(b (s, q), G (s, q, q)) of candidates with weights w (s, m, q), what is admitted taken out."""
    turned = np.swapaxes(w, 1, 2)
    b = turned @ atom.beta
    K = (turned.reshape(-1, w.shape[1]) @ atom.kappa).reshape(len(w), w.shape[2], -1)
    return b, (turned * atom.gamma) @ w - K @ np.swapaxes(K, 1, 2)


def scan(fit, families, progress=None, least=0.0):
    """[Score] of all families, the greatest gain first. progress : called with (done, of), or None; least : raw gain of those listed"""
    known, out = {}, []
    for i, family in enumerate(families):
        if family.joint not in known:
            known[family.joint] = atoms(fit, family.joint)
        score = _score(fit, family, known[family.joint], least)
        if score is not None:
            out.append(score)
        if progress:
            progress(i + 1, len(families))
    return sorted(out, key=lambda s: -s.raw_gain(fit.size))


def _score(fit, family, atom, least):
    drops, sizes, ranks = drops_of(fit, family, atom)
    gains = drops - ranks * np.log(fit.size)
    best = int(np.argmax(gains))
    shape = family.shapes[best]
    if family.step:
        step = family.step
        for _ in range(REFINE):
            step /= 2
            near = [{"order": max(shape["order"] + d * step, 0.05)} for d in (-1, 0, 1)]
            found, coefficients, _ = _each(fit, family, atom, near)
            i = int(np.argmax(found))
            shape, top, size = near[i], found[i], coefficients[i]
        if top > drops[best]:
            drops = drops.copy()
            drops[best], sizes[best] = top, size
    coefficients, rank = sizes[best], ranks[best]
    if drops[best] - (np.ceil(rank) + family.extra) * np.log(fit.size) <= least:
        return None
    spread = dispersion(fit, atom, family, shape, coefficients)
    same = ranks == rank
    p = davies(drops[same] / spread, max(round(rank), 1), spread, int(fit.used.sum()))
    p = min(1.0, p * len(np.unique(ranks)))
    return Score(family, shape, coefficients, drops[best] / spread, p, int(np.ceil(rank)) + family.extra, spread, 1.0, drops)


def drops_of(fit, family, atom):
    """(drops (s,), coefficients [s], numbers that the data determine (s,)) of a family's shapes."""
    if family.step:
        return _solved(family, *_orders(family, fit.arms.q[fit.used, family.joint], atom))
    if family.name == "missed_steps":
        return _solved(family, *_steps(family, fit.arms.t[fit.used], atom))
    return _each(fit, family, atom, family.shapes)


def _each(fit, family, atom, shapes):
    drops, sizes, ranks = [], [], []
    for start in range(0, len(shapes), CHUNK):
        part = [family.weights(shape)[fit.used] for shape in shapes[start : start + CHUNK]]
        even = len({w.shape[1] for w in part}) == 1
        for w in [np.stack(part)] if even else [w[None] for w in part]:
            drop, size, rank = _solved(family, *normal(atom, w))
            drops.append(drop)
            sizes += size
            ranks.append(rank)
    return np.concatenate(drops), sizes, np.concatenate(ranks)


def _solved(family, b, G):
    size = np.linalg.solve(G + np.eye(b.shape[1]) / family.prior**2, np.concatenate([b[..., None], G], axis=2))
    return (b * size[..., 0]).sum(axis=1), list(size[..., 0]), np.round(np.einsum("sqq->s", size[..., 1:]), 1)


def _orders(family, q, atom):
    """(b (s, 2), G (s, 2, 2)) of sine and cosine at every order of a family, multiples of its step."""
    at = np.round([shape["order"] / family.step for shape in family.shapes]).astype(int)
    first, count = at.min(), np.ptp(at) + 1
    table = sums(q, np.column_stack([atom.beta, atom.kappa]), family.step, first, count)[at - first]
    table = np.stack([table.imag, table.real], axis=1)  # (s, 2, 1 + p)
    twice = sums(q, atom.gamma[:, None], 2 * family.step, first, count)[at - first, 0]
    whole, K = atom.gamma.sum(), table[:, :, 1:]
    G = np.stack([whole - twice.real, twice.imag, twice.imag, whole + twice.real], axis=1).reshape(-1, 2, 2) / 2
    return table[:, :, 0], G - K @ np.swapaxes(K, 1, 2)


def _steps(family, t, atom):
    """(b (s, 1), G (s, 1, 1)) of a step at each of a family's times."""
    at = np.searchsorted(t, [shape["time"] for shape in family.shapes])
    b, gamma, kappa = (np.concatenate([np.cumsum(part[::-1], axis=0)[::-1], np.zeros((1, *part.shape[1:]))])[at]
                       for part in (atom.beta, atom.gamma, atom.kappa))
    return b[:, None], (gamma - (kappa**2).sum(axis=1))[:, None, None]


def signature(fit, atom, family, shape, coefficients):
    """(m, k) whitened change of the used poses by a candidate of a size, what is admitted taken out."""
    w = family.weights(shape)[fit.used] @ coefficients
    return w[:, None] * atom.a - (fit.X @ cho_solve((fit.half, False), atom.chi.T @ w))[fit.used]


def dispersion(fit, atom, family, shape, coefficients):
    """How much more contributions of stretches of poses scatter than the weights say, at least 1 (the sandwich)."""
    w = family.weights(shape)[fit.used]
    rest, everywhere = fit.y[fit.used] - signature(fit, atom, family, shape, coefficients), np.zeros(fit.y.shape)
    everywhere[fit.used] = rest
    reach = cho_solve((fit.half, False), atom.chi.T @ w)
    pushed = w * (atom.a * rest).sum(axis=1)[:, None] - (everywhere[:, None, :] @ fit.X)[fit.used, 0] @ reach
    square = atom.gamma @ w**2 - ((atom.kappa.T @ w) ** 2).sum(axis=0)
    group = np.arange(len(pushed)) // CLUSTER
    summed = np.stack([np.bincount(group, weights=column) for column in pushed.T], axis=1)
    return max(1.0, float((summed**2).sum() / max(square.sum(), 1e-300)))


def term(score):
    """Term of a Score, at its shape."""
    return shaped(score.family, score.shape)


def shaped(family, shape):
    """Term of a family at a shape."""
    weights = family.weights(shape)
    return Term(family, shape, weights, np.full(weights.shape[1], family.prior))


def reshaped(old, **shape):
    """A Term at another shape."""
    return shaped(old.family, {**old.shape, **shape})
