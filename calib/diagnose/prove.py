"""Whether an effect predicts what it was not fitted to: whole stretches of time held out in turn, with and without it."""

from dataclasses import dataclass

import numpy as np

from calib.diagnose.corners import edges_of
from calib.diagnose.planes import Column
from calib.samples import blocks

FOLDS, SHORTER = 5, 4
RIDGE = 1e-9  # keeps directions that a training set cannot see where they stood


@dataclass(frozen=True, slots=True)
class Proof:
    """Held-out misfit without an effect and with it, and what noise alone leaves; unit "m" (struts) or "px" (corners).

    gain : by which the whitened sum of squares falls on held-out frames, in standard errors of its sum over stretches of frames; what
    is known of the corner finder beforehand was fitted to no frame either, and counts with them
    """

    before: float
    after: float
    floor: float
    unit: str
    gain: float


def prove(settled, numbers, plane):
    """Proof of some admitted effects (their numbers) together, in a plane: "struts" or "view", all else fitted on the same stretches.

    settled : Settled with all admitted
    """
    planes, k = settled.planes, settled.knowledge
    whole = planes if settled.column is None else planes.without(settled.column)
    fold = _folds(planes.frames, [k.effects[i] for i in numbers])
    after = _left(whole, whole.image, whole.struts, fold)
    others = [i for i, c in enumerate(settled.coordinates) if c.effect not in numbers]
    column = settled.column
    kept = None if not others else Column(None if column.image is None else column.image[:, others], column.struts[:, others], None)
    bare = planes if kept is None else planes.without(kept)
    done = _change(planes, [e for i, e in enumerate(k.effects) if i not in numbers])
    image = planes.image if done.image is None else planes.image + done.image[:, 0]
    before = _left(bare, image, planes.struts + done.struts[:, 0], fold)
    return _compared(planes, before, after, plane)


def _change(planes, effects):
    """Column (1) of what residuals grow by where only these effects are left."""
    k = planes.knowledge
    struts = planes.nothing(1) if not k.axes else planes.whitened((k.effective() - k.effective(tuple(effects)))[..., None])
    if k.seen is None:
        return Column(None, struts)
    moved = planes.fold((k.pixels() - k.pixels(tuple(effects)))[..., None])
    return Column(moved.image, struts + moved.struts)


def _folds(frames, effects):
    """(F,) which frames are held out together: a stretch of time; where an effect happens at one time, several shorter ones, so that what comes
    before it and after it is never held out whole."""
    count = min(FOLDS, frames // 4)
    return blocks(frames, min(SHORTER * FOLDS, frames // 4)) % count if any(e.sudden for e in effects) else blocks(frames, count)


def _left(planes, image, struts, fold):
    """(image (2n,), struts (F axes,), finder (cameras,)) residuals of frames that were held out, freedoms and admitted parameters fitted on the
    others; and in standard deviations the biases of edges that the corner finder must have for all frames."""
    F, axes = planes.frames, planes.knowledge.axes
    Q = planes.basis
    gram = planes.framewise[1]
    right = np.stack([Q.image[a:b].T @ image[a:b] + Q.struts[f * axes : (f + 1) * axes].T @ struts[f * axes : (f + 1) * axes]
                      for f, (a, b) in enumerate(zip(2 * planes.edges[:-1], 2 * planes.edges[1:]))])
    priors = Q.struts[F * axes :]
    finder = [j for _, j in edges_of(planes.names, planes.knowledge.design)]
    known = struts[F * axes :] - priors @ (right.sum(axis=0) + priors.T @ struts[F * axes :])
    out_image, out_struts = image.copy(), struts[: F * axes].copy()
    for hold in np.unique(fold):
        train = fold != hold
        normal = gram[train].sum(axis=0) + priors.T @ priors
        phi = np.linalg.solve(normal + RIDGE * np.eye(len(normal)), right[train].sum(axis=0) + priors.T @ struts[F * axes :])
        for f in np.flatnonzero(~train):
            rows = slice(2 * planes.edges[f], 2 * planes.edges[f + 1])
            out_image[rows] -= Q.image[rows] @ phi
            out_struts[f * axes : (f + 1) * axes] -= Q.struts[f * axes : (f + 1) * axes] @ phi
    return out_image, out_struts, known[finder]


def _compared(planes, before, after, plane):
    F, axes = planes.frames, planes.knowledge.axes
    squares = []
    for image, struts, _ in (before, after):
        per_frame = np.add.reduceat(np.r_[image**2, 0.0], 2 * planes.edges[:-1]) * (np.diff(planes.edges) > 0) if len(image) else np.zeros(F)
        squares.append(per_frame + (struts.reshape(F, axes) ** 2).sum(axis=1))
    fold = blocks(F, min(20, F // 2))
    gain = np.bincount(fold, weights=squares[0] - squares[1])
    error = np.sqrt(len(gain)) * gain.std(ddof=1) if len(gain) > 1 else np.inf
    gained = float((gain.sum() + before[2] @ before[2] - after[2] @ after[2]) / max(error, 1e-300))
    if plane == "struts":
        inverse = np.linalg.inv(planes.W)
        figures = [np.sqrt(np.mean((inverse @ struts.reshape(F, axes, 1)) ** 2)) for _, struts, _ in (before, after)]
        floor = np.sqrt(np.mean(np.einsum("fij,fij->fi", inverse, inverse)))
        return Proof(float(figures[0]), float(figures[1]), float(floor), "m", gained)
    px = corner_noise(planes)
    degrees = len(planes.image) - planes.local.shape[1] * F
    figures = [px * np.sqrt((image**2).sum() / degrees) for image, *_ in (before, after)]
    return Proof(float(figures[0]), float(figures[1]), px, "px", gained)


def corner_noise(planes):
    """px, standard deviation of a corner per axis, in the middle of all."""
    if not len(planes.image):
        return 0.0
    return float(planes.sigma * np.sqrt(np.median(np.einsum("nii->n", planes.knowledge.seen.observations.covariance)) / 2))


def overall(settled, plane):
    """Proof of all admitted effects together; with none, both figures are the same."""
    return prove(settled, set(range(len(settled.knowledge.effects))), plane)
