"""How much each hypothesis would explain, after calibration's freedoms have taken what they can.

The score S is the drop in the whitened sum of squares. Where a family was searched over a nonlinear parameter that means
nothing under the null, its greatest S is not chi-square: Davies' bound is used (Biometrika 74, 1987, 33-43, eq. 3.4), the search's
own variation standing for the expected upcrossings. Where residuals scatter more from frame to frame than their covariance
says, S is divided by that dispersion (the sandwich), so that correlated corners do not make a case.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2, f as fisher

SWALLOWED = 1e-7  # share of a direction's square that the freedoms must leave for it to count as seen
CHUNK = 64  # shapes at a time
PEAKS = 6  # frequencies that are looked at closely
BEYOND = 0.3  # standard deviation of the logarithm of a parameter above what rigs show
WRONG_SIGN = 12.0  # minus twice the logarithm of the chance that a parameter has the sign that rigs do not show


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """The best of a family. family; shape : {parameter: value}; coefficients : (q,)

    drop : in the whitened sum of squares, dispersion allowed for; p_value : of the family's greatest drop; freedom : parameters fitted,
    nonlinear ones included; dispersion; seen : share of the effect's own size that freedoms leave, 0..1
    curve : (shapes,) drops over the search
    """

    family: object
    shape: dict
    coefficients: np.ndarray
    drop: float
    p_value: float
    freedom: int
    dispersion: float
    seen: float
    curve: np.ndarray

    @property
    def effect(self):
        """The effect with its parameters as scanned."""
        return self.family.effect(self.shape, self.coefficients)

    def gain(self, size):
        """Bayesian information criterion's verdict: how much better than nothing, for residuals of a size."""
        return self.drop - self.freedom * np.log(size)

    def raw_gain(self, size):
        """The same with the dispersion not allowed for, to rank by: what is not modelled yet disperses all, the right answer most."""
        return self.drop * self.dispersion - self.freedom * np.log(size)

    def occam(self, size):
        """What its parameters cost it against other hypotheses, as minus twice a logarithm, for residuals of a size.

        A number that rigs show over some range is as likely at every order of magnitude of it, and hardly ever beyond or of the wrong sign: its
        cost is that of Laplace's approximation. A shape's parameter costs what the search over it shows; all else, the logarithm of the size for
        each (MacKay, Information theory, inference and learning algorithms, 2003, ch. 28).
        """
        asked = {name for name, *_ in self.family.linear} | set(self.shape)
        scalars = [p for p in self.family.kind.parameters if p.size == 1 and p.name in asked and p.role in ("linear", "inverse", "size")]
        sharp = max(np.sqrt(max(self.drop, 0.0) / max(len(scalars), 1)), 1.0)
        cost = sum(_prior_cost(p, getattr(self.effect, p.name), sharp) for p in scalars)
        cost += np.log(size) * (len(self.coefficients) - self.family.tied - sum(p.role != "size" for p in scalars))
        searched = {p.name for p in self.family.kind.parameters if p.role in ("log", "even", "moment")} & set(self.shape)
        if searched and len(self.curve) > 1:
            cost -= 2 * np.log(np.mean(np.exp((self.curve - self.curve.max()) / 2)))
        elif self.family.extra and not any(p.role == "size" for p in scalars):
            cost += self.family.extra * np.log(size)
        return float(cost)


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """score : of a hypothesis in place of a finding; behind : how much less likely it is, as minus twice a logarithm; cosine of the signatures."""

    score: Score
    behind: float
    cosine: float


def _prior_cost(parameter, value, sharp):
    """Of a scalar parameter at a value that is `sharp` standard deviations from nothing: how little of what rigs show the data leave of it."""
    low, high = parameter.usual
    if parameter.role == "inverse":
        low, high, value = 1 / high, 1 / low, 1 / value
    cost = 2 * np.log(sharp * np.log(high / low) * (2 if parameter.signed else 1) / np.sqrt(2 * np.pi))
    if value < 0 and not parameter.signed:
        cost += WRONG_SIGN
    return cost + (np.log(max(abs(value) / high, 1.0)) / BEYOND) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Atoms:
    """Inner products, frame by frame, of a few directions (a) that a frame can be moved in. beta : (F, a) with the residual;
    gamma : (F, a, a) with each other; kappa : (F, a, p) with the freedoms' basis."""

    beta: np.ndarray
    gamma: np.ndarray
    kappa: np.ndarray


def strut_atoms(planes):
    """Atoms of one strut each being longer in one frame (per m)."""
    F, axes = planes.frames, planes.knowledge.axes
    W = planes.W  # (F, a, a): column i is strut i
    y = planes.struts[: F * axes].reshape(F, axes)
    Q = planes.basis.struts[: F * axes].reshape(F, axes, -1)
    return Atoms(np.einsum("fij,fi->fj", W, y), np.swapaxes(W, 1, 2) @ W, np.einsum("fij,fip->fjp", W, Q))


