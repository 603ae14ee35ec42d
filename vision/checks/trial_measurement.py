"""A few frames' corners with the rig they are said to be of, and how well the two agree."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rig.errors import NotEnoughData, RigError
from rig.model.design import Design
from rig.recording.recording_folder import Corners
from vision.corner_observations import observations_from_corners
from vision.recording_adjustment import Measurement, measure
from vision.recording_measurement import unsolved_frames
from vision.targets import marker_map

FRAMES = 8  # looked at
# px; a corner farther than this from where it ought to be, or in a frame without a pose, counts as this far off
LOST = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """design : Design as stated; corners : Corners of some frames; frames : (f,) their numbers; t : (f,) s."""

    design: Design
    corners: Corners
    frames: np.ndarray
    t: np.ndarray

    def with_cameras(self, cameras: tuple) -> "Seen":
        """The same with other cameras in the design."""
        return replace(self, design=replace(self.design, cameras=tuple(cameras)))

    def with_targets(self, targets: tuple) -> "Seen":
        """The same with other targets in the design."""
        return replace(self, design=replace(self.design, targets=tuple(targets)))

    def with_corners(self, **columns: Any) -> "Seen":
        """The same with some columns of the corners replaced."""
        return replace(self, corners=replace(self.corners, **columns))


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """misfit : px, RMS of the corners' distances from where they ought to be, none more than LOST; seen : what was
    tried;
    measured : Measurement, None where nothing could be solved; miss : (n,) px per corner in the observations' order, or
        None."""

    misfit: float
    seen: Seen
    measured: Measurement | None
    miss: np.ndarray | None


def sample_frames(
    design: Design, corners: Corners, frames: np.ndarray, t: np.ndarray, count: int = FRAMES
) -> Seen | None:
    """Seen of some frames spread over a recording, of each stretch the one that shows most; None where there are no
    corners.

    frames : (F,) all frames' numbers; t : (F,) s. What is on a chain's stages below the last is left aside, and what
    was put back: its place is told only to what remounting may do
    """
    on_stages = [number for target in design.targets if target.stage for number in target.ids]
    if on_stages:
        design, corners = design.without_stages(), select_corners(corners, ~np.isin(corners.marker, on_stages))
    put_back = [number for target in design.targets if target.turned is not None for number in target.ids]
    if put_back:
        corners = select_corners(corners, ~np.isin(corners.marker, put_back))
    if not len(corners.frame):
        return None
    rich = np.bincount(np.searchsorted(frames, corners.frame), minlength=len(frames))
    richest = [part[np.argmax(rich[part])] for part in np.array_split(np.arange(len(frames)), min(count, len(frames)))]
    picked = np.array([k for k in richest if rich[k]])
    return Seen(design, select_corners(corners, np.isin(corners.frame, frames[picked])), frames[picked], t[picked])


def select_corners(corners: Corners, mask: np.ndarray) -> Corners:
    """Corners of a mask (n,)."""
    rows = np.flatnonzero(mask)
    return Corners(
        corners.frame[rows],
        [corners.camera[i] for i in rows],
        corners.marker[rows],
        corners.corner[rows],
        corners.uv[rows],
        None if corners.covariance is None else corners.covariance[rows],
    )


def measure_sample(seen: Seen, free: tuple[str, ...] = ("poses", "lenses")) -> Trial:
    """Trial of Seen: all of its frames measured, cameras and lenses adjusted as `rig measure` does. free : see
    vision.bundle.bundle_adjustment
    """
    known = np.isin(seen.corners.marker, [number for target in seen.design.targets for number in target.ids])
    corners = seen.corners if known.all() else select_corners(seen.corners, known)
    if not len(corners.frame):
        return Trial(LOST, seen, None, None)
    markers = marker_map(seen.design)
    try:
        measured = measure(
            observations_from_corners(corners, seen.frames, seen.design, markers), seen.design, markers, free
        )
    except (NotEnoughData, RigError, np.linalg.LinAlgError):
        return Trial(LOST, seen, None, None)
    o = measured.observations
    miss = np.minimum(np.nan_to_num(np.linalg.norm(measured.residuals, axis=1), nan=LOST), LOST)
    poor = sorted(set(measured.unsolved) - set(unsolved_frames(measured)))  # too little to see is nobody's mistake
    told = ~np.isin(o.frames[o.frame], poor)
    share = (miss[told] ** 2).sum() + LOST**2 * (~known).sum()
    return Trial(float(np.sqrt(share / max(told.sum() + (~known).sum(), 1))), seen, measured, miss)
