"""Hand cameras, stages and remounted cubes: recordings with them turned into recordings with fixed cameras.

In the platform's own frame such a camera stands still and the base's markers move. So it is measured like any rig, with
base and platform exchanged; the stated pose of the camera in the platform holds the platform's frame, the markers'
stated places the base's.

To an adjustment a stage is as good as a platform that is seen in frames of its own: cameras are shared, poses are not.
So the recording's frames are followed by as many for each stage, all are adjusted together, and what was measured is
parted again.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from rig.errors import RigError
from rig.model.design import Design
from rig.model.pose import adjoint
from rig.recording.recording_folder import Recording
from vision.corner_observations import Observations
from vision.pose.pose_refinement_and_ambiguity import FAR
from vision.predict import predict_corners
from vision.recording_adjustment import Measurement
from vision.targets import MarkerMap


def has_hand_cameras(design: Design) -> bool:
    """Whether the platform carries a design's cameras (mount "hand")."""
    return any(camera.mount == "hand" for camera in design.cameras)


def recording_seen_from_hand(recording: Recording) -> Recording:
    """A recording as seen from the hand: its cameras stand still, and the base's targets are on the body that moves;
    others as they are.
    """
    return (
        replace(recording, design=design_seen_from_hand(recording.design))
        if has_hand_cameras(recording.design)
        else recording
    )


def design_seen_from_hand(design: Design) -> Design:
    """The Design seen from the hand: cameras fixed, the targets on the moving body."""
    cameras = tuple(replace(camera, mount="fixed") for camera in design.cameras)
    return replace(
        design, cameras=cameras, targets=tuple(replace(target, body="platform") for target in design.targets)
    )


def invert_measured_poses(measured: Measurement) -> Measurement:
    """The Measurement with inverted poses, with their covariances.

    T exp(xi) of the one is T^-1 exp(-Ad xi) of the other, with Ad that of T.
    """
    seen = adjoint(measured.T_base_platform)
    return replace(
        measured,
        T_base_platform=measured.T_base_platform.inv(),
        covariance=seen @ measured.covariance @ np.swapaxes(seen, 1, 2),
        common=-seen @ measured.common,
    )


def _stage_numbers(markers: MarkerMap) -> list[int]:
    """Numbers (from 1) of the stages below the last that carry markers."""
    return np.unique(markers.stage[markers.stage > 0]).tolist()


def require_stated_marker_places(places: str) -> None:
    """Require stated places of markers on a rig with targets on stages. Raises RigError where places are free."""
    if places == "free":
        raise RigError(
            "positions of markers cannot be adjusted on a rig with targets on stages of a chain: the stated "
            "places of all a stage's markers "
            "determine its pose; measure with positions as stated"
        )


def separate_stage_frames(observations: Observations, markers: MarkerMap) -> Observations:
    """Observations with the corners of each stage in separate frames, after all other frames."""
    o, count = observations, len(observations.frames)
    step = int(o.frames.max()) + 1
    bodies = [0, *_stage_numbers(markers)]
    frame = o.frame + count * np.searchsorted(bodies, markers.stage[o.marker])
    order = np.lexsort((o.corner, o.marker, frame, o.camera))
    return replace(
        o.take(order), frames=np.concatenate([o.frames + k * step for k in range(len(bodies))]), frame=frame[order]
    )


def stage_frame_times(t: Floats, markers: MarkerMap) -> Floats:
    """(frames of all bodies,) s, times of the stage frames, each body's far from the others' in time."""
    gap = float(np.ptp(t)) + 4 * FAR
    return np.concatenate([t + k * gap for k in range(1 + len(_stage_numbers(markers)))])


def separate_stage_measurements(measured: Measurement, markers: MarkerMap) -> Measurement:
    """The Measurement with each stage's separate from the platform's, in its field `stages`."""
    bodies = [0, *_stage_numbers(markers)]
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


def is_on_remounted_cube(observations: Observations, design: Design, markers: MarkerMap) -> Booleans:
    """(n,) bool, whether a corner is on a remounted cube: one taken off since its place was stated."""
    names = {target.name for target in design.targets if target.turned is not None}
    return np.array([name in names for name in markers.target])[observations.marker]


def measure_without_remounted_cubes(
    observations: Observations, on_remounted_cube: Booleans, measure: Callable[[Observations], Measurement]
) -> Measurement:
    """Measurement without the corners on remounted cubes, which are only listed as outliers.

    on_remounted_cube : (n,) bool, of each corner; measure : of Observations. Raises what it raises
    """
    if not on_remounted_cube.any():
        return measure(observations)
    found = measure(observations.take(~on_remounted_cube))
    covariance, inliers, residuals = (
        observations.covariance * found.factor,
        np.zeros(len(on_remounted_cube), bool),
        np.full((len(on_remounted_cube), 2), np.nan),
    )
    covariance[~on_remounted_cube], inliers[~on_remounted_cube], residuals[~on_remounted_cube] = (
        found.observations.covariance,
        found.inliers,
        found.residuals,
    )
    solved = np.isin(observations.frames[observations.frame], found.frames)
    weights = covariance.copy()
    weights[solved & ~on_remounted_cube] = found.weights
    seen = replace(observations, covariance=covariance)
    at = np.flatnonzero(solved & on_remounted_cube)
    kept = seen.take(at)
    kept = replace(kept, frames=found.frames, frame=np.searchsorted(found.frames, kept.frames[kept.frame]))
    residuals[at] = kept.uv - predict_corners(kept, found.adjustment.state)[0]
    return replace(found, observations=seen, inliers=inliers, residuals=residuals, weights=weights[solved])