def view_atoms(planes, pixels):
    """Atoms of corner displacements (n, 2, a) px, in the observations' order, frame by frame.

    The residual and the basis stand square to each frame's own poses, so the displacements need not be freed of them first.
    """
    k, axes = planes.knowledge, planes.knowledge.axes
    F, a, p = planes.frames, pixels.shape[2], planes.basis.struts.shape[1]
    beta, gamma, kappa = np.zeros((F, a)), np.zeros((F, a, a)), np.zeros((F, a, p))
    rows = np.flatnonzero(pixels.reshape(len(pixels), -1).any(axis=1)[planes.order])
    V = np.einsum("nij,njk->nik", planes.whiten[rows], pixels[planes.order[rows]]) / planes.sigma
    y, Q, local = (part.reshape(len(planes.order), 2, -1) for part in (planes.image, planes.basis.image, planes.local))
    frame = k.seen.observations.frame[planes.order[rows]]
    edges = np.searchsorted(frame, np.arange(F + 1))
    for f in np.unique(frame):
        part = slice(edges[f], edges[f + 1])
        v, at = V[part].reshape(-1, a), rows[part]
        inner = local[at].reshape(len(v), -1).T @ v
        beta[f] = v.T @ y[at].reshape(-1)
        gamma[f] = v.T @ v - inner.T @ inner
        kappa[f] = v.T @ Q[at].reshape(len(v), -1)
        if axes:
            struts, own = planes.to_struts[f] @ inner, slice(f * axes, (f + 1) * axes)
            beta[f] += struts.T @ planes.struts[own]
            gamma[f] += struts.T @ struts
            kappa[f] += struts.T @ planes.basis.struts[own]
    return Atoms(beta, gamma, kappa)


def framewise(atoms, weights):
    """(b (k, q), G (k, q, q), raw (k, q)) of candidates whose columns weigh atoms by weights (k, F, a, q): projections of the residual,
    Gram matrices with freedoms taken out, and squares before."""
    k, F, a, q = weights.shape
    rows = np.swapaxes(weights.reshape(k, F * a, q), 1, 2)
    b = rows @ atoms.beta.ravel()
    K = rows @ atoms.kappa.reshape(F * a, -1)
    G = rows @ (atoms.gamma @ weights).reshape(k, F * a, q)
    return b, G - K @ np.swapaxes(K, 1, 2), np.einsum("kqq->kq", G).copy()


def stepwise(atoms, w):
    """The same for candidates that weigh all atoms (a) alike by w (k, F), one column for each atom."""
    b = w @ atoms.beta
    K = np.tensordot(w, atoms.kappa, 1)
    G = np.tensordot(w**2, atoms.gamma, 1)
    return b, G - K @ np.swapaxes(K, 1, 2), np.einsum("kqq->kq", G).copy()


def solve(b, G, raw):
    """(drop (k,), coefficients (k, q), rank (k,), seen (k,)) of least squares in the directions that freedoms leave visible."""
    scale = np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(G / scale[:, :, None] / scale[:, None, :])
    kept = values > SWALLOWED
    inverse = np.where(kept, 1 / np.where(kept, values, 1), 0)
    z = np.einsum("kji,kj->ki", vectors, b / scale)
    drop = (z**2 * inverse).sum(axis=1)
    coefficients = np.einsum("kij,kj->ki", vectors, z * inverse) / scale
    return drop, coefficients, kept.sum(axis=1), np.clip(values, 0, 1).max(axis=1)


def whole(b, G, raw):
    """The same for candidates (q = 1) whose size is in their shape: the coefficient is one."""
    b, G, raw = b[:, 0], G[:, 0, 0], raw[:, 0]
    seen = G / np.maximum(raw, 1e-300)
    return np.where(seen > SWALLOWED, 2 * b - G, 0.0), np.zeros((len(b), 0)), np.zeros(len(b), int), np.clip(seen, 0, 1)


def davies(drops, rank, dispersion, frames):
    """p-value of the greatest of drops (k,), scanned in order with `rank` linear parameters; Fisher's F stands for chi-square where
    frames are few."""
    top = max(float(drops.max()), 1e-12)
    rank = max(int(rank), 1)
    tail = fisher.sf(top / rank, rank, max(frames - rank, 1)) if frames < 2000 else chi2.sf(top, rank)
    if len(drops) == 1:
        return float(tail)
    variation = np.abs(np.diff(np.sqrt(np.maximum(drops, 0)))).sum()
    half = rank / 2
    log_bound = np.log(max(variation, 1e-12)) + (half - 0.5) * np.log(top) - top / 2 - half * np.log(2) - gammaln(half)
    heavier = tail / max(chi2.sf(top, rank), 1e-300)  # what few frames add to the tail, added to the bound as well
    return float(min(1.0, tail + np.exp(min(log_bound, 0)) * min(max(heavier, 1.0), 1e6)))


def dispersion(planes, atoms, weights, coefficients):
    """(how much more frames' contributions to the projections scatter than the freedoms' remainder of the columns says, at least 1;
    frames that contribute). weights : (F, a, q)"""
    turned = np.swapaxes(weights, 1, 2)
    pushed = atoms.gamma @ weights
    kappa = turned @ atoms.kappa
    K, (rho, gram) = kappa.sum(axis=0), planes.framewise
    reach = K.T @ coefficients
    contributions = (turned @ atoms.beta[..., None])[..., 0] - rho @ K.T
    expected = (turned @ (pushed @ coefficients)[..., None])[..., 0] - kappa @ reach + (gram @ reach - coefficients @ kappa) @ K.T
    bread = np.einsum("faq,faq->q", weights, pushed) - (K**2).sum(axis=1)
    seen = bread > SWALLOWED * np.einsum("faq,faq->q", weights, pushed)
    meat = ((contributions - expected) ** 2).sum(axis=0)
    active = int(pushed.any(axis=(1, 2)).sum())
    few = active / max(active - len(coefficients), 1)
    ratio = meat[seen] / bread[seen]
    return max(1.0, float(ratio.mean() if seen.any() else 1.0) * few), active


__all__ = ["Atoms", "Rival", "Score", "davies", "dispersion", "framewise", "solve", "stepwise", "strut_atoms", "view_atoms", "whole"]
