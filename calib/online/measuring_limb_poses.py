"""Accepted measuring limbs as a source of a recording's poses, with vision looking at some of them.

Every few poses vision checks; where the struts tell otherwise than the limbs, in whatever pose, it looks at the next
ones too, so that a limb that slips between two checks is not believed until the next.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify import measuring_limbs, redundant_limb_checks
from calib.online.information_filter import Online
from calib.online.limb_vision_agreement import Disagreement, LimbCheck
from calib.online.measuring_limbs_file import Accepted
from calib.samples.pose_samples import Samples, pair_samples
from calib.samples.recording_samples import Sampled
from rig.model.design import Hexapod
from rig.model.mechanism_kinds import hexapod_of
from rig.recording.frame_mask import select_frames
from rig.recording.recording_folder import Recording
from vision.recording_measurement import measure_recording

LOOKS = 5  # poses that vision looks at where struts and limbs no longer tell the same
SOURCE = "measuring limbs"


@dataclass(frozen=True, slots=True, eq=False)
class LimbPoses:
    """What limbs told of f frames. frames : (f,); lengths : (f, limbs) m read; T_base_platform : RigidTransform (f,)
    own : (f, 6, 6) covariance of each pose's readings; common : (f, 6, 42) factor of what the limbs' geometry adds to
        all"""

    frames: np.ndarray
    lengths: np.ndarray
    T_base_platform: RigidTransform
    own: np.ndarray
    common: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """(f, 6, 6) of each pose, the geometry's share included, m and rad."""
        return self.own + self.common @ np.swapaxes(self.common, 1, 2)


@dataclass(frozen=True, slots=True)
class Checked:
    """count : poses that vision looked at, 0 where the recording has none of vision's; frame : where it disagreed
    first, or None
    disagreement : Disagreement, None where vision agreed"""

    count: int
    frame: int | None
    disagreement: Disagreement | None


def limb_poses(recording: Recording, accepted: Accepted) -> LimbPoses:
    """LimbPoses of the frames whose exposures have readings, by the limbs that tell poses, the others left to
    `check_limb_poses`.

    Raises as insitu.readings does, NotConverged for readings that close on no pose
    """
    frames, lengths = measuring_limbs.limb_readings(recording)
    T = accepted.limbs.pose(lengths)
    return LimbPoses(frames, lengths, T, *accepted.limbs.uncertainty(T))


def samples_of_limb_poses(recording: Recording, poses: LimbPoses) -> Sampled:
    """Sampled of what was commanded and what the limbs told. Raises RigError without commands."""
    return Sampled(
        pair_samples(recording, poses.frames, poses.T_base_platform, poses.own, poses.common), SOURCE, None, None
    )


def is_checked_by_vision(found: Samples, nominal: Hexapod, every: int) -> np.ndarray:
    """(n,) bool: the poses of Samples by limbs at which vision looks, every so many and those after struts told
    otherwise.
    """
    look, witness, left = np.arange(len(found)) % every == 0, Online(nominal, found.common.shape[2]), 0
    for k, pose in enumerate(zip(found.commanded, found.T_base_platform, found.covariance, found.common)):
        update = witness.update(*pose)
        if update.changes or update.held or update.dropped:
            back = k - min([change.onset for change in update.changes], default=k)
            look[k - back : k + 1], left = True, LOOKS
        look[k] |= left > 0
        left -= 1
    return look


def check_limb_poses(
    recording: Recording,
    accepted: Accepted,
    poses: LimbPoses,
    every: int,
    progress: Callable[[str, int, int], None] | None = None,
) -> Checked:
    """Checked by limbs beyond six at every pose, and by vision, every so many poses at least, up to the first
    disagreement; only the images of those frames are read.

    Raises what measuring raises
    """
    open_ = redundant_limb_checks.first_unclosed_limb(accepted.limbs, poses.lengths)
    if open_ is not None:
        return Checked(0, int(poses.frames[open_.at]), Disagreement(str(open_), open_.limb, redundant_limb_checks.WHO))
    if recording.corners is None and not recording.has_images:
        return Checked(0, None, None)
    look = np.arange(len(poses.frames)) % every == 0
    if recording.commands is not None:
        look = is_checked_by_vision(
            pair_samples(recording, poses.frames, poses.T_base_platform, poses.own, poses.common),
            hexapod_of(recording.design.mechanism),
            every,
        )
    measured, _ = measure_recording(select_frames(recording, poses.frames[look]), progress=progress)
    own = measured.covariance - measured.common @ np.swapaxes(measured.common, 1, 2)
    checks = LimbCheck(accepted.limbs, measured.common.shape[2])
    for frame, T, C, B in zip(measured.frames.tolist(), measured.T_base_platform, own, measured.common):
        found = checks.take(poses.lengths[np.searchsorted(poses.frames, frame)], T, C, B)
        if found is not None:
            return Checked(checks.count, frame, found)
    return Checked(checks.count, None, None)
