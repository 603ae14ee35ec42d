"""Platform poses from measuring limbs, checked by vision.

Recorded or live, checked by redundant limbs and by vision.

The limbs are learnt on as struts are, from vision's poses, beginning with what their acceptance knows: then what
detects a strut that missed steps (information_filter_kernels_and_change_detection.py) detects a limb that slipped.
One pose of
vision that agrees with nothing is vision's mistake; several in a row are not.

Every few poses vision checks; where the struts tell otherwise than the limbs, in whatever pose, it looks at the next
ones too, so that a limb that slips between two checks is not believed until the next.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification import (
    loop_closure_checks_of_redundant_measuring_limbs,
    measuring_limb_calibration_slips_and_vision_agreement,
)
from calib.certification.loop_closure_checks_of_redundant_measuring_limbs import Limbs
from calib.online import accepted_measuring_limbs_file
from calib.online.accepted_measuring_limbs_file import Accepted
from calib.online.hexapod_information_filter import Online
from calib.online.information_filter_kernels_and_change_detection import Change
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples, pair_commands_with_measured_poses
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import RigError
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod
from rig.recording.frame_selection_and_content_hashes import select_frames
from rig.recording.recording_folder import Recording
from vision.api import Progress
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice
from vision.recording_measurement import measure_recording

IN_A_ROW = 3  # poses of vision that agree with nothing, from which it is not vision that is wrong


@dataclass(frozen=True, slots=True)
class Disagreement:
    """reason : in words; limb : its number, from 1, or None where it is none of them alone; who : says so, in words"""

    reason: str
    limb: int | None
    who: str = "Vision no longer agrees with the measuring limbs"


class LimbCheck:
    """Checks of one session. limbs : Limbs as accepted; shared : draws that all of vision's errors have in common in
    it.
    """

    def __init__(self, limbs: Limbs, shared: int = 0) -> None:
        self._online, self._limbs = Online(limbs.hexapod, shared, limbs.sigma, limbs.covariance), limbs.chosen
        self._strange = 0

    @property
    def count(self) -> int:
        """Checks so far."""
        return self._online.number

    @property
    def undecided(self) -> bool:
        """Whether the last pose disagreed and the next ones will say whether it alone was wrong."""
        return bool(self._online.held)

    def take(
        self, lengths: Floats, T_base_platform: RigidTransform, covariance: Floats, common: Floats | None = None
    ) -> Disagreement | None:
        """What vision's pose says of limbs that read lengths (limbs,) m: None while they agree.

        covariance : (6, 6) of vision's pose, m and rad, tangent on the right; common : (6, shared) factor of the errors
            that vision's poses share
        """
        update = self._online.update(lengths[self._limbs], T_base_platform, covariance, common)
        self._strange = self._strange + len(update.dropped) if update.held or update.dropped else 0
        if update.changes:
            return _named(update.changes[0], self._limbs)
        if self._strange >= IN_A_ROW:
            return Disagreement(f"{self._strange} poses in a row agree with no change of one limb or of the base", None)
        return None


def _named(change: Change, limbs: Floats | Integers) -> Disagreement:
    """What a Change says of limbs, of which the six whose numbers (from 0) are given give the pose."""
    if not isinstance(change.size, float):
        position, rotation = (float(np.linalg.norm(part)) for part in (change.size[:3], change.size[3:]))
        return Disagreement(
            f"vision's poses are moved against the limbs' by {position * 1e6:.1f} um and "
            f"{rotation * 1e6:.1f} urad: a camera, the "
            "base or the limbs' frame was displaced",
            None,
        )
    how = "it slipped" if change.kind == "strut" else "its joint was displaced, the amount varies between poses"
    limb = None if change.strut is None else int(limbs[change.strut - 1]) + 1
    return Disagreement(
        f"limb {limb} is longer by {change.size * 1e6:+.1f} +- {change.sigma * 1e6:.1f} um than it reads: {how}", limb
    )


LOOKS = 5  # poses that vision looks at where struts and limbs no longer tell the same
SOURCE = "measuring limbs"


@dataclass(frozen=True, slots=True, eq=False)
class LimbPoses:
    """What limbs told of f frames. frames : (f,); lengths : (f, limbs) m read; T_base_platform : RigidTransform (f,)
    own : (f, 6, 6) covariance of each pose's readings; common : (f, 6, 42) factor of what the limbs' geometry adds to
        all"""

    frames: Integers
    lengths: Floats
    T_base_platform: RigidTransform
    own: Floats
    common: Floats

    @property
    def covariance(self) -> Floats:
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
    """Poses of a recording by its limbs (LimbPoses).

    They are of the frames whose exposures have readings, by the six limbs that give poses.
    Raises as insitu.readings does, NotConverged for readings that close on no pose
    """
    frames, lengths = measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(recording)
    T = accepted.limbs.pose(lengths)
    return LimbPoses(frames, lengths, T, *accepted.limbs.uncertainty(T))


def samples_of_limb_poses(recording: Recording, poses: LimbPoses) -> Sampled:
    """Samples of commands and limb poses (Sampled).

    Raises RigError without commands.
    """
    return Sampled(
        pair_commands_with_measured_poses(recording, poses.frames, poses.T_base_platform, poses.own, poses.common),
        SOURCE,
        None,
        None,
    )


def _is_checked_by_vision(found: Samples, nominal: Hexapod, every: int) -> Booleans:
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


def check_limb_poses_by_redundancy_and_vision(
    recording: Recording,
    accepted: Accepted,
    poses: LimbPoses,
    check_interval: int,
    progress: Callable[[str, int, int], None] | None = None,
) -> Checked:
    """Check of limb poses by redundant limbs and by vision.

    By limbs at each, by vision at intervals, to the first disagreement.
    Raises what measuring raises
    """
    open_ = loop_closure_checks_of_redundant_measuring_limbs.first_unclosed_limb(accepted.limbs, poses.lengths)
    if open_ is not None:
        return Checked(
            0,
            int(poses.frames[open_.at]),
            Disagreement(str(open_), open_.limb, loop_closure_checks_of_redundant_measuring_limbs.WHO),
        )
    if recording.corners is None and not recording.has_images:
        return Checked(0, None, None)
    look = np.arange(len(poses.frames)) % check_interval == 0
    if recording.commands is not None:
        look = _is_checked_by_vision(
            pair_commands_with_measured_poses(recording, poses.frames, poses.T_base_platform, poses.own, poses.common),
            require_hexapod(recording.design.mechanism),
            check_interval,
        )
    measured, _ = measure_recording(select_frames(recording, poses.frames[look]), progress=progress)
    own = measured.covariance - measured.common @ np.swapaxes(measured.common, 1, 2)
    checks = LimbCheck(accepted.limbs, measured.common.shape[2])
    for frame, T, C, B in zip(measured.frames.tolist(), measured.T_base_platform, own, measured.common):
        found = checks.take(poses.lengths[np.searchsorted(poses.frames, frame)], T, C, B)
        if found is not None:
            return Checked(checks.count, frame, found)
    return Checked(checks.count, None, None)


class LiveLimbPoses:
    """in_force : whether the limbs still stand for vision, until a check says otherwise. accepted : Accepted;
    every : poses between two looks
    """

    def __init__(self, accepted: Accepted, every: int) -> None:
        self.accepted, self.in_force = accepted, True
        self._checks, self._every, self._number, self._looks = LimbCheck(accepted.limbs), every, 0, 0
        self._last: list[Floats] = []

    def pose(self, lengths: Floats) -> tuple[RigidTransform, Floats, Floats]:
        """(T_base_platform, own (6, 6), common (6, 42)) of readings (limbs,) m; own : covariance, common : factor of
        what all poses share, m and rad.

        Raises NotConverged for readings that close on no pose
        """
        T = self.accepted.limbs.pose(lengths)
        return T, *self.accepted.limbs.uncertainty(T)

    def is_closed(self, lengths: Floats) -> Disagreement | None:
        """What limbs beyond six say of readings (limbs,) m and those before; where they disagree, limbs are out of
        force. Raises as `pose`
        """
        self._last = [*self._last[1 - loop_closure_checks_of_redundant_measuring_limbs.IN_A_ROW :], lengths]
        open_ = loop_closure_checks_of_redundant_measuring_limbs.first_unclosed_limb(
            self.accepted.limbs, np.array(self._last)
        )
        self.in_force = open_ is None
        return (
            None
            if open_ is None
            else Disagreement(str(open_), open_.limb, loop_closure_checks_of_redundant_measuring_limbs.WHO)
        )

    def is_check_due(self, unsure: bool) -> bool:
        """Whether vision looks at the pose in hand, once for each pose. unsure : whether the struts tell otherwise than
        the limbs
        """
        self._looks = LOOKS if unsure else max(self._looks - 1, 0)
        now = self._number % self._every == 0 or self._looks > 0 or self._checks.undecided or not self._checks.count
        self._number += 1
        return now

    def check(self, lengths: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Disagreement | None:
        """What vision's pose with its covariance (6, 6), m and rad, says of limbs that read lengths (limbs,) m; where
        it disagrees they are out of force."""
        found = self._checks.take(lengths, T_base_platform, covariance)
        self.in_force = found is None
        return found

    @property
    def undecided(self) -> bool:
        """Whether the last check disagreed and the next ones say who was wrong."""
        return self._checks.undecided


EVERY = 5  # poses between two looks of vision


@dataclass(frozen=True, slots=True)
class LimbSource:
    """path : of the file that `rig limbs test` saved; every : poses between two looks of vision."""

    path: Path
    every: int = EVERY


def sample_recording_by_checked_measuring_limbs(
    recording: Recording, source: LimbSource, progress: Progress | None, notice: Notice
) -> Sampled:
    """Sampled of a recording from its measuring limbs.

    Raises as `checked_limb_poses_and_accepted_limbs` does
    """
    found, accepted = checked_limb_poses_and_accepted_limbs(recording, source, progress, notice)
    return replace(
        samples_of_limb_poses(recording, found), files=(source.path,), data=tuple(accepted.provenance.get("data", ()))
    )


def checked_limb_poses_and_accepted_limbs(
    recording: Recording, source: LimbSource, progress: Progress | None, notice: Notice
) -> tuple[LimbPoses, Accepted]:
    """Limb poses of a recording, checked.

    With the accepted limbs they are from.
    notice : called with how many vision looked at
    Returns (LimbPoses, Accepted)
    Raises RigError for limbs that were not accepted, that are others than rig.toml states, or with which vision no
        longer agrees: their acceptance is withdrawn in their file first
    """
    accepted = accepted_measuring_limbs_file.load_accepted_limbs_for_design(source.path, recording.design)
    found = limb_poses(recording, accepted)
    checked = check_limb_poses_by_redundancy_and_vision(recording, accepted, found, source.every, progress)
    if checked.disagreement is not None and checked.frame is not None:
        write_acceptance_withdrawal(
            source.path, accepted, str(recording.folder), checked.frame, checked.disagreement.reason
        )
        raise RigError(
            f"frame {checked.frame}: {checked.disagreement.reason}. {checked.disagreement.who}: their "
            "acceptance is withdrawn "
            f"in {source.path}, and nothing was computed; omit --limbs to measure by vision"
        )
    spare = 0 if accepted.limbs.checks is None else len(accepted.limbs.checks.limbs)
    closing = f", at each of which {spare} more limb{'s close' if spare > 1 else ' closes'}" if spare else ""
    notice(
        f"{len(found.frames)} poses from the measuring limbs{closing}; "
        + (
            f"vision checked {checked.count} of them and agrees"
            if checked.count
            else "the recording has no images or corners, so none was checked by vision"
        )
    )
    return found, accepted


def write_acceptance_withdrawal(path: Path, accepted: Accepted, recording: str, frame: int, reason: str) -> None:
    """Write the withdrawal of the limbs' acceptance into its file.

    Raises FileError where that cannot be written.
    """
    accepted_measuring_limbs_file.save_limbs(
        path, accepted_measuring_limbs_file.limbs_with_acceptance_withdrawn(accepted, recording, frame, reason)
    )
