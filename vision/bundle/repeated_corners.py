"""Repeats of what cannot move: a corner of the base that a fixed camera sees again and again says as much as one corner
at the weighted mean.

Where it is predicted is the same in every frame, so that the sum of squares over its repeats is that of their mean,
with all their weight, and a constant: adjustments take nearly half of a recording's corners at the price of a few
hundred, to the same optimum.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from vision.corner_observations import Observations, inverse_roots
from vision.predict import State


def merge_repeated_corners(observations: Observations, state: State) -> tuple[Observations, float]:
    """(Observations with such repeats as one each, all in the first frame; what their sum of whitened squares lacks
    then: the repeats' own about their means).

    Corners whose errors are told to hang together in their marker stay as they are.
    """
    o = observations
    rows, group, first = find_repeats(o, state.moving)
    if o.correlation is not None or not len(rows):
        return o, 0.0
    if state.markers is None and (o.points[rows] != o.points[first][group]).any():
        return o, 0.0  # each was told where it is by itself
    root = inverse_roots(o.covariance[rows])
    weight = np.swapaxes(root, 1, 2) @ root
    covariance = np.linalg.inv(group_sums(weight, group))
    uv, frame = (covariance @ group_sums(weight @ o.uv[rows, :, None], group))[..., 0], o.frame.copy()
    frame[first] = 0
    both = merge_rows(replace(o, frame=frame), rows, first, uv, covariance)
    about = o.uv[rows] - uv[group]
    return both.take(np.lexsort((both.corner, both.marker, both.frame, both.camera))), float(
        ((root @ about[..., None]) ** 2).sum()
    )


def find_repeats(
    observations: Observations, moving: Collection[int], inliers: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rows (n,) of the base's corners that fixed cameras see, which of their groups each is of (n,), each group's
    first row (groups,)).

    A group is one corner of one marker in one camera, frame after frame. moving : indices of the cameras that are not
    fixed
    inliers : (all rows,) bool, those that count; all by default
    """
    o = observations
    still = ~o.on_platform & ~np.isin(o.camera, list(moving))
    rows = np.flatnonzero(still if inliers is None else still & inliers)
    key = (o.camera[rows] * (o.marker.max(initial=0) + 1) + o.marker[rows]) * 4 + o.corner[rows]
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    return rows, group, rows[first]


def merge_rows(
    observations: Observations, rows: np.ndarray, first: np.ndarray, uv: np.ndarray, covariance: np.ndarray
) -> Observations:
    """Observations of whose rows (n,) only each group's first (groups,) is left, at uv (groups, 2) px with covariance
    (groups, 2, 2) px^2.
    """
    places, own, left = observations.uv.copy(), observations.covariance.copy(), np.ones(len(observations), bool)
    places[first], own[first] = uv, covariance
    left[rows], left[first] = False, True
    return replace(observations, uv=places, covariance=own).take(left)


def group_sums(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(groups, ...) sums of values (n, ...) over the rows of each group (n,)."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    return np.stack([np.bincount(group, weights=column) for column in flat.T], axis=1).reshape(-1, *values.shape[1:])
