"""Targets on what a chain moves below its last platform: every such stage is measured by the same cameras, a pose in
each frame.

To an adjustment a stage is as good as a platform that is seen in frames of its own: cameras are shared, poses are not.
So the recording's frames are followed by as many for each stage, all are adjusted together, and what was measured is
parted again.
"""

from dataclasses import replace

import numpy as np

from rig.errors import RigError
from vision.corner_observations import Observations
from vision.pose.ambiguous_poses import FAR
from vision.recording_adjustment import Measurement
from vision.targets import MarkerMap


def stage_numbers(markers: MarkerMap) -> list[int]:
    """Numbers (from 1) of the stages below the last that carry markers."""
    return np.unique(markers.stage[markers.stage > 0]).tolist()


def refuse_free_places(places: str) -> None:
    """Raise RigError where places of markers are to be adjusted on a rig with targets on stages."""
    if places == "free":
        raise RigError(
            "places of markers cannot be adjusted on a rig with targets on stages of a chain: the stated "
            "places of all a stage's markers "
            "are what its pose is told by; measure with places as stated"
        )


def separate_stage_frames(observations: Observations, markers: MarkerMap) -> Observations:
    """The corners with those of each stage in frames of their own, which follow all others."""
    o, count = observations, len(observations.frames)
    step = int(o.frames.max()) + 1
    bodies = [0, *stage_numbers(markers)]
    frame = o.frame + count * np.searchsorted(bodies, markers.stage[o.marker])
    order = np.lexsort((o.corner, o.marker, frame, o.camera))
    return replace(
        o.take(order), frames=np.concatenate([o.frames + k * step for k in range(len(bodies))]), frame=frame[order]
    )


def stage_frame_times(t: np.ndarray, markers: MarkerMap) -> np.ndarray:
    """(frames of all bodies,) s, of frames exposed at t (F,) s: one body's come long after another's, and are not its
    neighbours.
    """
    gap = float(np.ptp(t)) + 4 * FAR
    return np.concatenate([t + k * gap for k in range(1 + len(stage_numbers(markers)))])


def separate_stage_measurements(measured: Measurement, markers: MarkerMap) -> Measurement:
    """The Measurement of the platform, with those of the stages in `stages`, of what was measured of corners
    `separate_stage_frames`.
    """
    bodies = [0, *stage_numbers(markers)]
    platform, *below = (_part(measured, k, len(bodies)) for k in range(len(bodies)))
    return replace(platform, stages=dict(zip(bodies[1:], below)))


def _part(m: Measurement, k: int, bodies: int) -> Measurement:
    """Of body k (from 0) of so many."""
    o, a, count = m.observations, m.adjustment, len(m.observations.frames) // bodies
    rows, own = o.frame // count == k, np.searchsorted(o.frames, m.frames) // count == k
    solved = np.isin(o.frames[o.frame], m.frames)
    shift = int(o.frames[k * count] - o.frames[0])
    here = {
        frame - shift: reason for frame, reason in m.unsolved.items() if np.searchsorted(o.frames, frame) // count == k
    }
    used = rows[solved & m.inliers]
    adjustment = replace(
        a,
        state=a.state.at(own),
        residuals=a.residuals[used],
        whitened=a.whitened[used],
        platform_given_cameras=a.platform_given_cameras[own],
        platform_common=a.platform_common[own],
        unknowns=replace(a.unknowns, used=a.unknowns.used[own]),
    )
    part = o.take(rows)
    return replace(
        m,
        frames=m.frames[own] - shift,
        T_base_platform=m.T_base_platform[own],
        covariance=m.covariance[own],
        common=m.common[own],
        unsolved=here,
        observations=replace(part, frames=o.frames[:count], frame=part.frame - k * count),
        inliers=m.inliers[rows],
        residuals=m.residuals[rows],
        weights=m.weights[rows[solved]],
        adjustment=adjustment,
    )
