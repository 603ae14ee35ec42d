"""Corners of a recording -> cameras adjusted and the platform's pose in every frame, with covariance."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.design import Design
from rig.errors import NotEnoughData
from rig.recording import Corners
from vision.adjust import Adjustment, adjust
from vision.locate import View, locate, undistorted
from vision.observations import Observations
from vision.predict import State, predict

GATE = 5.0  # standard deviations; a corner beyond is an outlier (3 in a million of honest ones are)
ROUNDS = 8  # of adjusting and sorting out; a corner that still wavers then stays as it was adjusted
STANDING_GROUPS = 20  # repeated corners from which their standing error can be told
STANDING_PROOF = 4.0  # standard errors by which it must exceed chance
ENOUGH = 50  # degrees of freedom from which the residuals' own scale is trusted over the stated one


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """What a recording's images say.

    design : Design with cameras as adjusted; frames : (f,) numbers of the solved frames
    T_base_platform : RigidTransform (f,); covariance : (f, 6, 6) on the right, cameras' uncertainty included
    common : (f, 6, k) the part of it shared by all frames: error = common[f] z + its own, z ~ N(0, I)
    unsolved : {frame number: reason}; observations : all corners, covariance scaled to the scatter seen
    inliers : (n,) bool; residuals : (n, 2) px, NaN where the frame is unsolved
    noise : px, standard deviation of a corner per axis; standing : px, the part of a corner's error that comes back in every
    frame where neither camera nor marker moves; weights : (k, 2, 2) px^2 covariance of the solved frames' corners with that
    allowed for; factor : what stated covariances were multiplied by
    adjustment : the last Adjustment, for its shared unknowns; used : the Observations it was fitted to
    """

    design: Design
    frames: np.ndarray
    T_base_platform: RigidTransform
    covariance: np.ndarray
    common: np.ndarray
    unsolved: dict[int, str]
    observations: Observations
    inliers: np.ndarray
    residuals: np.ndarray
    noise: float
    standing: float
    weights: np.ndarray
    factor: float
    adjustment: Adjustment
    used: Observations

    def ids(self):
        """Identity of each row of the marker map."""
        return [number for target in self.design.targets for number in target.ids]

    def corners(self):
        """recording.Corners of all observations, with covariance."""
        o, ids = self.observations, self.ids()
        names = [camera.name for camera in self.design.cameras]
        return Corners(o.frames[o.frame], [names[i] for i in o.camera], [ids[i] for i in o.marker], o.corner, o.uv, o.covariance)


def measure(observations, design, marker_map, free=("poses", "lenses"), progress=None):
    """Platform poses of all frames with cameras and lenses adjusted to them.

    observations : Observations; design : Design, nominal; marker_map : MarkerMap
    free : what is adjusted, see `adjust`; progress : called with (done, of) frames located, or None
    Returns Measurement. Raises NotEnoughData where no frame can be solved, with the reasons.
    """
    views = _Views(observations, design.cameras, marker_map)
    cameras = _resect(views, design.cameras) if "poses" in free else {}
    state_cameras = tuple(replace(c, pose=cameras.get(i, c.pose)) for i, c in enumerate(design.cameras))
    poses, moving, unsolved = _locate_frames(views, state_cameras, progress)
    state = State(state_cameras, _filled(poses, len(observations.frames)),
                  {i: _filled(T, len(observations.frames)) for i, T in moving.items()})
    result, solved, inliers, scale = _adjust_robustly(observations, state, free, unsolved)
    keep = np.isin(observations.frame, solved)
    observations = replace(observations, covariance=scale**2 * observations.covariance)
    kept, good = _only(observations, solved), inliers[keep]
    weights, standing = _standing(kept, good, result.state)
    used = replace(kept, covariance=weights).take(good)
    result = adjust(used, result.state, free)
    numbers, common = observations.frames[solved], result.platform_common
    residuals = np.full((len(observations), 2), np.nan)
    residuals[keep] = kept.uv - predict(kept, result.state)[0]
    noise = np.sqrt(np.median(np.einsum("nii->n", kept.covariance)) / 2)
    return Measurement(replace(design, cameras=result.state.cameras), numbers, result.state.platform,
                       result.platform_given_cameras + common @ np.swapaxes(common, 1, 2), common,
                       {int(observations.frames[f]): reason for f, reason in unsolved.items()}, observations, inliers, residuals,
                       float(noise), standing, weights, float(scale**2), result, used)


def _filled(poses, count):
    """RigidTransform (count,) of {frame: pose}, the identity where there is none."""
    return RigidTransform.concatenate([poses.get(f, RigidTransform.identity()) for f in range(count)])


def _only(observations, solved):
    """The corners of the frames (indices) that are solved, those frames counted anew."""
    kept = observations.take(np.isin(observations.frame, solved))
    return replace(kept, frames=observations.frames[solved], frame=np.searchsorted(solved, kept.frame))


class _Views:
    """Views cut out of a recording's observations, the lens taken out of all of them once."""

    def __init__(self, observations, cameras, marker_map):
        self.observations, self.map = observations, marker_map
        self.ideal, self.covariance = undistorted(observations.uv, observations.covariance, observations.camera, cameras)
        self.normals = marker_map.T_body_marker.rotation.as_matrix()[:, :, 2][observations.marker]
        self.focal = np.array([np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]) for camera in cameras])
        self.identity = np.broadcast_to(np.eye(4), (len(cameras), 4, 4))

    def locate(self, rows, T_camera_world, ideal=None):
        """Located or Unsolved from the observations' rows. T_camera_world : (c, 4, 4)."""
        o = self.observations
        ideal = self.ideal[rows] if ideal is None else ideal
        return locate(View(o.points[rows], self.normals[rows], ideal, self.covariance[rows], o.camera[rows], o.marker[rows],
                           o.corner[rows], self.focal, T_camera_world), self.map)


