"""What is foretold -> what it is worth: information expected on a question, and the chance that it settles it."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from calib.diagnose.engine.selection_policy import PLATFORM
from calib.experiment.experiment_question import Prediction

DRAWS = 400  # outcomes that are looked at
SEED = 0


@dataclass(frozen=True, slots=True)
class Information:
    """bits : expected on which hypothesis holds; settles : chance that one is left alone; right : that it is the one
    that holds.
    """

    bits: float
    settles: float
    right: float


def experiment_information(odds: np.ndarray, expected: Prediction, behind: np.ndarray) -> Information:
    """Information of an experiment whose outcome is drawn many times: from each hypothesis as often as its odds (h,)
    say.

    behind : (h,) how much less likely the data so far make each, as minus twice a logarithm
    One is left alone where all others are less likely by the odds from which a diagnosis tells apart; those that do
    nearly the same, by what the data so far and the experiment say
    """
    rng, h = np.random.default_rng(SEED), len(odds)
    roots = [np.linalg.cholesky(C) for C in expected.covariances]
    numbers = np.maximum(np.round(DRAWS * odds).astype(int), 4)
    logs, truth, weight = [], [], []
    for k in range(h):
        z = expected.means[k] + rng.normal(size=(numbers[k], expected.means.shape[1])) @ roots[k].T
        logs.append(np.stack([_log_likelihood(z, expected.means[g], roots[g]) for g in range(h)], axis=1))
        truth += [k] * numbers[k]
        weight += [odds[k] / numbers[k]] * numbers[k]
    likelihood = np.concatenate(logs)
    posterior = likelihood + np.log(odds)
    posterior -= posterior.max(axis=1, keepdims=True)
    best, w, rows = posterior.argmax(axis=1), np.array(weight), np.arange(len(truth))
    of_all = likelihood - behind / 2
    by_data = of_all - of_all[rows, best][:, None] < -PLATFORM.alike / 2
    apart = (posterior < -PLATFORM.alike / 2) & ((np.abs(expected.cosines[best]) <= PLATFORM.cosine) | by_data)
    apart[rows, best] = True
    alone = apart.all(axis=1)
    share = np.exp(posterior)
    share /= share.sum(axis=1, keepdims=True)
    left = -(share * np.log2(np.maximum(share, 1e-300))).sum(axis=1)
    bits = float(-(odds * np.log2(odds)).sum() - w @ left)
    return Information(max(bits, 0.0), float(w @ alone), float(w @ (alone & (best == np.array(truth)))))


def _log_likelihood(z: np.ndarray, mean: np.ndarray, root: np.ndarray) -> np.ndarray:
    """(n,) of outcomes (n, r) under a Gaussian of a mean (r,) and a covariance's root (r, r), but for a constant."""
    u = solve_triangular(root, (z - mean).T, lower=True)
    return -(u**2).sum(axis=0) / 2 - np.log(np.diag(root)).sum()
