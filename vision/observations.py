"""Corners of a whole recording as flat arrays, sorted so that each camera's and each frame's stand together."""

from dataclasses import dataclass, replace

import numpy as np

UNSTATED_SIGMA = 0.1  # px; a corner's standard deviation until the residuals tell it


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """n corners, sorted by camera, then frame, then marker.

    frames : (F,) frame numbers; frame : (n,) index into frames; camera : (n,) index into the design's cameras
    marker : (n,) row of the marker map; corner : (n,) 0..3; uv : (n, 2) px; covariance : (n, 2, 2) px^2
    points : (n, 3) m, the corner in its body's frame; on_platform : (n,) bool; stated : whether the covariance was given
    """

    frames: np.ndarray
    frame: np.ndarray
    camera: np.ndarray
    marker: np.ndarray
    corner: np.ndarray
    uv: np.ndarray
    covariance: np.ndarray
    points: np.ndarray
    on_platform: np.ndarray
    stated: bool

    def __len__(self):
        return len(self.frame)

    def take(self, index):
        """The same recording with only the corners of an index or mask (n,)."""
        return Observations(self.frames, self.frame[index], self.camera[index], self.marker[index], self.corner[index], self.uv[index],
                            self.covariance[index], self.points[index], self.on_platform[index], self.stated)

    def with_points(self, points):
        """The same corners with other body points (n, 3) m."""
        return Observations(self.frames, self.frame, self.camera, self.marker, self.corner, self.uv, self.covariance, points,
                            self.on_platform, self.stated)

    def groups(self):
        """Index pairs [start, end) of the runs of one camera in one frame."""
        key = self.camera * len(self.frames) + self.frame
        edges = np.flatnonzero(np.diff(key)) + 1
        return np.stack([np.r_[0, edges], np.r_[edges, len(key)]], axis=1) if len(key) else np.zeros((0, 2), int)


def only(observations, solved):
    """The corners of the frames (indices) that are solved, those frames counted anew."""
    kept = observations.take(np.isin(observations.frame, solved))
    return replace(kept, frames=observations.frames[solved], frame=np.searchsorted(solved, kept.frame))


def from_corners(corners, frames, design, marker_map):
    """Observations of recording.Corners whose markers and cameras the design knows. frames : (F,) the frame numbers."""
    names = {camera.name: i for i, camera in enumerate(design.cameras)}
    camera = np.array([names[name] for name in corners.camera], int)
    marker = marker_map.rows(corners.marker)
    frame = np.searchsorted(frames, corners.frame)
    order = np.lexsort((corners.corner, marker, frame, camera))
    covariance = corners.covariance
    stated = covariance is not None
    if not stated:
        covariance = np.broadcast_to(UNSTATED_SIGMA**2 * np.eye(2), (len(frame), 2, 2))
    marker, corner = marker[order], corners.corner[order]
    return Observations(frames, frame[order], camera[order], marker, corner, corners.uv[order], covariance[order],
                        marker_map.corners[marker, corner], marker_map.on_platform[marker], stated)