def _resect(views, cameras):
    """{camera index: T_base_camera} of the fixed cameras, from the base's corners, the median over all frames of each."""
    o, found = views.observations, {}
    for i, camera in enumerate(cameras):
        if camera.mount == "moving":
            continue
        rows = np.flatnonzero(~o.on_platform & (o.camera == i))
        key = o.marker[rows] * 4 + o.corner[rows]
        keys, first = np.unique(key, return_index=True)
        ideal = np.array([np.median(views.ideal[rows[key == k]], axis=0) for k in keys]).reshape(-1, 2)
        located = views.locate(rows[first], views.identity, ideal)
        if located:
            found[i] = located.T_world_body.inv()
    return found


def _locate_frames(views, cameras, progress):
    """{frame: T_base_platform}, {moving camera: {frame: T_base_camera}} and {frame: reason}, by frame index."""
    o = views.observations
    poses, unsolved = {}, {}
    moving = {i: {} for i, camera in enumerate(cameras) if camera.mount == "moving"}
    by_frame = np.argsort(o.frame, kind="stable")
    edges = np.searchsorted(o.frame[by_frame], np.arange(len(o.frames) + 1))
    fixed = np.array([camera.pose.inv().as_matrix() for camera in cameras])
    for f in range(len(o.frames)):
        rows = by_frame[edges[f] : edges[f + 1]]
        on = o.on_platform[rows]
        T_camera_world, lost = fixed.copy(), None
        for i in moving:
            located = views.locate(rows[~on & (o.camera[rows] == i)], views.identity)
            if located:
                T_camera_world[i] = located.T_world_body.as_matrix()
                moving[i][f] = located.T_world_body.inv()
            else:
                moving[i][f] = cameras[i].pose
                lost = f"moving camera {cameras[i].name!r} is lost: {located.reason}"
        seen = rows[on]
        if lost and set(o.camera[seen].tolist()) <= set(moving):
            unsolved[f] = lost
            continue
        located = views.locate(seen, T_camera_world)
        if located:
            poses[f] = located.T_world_body
        else:
            unsolved[f] = located.reason
        if progress:
            progress(f + 1, len(o.frames))
    return poses, moving, unsolved


def _adjust_robustly(observations, state, free, unsolved):
    """(Adjustment, solved (f,) frame indices, inliers (n,), scale of the stated standard deviations).

    state : over all frames; unsolved : {frame: reason}, added to. The inliers are those within GATE of where the optimum
    puts them, by the residuals' own scale; a frame whose inliers no longer hold it is given up; repeated until both stand.
    """
    solved = np.array([f for f in range(len(observations.frames)) if f not in unsolved], int)
    inliers, result, rounds = None, None, 0
    while True:
        if not len(solved):
            reasons = sorted(set(unsolved.values()))
            raise NotEnoughData(f"none of {len(observations.frames)} frames could be solved: " + "; ".join(reasons[:5]))
        kept = _only(observations, solved)
        good = _gate(kept, _at(state, solved))
        weak = _unsupported(kept, good, state)
        if weak:
            unsolved.update({int(solved[f]): reason for f, reason in weak.items()})
            solved, inliers = np.delete(solved, list(weak)), None
            continue
        if inliers is not None and (rounds == ROUNDS or (good == inliers).all()):
            break
        inliers, rounds = good, rounds + 1
        result = adjust(kept.take(good), _at(state, solved), free)
        state = _spread(result.state, state, solved)
    everywhere = np.zeros(len(observations), bool)
    everywhere[np.isin(observations.frame, solved)] = inliers
    scale = np.sqrt(result.cost / result.dof) if result.dof >= ENOUGH else 1.0
    return result, solved, everywhere, scale


