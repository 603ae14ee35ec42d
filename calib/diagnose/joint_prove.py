"""What an arm's terms are worth on stretches of time that they were not fitted to."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import rankdata

from calib.diagnose.joints import stretches

FOLDS = 5
STRETCHES = 30


def held(now):
    """A function: numbers of terms left out -> ((n,) whitened squares of held-out poses, m RMS of their positions per axis)."""
    fold = stretches(len(now.arms), STRETCHES) % FOLDS
    p = now.X.shape[2]
    target = (now.W @ now.arms.left[..., None])[..., 0]
    rows = [now.used & (fold == k) for k in range(FOLDS)]
    flat = [now.X[r].reshape(-1, p) for r in rows]
    rights = [X.T @ target[r].ravel() for X, r in zip(flat, rows)]
    total, inverses = now.information(), []
    for X in flat:
        H = total - X.T @ X
        H[np.diag_indices_from(H)] *= 1 + 1e-10
        inverses.append(cho_solve(cho_factor(H), np.eye(p)))
    sizes = [P @ (sum(rights) - right) for P, right in zip(inverses, rights)]

    def squares(dropped):
        gone = np.concatenate([np.arange(p)[now.slices[number]] for number in dropped]) if dropped else np.arange(0)
        white = np.zeros(now.y.shape)
        for r, X, P, size in zip(rows, flat, inverses, sizes):
            less = size - P[:, gone] @ np.linalg.solve(P[np.ix_(gone, gone)], size[gone])
            white[r] = target[r] - (X @ less).reshape(-1, white.shape[1])
        left = np.linalg.solve(now.W, white[..., None])[..., 0][now.used, :3]
        return (white**2).sum(axis=1), float(np.sqrt((left**2).mean()))

    return squares


def gain(drop):
    """How surely stretches gain by a drop (n,) of squares, in standard errors: Wilcoxon's signed ranks, since a strong effect's gains are
    uneven (one stretch may hold most of it); none where their sum falls."""
    by = np.bincount(stretches(len(drop), STRETCHES), weights=drop)
    by = by[by != 0]
    if by.sum() <= 0:
        return 0.0
    n = len(by)
    return float(rankdata(np.abs(by)) @ np.sign(by) / np.sqrt(n * (n + 1) * (2 * n + 1) / 6))
