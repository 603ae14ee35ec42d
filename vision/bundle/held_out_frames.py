"""Frames held out of an adjustment: are their residuals as large as its covariance says they should be?"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vision.bundle.bundle_adjustment import Adjustment
from vision.bundle.estimate_update import offset_from_stated
from vision.bundle.normal_equations import linearise, normal_equations, schur_complement
from vision.bundle.unknown_priors import adjustment_unknowns
from vision.corner_observations import Observations, observations_of_frames, whitener

FOLDS = 10
ALONE = 1e-9  # of the information in some direction; a stretch whose absence leaves less was the only one to tell it


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Residuals of held-out frames, each frame's own poses fitted anew.

    chi2 : their squares, whitened by the covariance predicted for them: the corners' and that of the shared unknowns,
    had from the other frames; expected : degrees of freedom; scatter : standard error of chi2 / expected
    rms : px per axis, of all held-out corners; corners : how many
    """

    chi2: float
    expected: float
    scatter: float
    rms: float
    corners: int

    @property
    def ratio(self) -> float:
        """Residuals' squares over the predicted ones: 1 where the covariance is true."""
        return self.chi2 / self.expected


@dataclass(frozen=True, slots=True)
class NotHeldOut:
    """Why no stretch could be held out; falsy."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


def crossvalidate(observations: Observations, adjustment: Adjustment, folds: int = FOLDS) -> HeldOut | NotHeldOut:
    """HeldOut over stretches of frames, each left out in turn and predicted from the others; NotHeldOut where that
    takes more frames.

    observations : Observations that were adjusted; adjustment : their Adjustment
    Linear about the optimum: leaving a stretch out takes its share from the reduced normal equations, so nothing is
    adjusted anew. A frame's own poses are fitted to it, as they must be; what is tested is what frames share. A stretch
    without which something shared would be open (a camera seen only there, say) is not asked for.
    """
    if len(observations.frames) < 2:
        return NotHeldOut("there is one frame alone, and nothing to predict it from")
    stated = adjustment.stated
    u, estimate = adjustment_unknowns(
        observations, adjustment.state, stated, adjustment.free, printing=adjustment.printing
    )
    away = offset_from_stated(estimate, stated, u)
    stretch = np.minimum(np.arange(len(observations.frames)) * folds // len(observations.frames), folds - 1)
    parts = []
    for fold in np.unique(stretch):
        frames = np.flatnonzero(stretch == fold)
        part, own_u = observations_of_frames(observations, frames), replace(u, used=u.used[frames])
        residual, derivatives = linearise(
            part, replace(estimate, state=estimate.state.at(frames)), own_u, whitener(part)
        )
        blocks = normal_equations(part, derivatives, own_u, np.zeros(u.shared))
        gain, reduced, right = schur_complement(blocks)
        own = float(np.einsum("fl,fl->", blocks.own, np.linalg.solve(blocks.local, blocks.own[..., None])[..., 0]))
        parts.append(
            (
                reduced - np.diag(u.prior),
                right,
                float((residual**2).sum()) - own,
                2 * len(part) - int(own_u.used.sum()),
                len(part),
            )
        )
    prior, pull = np.diag(u.prior), -u.prior * away
    total, drawn = sum(p[0] for p in parts) + prior, sum(p[1] for p in parts) + pull
    chi2 = expected = square = 0.0
    ratios = []
    root = np.linalg.inv(np.linalg.cholesky(u.basis.T @ total @ u.basis))
    kept = [
        part
        for part in parts
        if not len(root) or np.linalg.eigvalsh(root @ u.basis.T @ (total - part[0]) @ u.basis @ root.T)[0] > ALONE
    ]
    if len(kept) < 2:
        return NotHeldOut("every frame tells something of the cameras that no other does")
    for reduced, right, left, dof, _ in kept:
        H, g = total - reduced, drawn - right
        inner = np.linalg.inv(u.basis.T @ H @ u.basis) if u.basis.shape[1] else np.zeros((0, 0))
        delta = u.basis @ (inner @ (u.basis.T @ g))
        plain = here = left - 2 * right @ delta + delta @ reduced @ delta
        surprise = u.basis.T @ (
            right - reduced @ delta
        )  # what the shared unknowns' uncertainty explains of it (Woodbury)
        here -= surprise @ np.linalg.solve(u.basis.T @ total @ u.basis, surprise)
        chi2, expected, square = chi2 + here, expected + dof, square + plain
        ratios.append(here / dof)
    corners = sum(p[4] for p in kept)
    mean = np.sqrt(np.median(np.einsum("nii->n", observations.covariance)) / 2)
    scatter = float(np.std(ratios, ddof=1) / np.sqrt(len(ratios)))
    return HeldOut(float(chi2), float(expected), scatter, float(mean * np.sqrt(square / (2 * corners))), corners)