def _standing(observations, inliers, state):
    """(covariances (n, 2, 2) to weigh corners by, standing error px).

    A base marker seen by a fixed camera stands on the same pixels in every frame, and what the pixel grid does to it comes
    back every time: n repeats are not n observations. Their scatter about their own mean is the noise; what their means miss
    beyond that is the standing error s, and weighing each repeat by C + n s^2 gives all n together the weight of one mean.
    """
    fixed = np.array([i not in state.moving for i in range(len(state.cameras))])
    rows = np.flatnonzero(inliers & ~observations.on_platform & fixed[observations.camera])
    covariance = observations.covariance.copy()
    key = (observations.camera[rows] * (observations.marker.max(initial=0) + 1) + observations.marker[rows]) * 4 + observations.corner[rows]
    _, index, count = np.unique(key, return_inverse=True, return_counts=True)
    if not len(count) or (count > 1).sum() < STANDING_GROUPS:
        return covariance, 0.0
    residual = observations.uv[rows] - predict(observations.take(rows), state)[0]
    mean = np.stack([np.bincount(index, weights=residual[:, c]) / count for c in range(2)], axis=1)
    many = count > 1
    within = ((residual - mean[index])[many[index]] ** 2).sum() / (2 * (count[many] - 1).sum())
    unknowns = 12 * len(np.unique(observations.camera[rows]))  # what each camera bends to follow its standing errors
    between = (mean[many] ** 2).sum() / max(2 * many.sum() - unknowns, 1)
    chance = within * np.mean(1 / count[many])
    excess = between - chance
    if excess < STANDING_PROOF * chance / np.sqrt(many.sum()):
        return covariance, 0.0
    covariance[rows] += (count[index] * excess)[:, None, None] * np.eye(2)
    return covariance, float(np.sqrt(excess))


def _at(state, solved):
    return State(state.cameras, state.platform[solved], {i: T[solved] for i, T in state.moving.items()})


def _spread(found, state, solved):
    """The state over all frames with the solved ones' poses put in."""
    def put(all_frames, some):
        matrices = all_frames.as_matrix()
        matrices[solved] = some.as_matrix()
        return RigidTransform.from_matrix(matrices)

    return State(found.cameras, put(state.platform, found.platform), {i: put(state.moving[i], T) for i, T in found.moving.items()})


def _gate(observations, state):
    """(n,) bool, the corners within GATE of where the state puts them, by the residuals' own scale."""
    whitener = np.linalg.inv(np.linalg.cholesky(observations.covariance))
    uv, ahead = predict(observations, state)
    square = ((whitener @ (observations.uv - uv)[..., None])[..., 0] ** 2).sum(axis=1)
    square[(ahead[:, 2] <= 0) | ~np.isfinite(square)] = np.inf
    scale = np.sqrt(np.median(square) / 1.386)  # median of chi-square with 2 degrees of freedom
    return square < (GATE * scale) ** 2


def _unsupported(observations, inliers, state):
    """{frame: reason} of frames whose inliers are fewer than two sightings of the platform, or of the base by a moving camera."""
    markers = observations.marker.max() + 1
    bodies = [(observations.on_platform, "the platform")]
    bodies += [(~observations.on_platform & (observations.camera == i), f"the base by camera {state.cameras[i].name!r}") for i in state.moving]
    weak = {}
    for mask, what in bodies:
        rows = np.flatnonzero(inliers & mask)
        key = (observations.frame[rows] * len(state.cameras) + observations.camera[rows]) * markers + observations.marker[rows]
        keys, count = np.unique(key, return_counts=True)
        sightings = np.bincount(keys[count >= 3] // markers // len(state.cameras), minlength=len(observations.frames))
        for f in np.flatnonzero(sightings < 2):
            weak[f] = f"only {sightings[f]} sightings of {what} agree with the other frames"
    return weak
