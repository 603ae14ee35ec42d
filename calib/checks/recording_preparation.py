"""Recordings made ready for what is computed from them: refused where results would mean nothing, and joined to one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from calib.drift.instrument_displacement import remove_instrument_displacement
from rig.checks import platform_commands_and_poses
from rig.checks.mistake_report import Mistake, sort_mistakes
from rig.recording.combined_recordings import is_measured_by_instrument
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Corners
from vision.checks.recording_refusal import (
    Notice,
    refuse_mistakes,
    refuse_spoilt_corners,
    refuse_spoilt_files,
    sample_corners,
)
from vision.combined_recordings import combine_recordings, require_combinable

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRecording:
    """recording : one Recording of all; look : judges its corners once they are read, where that is not done; joined :
    whether it was made of several
    """

    recording: Recording
    look: Callable[[Corners], None]
    joined: bool


def prepare_recordings(
    recordings: Recording | Sequence[Recording], anyway: bool, notice: Notice, progress: Progress | None
) -> PreparedRecording:
    """PreparedRecording of one recording, or of several of one rig, each judged by itself.

    anyway : whether to go on though a mistake makes results meaningless; notice : called with lines on what is
    unlikely, on what the recordings share and what is each one's own; progress : called with (label, done, of), or None
    Raises RigError that names the likeliest mistake first, and for recordings that are not of one rig
    """
    every = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if len(every) == 1:
        return PreparedRecording(every[0], prepare_recording(every[0], anyway, notice), False)
    require_combinable(every)
    for recording in every:
        look = prepare_recording(recording, anyway, notice)
        corners = sample_corners(recording)
        if corners is not None:
            look(corners)
    found = combine_recordings(every, progress)
    for line in found.lines():
        notice(line)
    recording = found.recording
    if is_measured_by_instrument(recording):
        if recording.design.mechanism.strut_joints is not None:
            recording, places = remove_instrument_displacement(recording)
            for place in places:
                notice(place.line(every[place.recording].name))
            if not places:
                notice("the instrument stands where it stood")
        else:
            notice("the instrument is taken to stand where it stood: of an arm that is not looked at")
    return PreparedRecording(recording, lambda corners: None, True)


def prepare_recording(recording: Recording, anyway: bool, notice: Notice) -> Callable[[Corners], None]:
    """What judges a recording's corners once they are read; its files, images and poses are judged at once. Raises as
    `prepare_recordings` does
    """
    refuse_spoilt_files(recording, anyway, notice)
    if recording.poses is not None and recording.corners is None and not recording.has_images:
        refuse_mistakes(pose_mistakes(recording), anyway, notice)
    return refuse_spoilt_corners(recording, anyway, notice)


def pose_mistakes(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes that poses.csv and commands.csv show of each other."""
    from calib.models.arm.command_and_pose_mistakes import find_arm_mistakes

    if recording.poses is None or recording.commands is None:
        return ()
    mechanism = recording.design.mechanism
    if mechanism.link_rows is not None:
        return find_arm_mistakes(recording)
    if mechanism.plates is None:
        return ()
    return sort_mistakes(
        platform_commands_and_poses.command_pose_mistakes(
            platform_commands_and_poses.moves_of_recording(
                recording,
                recording.poses.frame,
                recording.poses.T_base_platform,
                platform_commands_and_poses.written_pose_columns(recording),
            )
        )
    )
