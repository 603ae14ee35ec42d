"""Corner observations of a recording as flat arrays, their whitening, and the merging of repeated corners.

Where a repeated corner is predicted is the same in every frame, so that the sum of squares over its repeats is that of
their mean,
with all their weight, and a constant: adjustments take nearly half of a recording's corners at the price of a few
hundred, to the same optimum.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Design
from rig.recording.corner_and_pose_csv_tables import Corners
from vision.marker_corner_prediction import MarkerMap, State

_COLUMNS = ("frame", "camera", "marker", "corner", "uv", "covariance", "points", "on_platform")
UNSTATED_SIGMA = 0.1  # px; a corner's standard deviation until the residuals tell it


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """n corners, sorted by camera, then frame, then marker.

    frames : (F,) frame numbers; frame : (n,) index into frames; camera : (n,) index into the design's cameras
    marker : (n,) row of the marker map; corner : (n,) 0..3; uv : (n, 2) px; covariance : (n, 2, 2) px^2
    points : (n, 3) m, the corner in its body's frame; on_platform : (n,) bool; stated : whether the covariance was
        given
    correlation : (n, 2, 8) of each corner, whitened by its own covariance, with the four of its marker in that image,
    or None: a marker is fitted as a whole, so its corners' errors are not independent
    motion : (n, 3, 4) of each corner's body, in its own frame, from the frame's exposure to that of the corner's row,
        of a rolling shutter; None where all rows are exposed at once, or nothing moves
    """

    frames: Integers
    frame: Integers
    camera: Integers
    marker: Integers
    corner: Integers
    uv: Floats
    covariance: Floats
    points: Floats
    on_platform: Booleans
    stated: bool
    correlation: Floats | None = None
    motion: Floats | None = None

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, index: Booleans | Integers) -> Observations:
        """The same recording with only the corners of an index or mask (n,)."""
        columns = {name: getattr(self, name)[index] for name in _COLUMNS}
        return replace(
            self,
            **columns,
            correlation=None if self.correlation is None else self.correlation[index],
            motion=None if self.motion is None else self.motion[index],
        )

    def body_points(self, markers: MarkerMap | None) -> Floats:
        """(n, 3) m, where the corners are when their own rows are exposed, in their body's frame at the frame's time.

        markers : MarkerMap that has their places, None for the places that are stated
        """
        points = self.points if markers is None else markers.corners[self.marker, self.corner]
        if self.motion is None:
            return points
        return (self.motion[:, :, :3] @ points[..., None])[..., 0] + self.motion[:, :, 3]

    def with_points(self, points: Floats) -> Observations:
        """The same corners with other body points (n, 3) m."""
        return replace(self, points=points)

    def groups(self) -> Floats:
        """Index pairs [start, end) of the runs of one camera in one frame."""
        key = self.camera * len(self.frames) + self.frame
        edges = np.flatnonzero(np.diff(key)) + 1
        return np.stack([np.r_[0, edges], np.r_[edges, len(key)]], axis=1) if len(key) else np.zeros((0, 2), int)


def empty_observations(frame: int) -> Observations:
    """Empty Observations of one frame.

    No corners.
    """
    none, whole = np.zeros(0), np.zeros(0, int)
    return Observations(
        np.array([frame]),
        whole,
        whole,
        whole,
        whole,
        none.reshape(0, 2),
        none.reshape(0, 2, 2),
        none.reshape(0, 3),
        none.astype(bool),
        True,
    )


def observations_of_frames(observations: Observations, frame_indices: Integers) -> Observations:
    """Observations of the selected frames alone.

    They are of indices (k,), their frames renumbered.
    """
    retained = observations.take(np.isin(observations.frame, frame_indices))
    return replace(
        retained, frames=observations.frames[frame_indices], frame=np.searchsorted(frame_indices, retained.frame)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """What makes errors of all observations independent and of unit size. own : (n, 2, 2) inverse square roots of the
    covariances
    sighting : (n,) which image of which marker; corner : (n,); mixing : (k, 8, 8) of the sightings' corners so
        whitened, or None."""

    own: Floats
    sighting: Floats
    corner: Integers
    mixing: Floats | None

    def __call__(self, errors: Floats) -> Floats:
        """(n, 2) whitened, of errors (n, 2) px."""
        return self.mix((self.own @ errors[..., None]), slice(None))[..., 0]

    def mix(self, X: Floats, rows: slice) -> Floats:
        """Columns X (m, 2, k), whitened by `own`, with what corners of a marker share taken out; rows : slice of whole
        sightings.
        """
        if self.mixing is None or not len(X):
            return X
        sighting, corner = self.sighting[rows], self.corner[rows]
        first = sighting[0]
        together = np.zeros((sighting[-1] + 1 - first, 4, 2, X.shape[2]))
        together[sighting - first, corner] = X
        together = (self.mixing[first : sighting[-1] + 1] @ together.reshape(len(together), 8, -1)).reshape(
            together.shape
        )
        return together[sighting - first, corner]


def inverse_cholesky_factors(covariance: Floats) -> Floats:
    """Inverse Cholesky factors (n, 2, 2) of covariances (n, 2, 2) px^2.
    Raises LinAlgError where one is not positive definite.
    """
    first = np.sqrt(covariance[:, 0, 0])
    below = covariance[:, 1, 0] / first
    second = covariance[:, 1, 1] - below**2
    if not ((covariance[:, 0, 0] > 0) & (second > 0)).all():
        raise np.linalg.LinAlgError("a covariance of corners is not positive definite")
    out = np.zeros(covariance.shape)
    out[:, 0, 0], out[:, 1, 1] = 1 / first, 1 / np.sqrt(second)
    out[:, 1, 0] = -below * out[:, 0, 0] * out[:, 1, 1]
    return out


def whitener_of_observations(observations: Observations) -> Whitener:
    """The Whitener of Observations.

    Inverse roots of their covariances.
    """
    o, own = observations, inverse_cholesky_factors(observations.covariance)
    sighting = np.cumsum(
        np.r_[False, (np.diff(o.camera) != 0) | (np.diff(o.frame) != 0) | (np.diff(o.marker) != 0)][: len(o)]
    )
    if o.correlation is None or not len(o):
        return Whitener(own, sighting, o.corner, None)
    count = sighting[-1] + 1
    R, present = np.zeros((count, 4, 2, 8)), np.zeros((count, 4), bool)
    R[sighting, o.corner], present[sighting, o.corner] = o.correlation, True
    R, present = R.reshape(count, 8, 8), np.repeat(present, 2, axis=1)
    R = np.where(
        present[:, :, None] & present[:, None, :], (R + np.swapaxes(R, 1, 2)) / 2, np.eye(8)
    )  # a corner left out shares nothing
    return Whitener(own, sighting, o.corner, cast(Floats, np.linalg.inv(np.linalg.cholesky(R))))


def correlations_of_whitened_marker_corners(covariance: Floats) -> Floats:
    """Correlations (m, 4, 2, 8) of each whitened corner with its marker's corners, from covariances.

    covariance : (m, 8, 8)
    """
    m = len(covariance)
    blocks = np.linalg.inv(
        np.linalg.cholesky(np.stack([covariance[:, 2 * c : 2 * c + 2, 2 * c : 2 * c + 2] for c in range(4)], axis=1))
    )
    own = np.zeros((m, 4, 2, 4, 2))
    own[:, range(4), :, range(4)] = np.swapaxes(blocks, 0, 1)
    whiten = own.reshape(m, 8, 8)
    return (whiten @ covariance @ np.swapaxes(whiten, 1, 2)).reshape(m, 4, 2, 8)


def observations_from_corners(
    corners: Corners, frames: Integers, design: Design, marker_map: MarkerMap, correlation: Floats | None = None
) -> Observations:
    """Observations made from a recording's Corners, of the markers and cameras that the design knows.

    frames : (F,) the frame numbers

    correlation : (n, 2, 8) of the corners, see Observations, or None
    """
    names = {camera.name: i for i, camera in enumerate(design.cameras)}
    camera = np.array([names[name] for name in corners.camera], int)
    marker = marker_map.rows(corners.marker)
    frame = np.searchsorted(frames, corners.frame)
    order = np.lexsort((corners.corner, marker, frame, camera))
    covariance = corners.covariance
    stated = covariance is not None
    if covariance is None:
        covariance = np.broadcast_to(UNSTATED_SIGMA**2 * np.eye(2), (len(frame), 2, 2))
    marker, corner = marker[order], corners.corner[order]
    return Observations(
        frames,
        frame[order],
        camera[order],
        marker,
        corner,
        corners.uv[order],
        covariance[order],
        marker_map.corners[marker, corner],
        marker_map.on_platform[marker],
        stated,
        None if correlation is None else correlation[order],
    )


def merged_corners_and_lost_squares(observations: Observations, state: State) -> tuple[Observations, float]:
    """Observations with repeated corners merged into weighted means, and the squares lost thereby.

    Corners whose errors are told to hang together in their marker stay as they are.

    Returns (Observations, the lost sum of whitened squares)
    """
    o = observations
    rows, group, first = repeated_base_corner_rows_and_groups(o, state.moving)
    if o.correlation is not None or not len(rows):
        return o, 0.0
    if state.markers is None and (o.points[rows] != o.points[first][group]).any():
        return o, 0.0  # each was told where it is by itself
    root = inverse_cholesky_factors(o.covariance[rows])
    weight = np.swapaxes(root, 1, 2) @ root
    covariance = np.linalg.inv(group_sums(weight, group))
    uv, frame = (covariance @ group_sums(weight @ o.uv[rows, :, None], group))[..., 0], o.frame.copy()
    frame[first] = 0
    both = merge_observation_groups(replace(o, frame=frame), rows, first, uv, covariance)
    about = o.uv[rows] - uv[group]
    return both.take(np.lexsort((both.corner, both.marker, both.frame, both.camera))), float(
        ((root @ about[..., None]) ** 2).sum()
    )


def repeated_base_corner_rows_and_groups(
    observations: Observations, moving_cameras: Collection[int], inliers: Booleans | None = None
) -> tuple[Integers, Integers, Integers]:
    """Rows, groups and first rows of base corners that fixed cameras see repeatedly.

    A group is one corner of one marker in one camera, frame after frame. moving_cameras : indices of the cameras that
    are not fixed
    inliers : (all rows,) bool, those that count; all by default

    Returns (rows (n,), group of each row (n,), first row of each group)
    """
    o = observations
    still = ~o.on_platform & ~np.isin(o.camera, list(moving_cameras))
    rows = np.flatnonzero(still if inliers is None else still & inliers)
    key = (o.camera[rows] * (o.marker.max(initial=0) + 1) + o.marker[rows]) * 4 + o.corner[rows]
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    return rows, group, rows[first]


def merge_observation_groups(
    observations: Observations, rows: Integers, first_rows: Integers, uv: Floats, covariance: Floats
) -> Observations:
    """Observations with each group of rows merged into its first row, at uv (groups, 2) px with covariance."""
    places, own, left = observations.uv.copy(), observations.covariance.copy(), np.ones(len(observations), bool)
    places[first_rows], own[first_rows] = uv, covariance
    left[rows], left[first_rows] = False, True
    return replace(observations, uv=places, covariance=own).take(left)


def group_sums(values: Floats, group: Integers) -> Integers:
    """Sums (groups, ...) of values (n, ...) by group (n,)."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    return np.stack([np.bincount(group, weights=column) for column in flat.T], axis=1).reshape(-1, *values.shape[1:])
