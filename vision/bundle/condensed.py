"""Repeats of what cannot move: a corner of the base that a fixed camera sees again and again says as much as one corner at the weighted mean.

Where it is predicted is the same in every frame, so that the sum of squares over its repeats is that of their mean, with all their weight, and a
constant: adjustments take nearly half of a recording's corners at the price of a few hundred, to the same optimum.
"""

from dataclasses import replace

import numpy as np

from vision.observations import Observations, inverse_roots
from vision.predict import State


def condensed(observations: Observations, state: State) -> tuple[Observations, float]:
    """(Observations with such repeats as one each, all in the first frame; what their sum of whitened squares lacks then: the repeats' own about
    their means).

    Corners whose errors are told to hang together in their marker stay as they are.
    """
    o = observations
    rows, group, count = repeats(o, np.ones(len(o), bool), state)
    if o.correlation is not None or not len(rows):
        return o, 0.0
    first = rows[np.unique(group, return_index=True)[1]]
    if state.markers is None and (o.points[rows] != o.points[first][group]).any():
        return o, 0.0  # each was told where it is by itself
    root = inverse_roots(o.covariance[rows])
    weight = np.swapaxes(root, 1, 2) @ root
    uv, frame, covariance, single = o.uv.copy(), o.frame.copy(), o.covariance.copy(), np.ones(len(o), bool)
    covariance[first] = np.linalg.inv(_sums(weight, group))
    uv[first] = (covariance[first] @ _sums(weight @ o.uv[rows, :, None], group))[..., 0]
    frame[first], single[rows], single[first] = 0, False, True
    both = replace(o, uv=uv, frame=frame, covariance=covariance).take(single)
    about = o.uv[rows] - uv[first][group]
    return both.take(np.lexsort((both.corner, both.marker, both.frame, both.camera))), float(((root @ about[..., None]) ** 2).sum())


def repeats(observations: Observations, inliers: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rows (n,) of the base's corners that fixed cameras see, which of their groups each is of (n,), how many each group has (groups,)).

    A group is one corner of one marker in one camera, frame after frame. inliers : (n,) bool, rows that count
    """
    fixed = np.array([i not in state.moving for i in range(len(state.cameras))])
    rows = np.flatnonzero(inliers & ~observations.on_platform & fixed[observations.camera])
    key = (observations.camera[rows] * (observations.marker.max(initial=0) + 1) + observations.marker[rows]) * 4 + observations.corner[rows]
    _, index, count = np.unique(key, return_inverse=True, return_counts=True)
    return rows, index, count


def _sums(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(groups, ...) sums of values (n, ...) over the rows of each group (n,)."""
    flat = values.reshape(len(values), -1)
    return np.stack([np.bincount(group, weights=column) for column in flat.T], axis=1).reshape(-1, *values.shape[1:])
