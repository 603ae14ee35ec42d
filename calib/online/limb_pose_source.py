"""Accepted measuring limbs as the source of a recording's poses, vision looking at some of them."""

from dataclasses import dataclass, replace
from pathlib import Path

from calib.online import measuring_limb_poses, measuring_limbs_file
from calib.online.measuring_limb_poses import LimbPoses
from calib.online.measuring_limbs_file import Accepted
from calib.samples.recording_samples import Sampled
from rig.errors import RigError
from rig.recording.recording_folder import Recording
from vision.api import Progress
from vision.checks.recording_refusal import Notice

EVERY = 5  # poses between two looks of vision


@dataclass(frozen=True, slots=True)
class LimbSource:
    """path : of the file in which `rig insitu` saved what it accepted; every : poses between two looks of vision."""

    path: Path
    every: int = EVERY


def sample_by_limbs(recording: Recording, source: LimbSource, progress: Progress | None, notice: Notice) -> Sampled:
    """Sampled of a recording from its measuring limbs. Raises as `checked_limb_poses` does"""
    found, accepted = checked_limb_poses(recording, source, progress, notice)
    return replace(
        measuring_limb_poses.samples_of_limb_poses(recording, found),
        files=(source.path,),
        data=tuple(accepted.provenance.get("data", ())),
    )


def checked_limb_poses(
    recording: Recording, source: LimbSource, progress: Progress | None, notice: Notice
) -> tuple[LimbPoses, Accepted]:
    """(LimbPoses of a recording, the Accepted they are from). notice : called with how many vision looked at

    Raises RigError for limbs that were not accepted, that are others than rig.toml states, or with which vision no
        longer agrees: their acceptance is withdrawn in their file first
    """
    accepted = measuring_limbs_file.accepted_limbs(source.path, recording.design)
    found = measuring_limb_poses.limb_poses(recording, accepted)
    checked = measuring_limb_poses.check_limb_poses_by_redundancy_and_vision(
        recording, accepted, found, source.every, progress
    )
    if checked.disagreement is not None and checked.frame is not None:
        write_withdrawal(source.path, accepted, str(recording.folder), checked.frame, checked.disagreement.reason)
        raise RigError(
            f"frame {checked.frame}: {checked.disagreement.reason}. {checked.disagreement.who}: their "
            "acceptance is withdrawn "
            f"in {source.path}, and nothing was computed; without --limbs vision measures"
        )
    spare = 0 if accepted.limbs.checks is None else len(accepted.limbs.checks.limbs)
    closing = f", at each of which {spare} more limb{'s close' if spare > 1 else ' closes'}" if spare else ""
    notice(
        f"{len(found.frames)} poses from the measuring limbs{closing}; "
        + (
            f"vision looked at {checked.count} of them and agrees"
            if checked.count
            else "the recording has nothing for vision to look at, so that none was checked by it"
        )
    )
    return found, accepted


def write_withdrawal(path: Path, accepted: Accepted, recording: str, frame: int, reason: str) -> None:
    """Write that an acceptance no longer stands, in its own file. Raises FileError where that cannot be written."""
    measuring_limbs_file.save_limbs(path, measuring_limbs_file.withdraw_acceptance(accepted, recording, frame, reason))
