"""A recording refused where a mistake makes its results meaningless; what is unlikely is handed to the caller, line by
line.
"""

from collections.abc import Callable, Iterable

from rig.checks.mistake_report import Mistake
from rig.checks.recording_files import recording_file_mistakes
from rig.errors import RigError
from rig.model.cube_remounting import WORDS, quarter_turns
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Corners
from vision.checks.corner_consistency import find_corner_mistakes

Notice = Callable[[str], None]


def ignore_notice(line: str) -> None:
    """Let a notice pass."""


def refuse_mistakes(mistakes: Iterable[Mistake], anyway: bool, notice: Notice) -> None:
    """Call notice with what is unlikely, a line each.

    anyway : whether to go on though a mistake makes results meaningless
    Raises RigError with all of it where one does and nobody goes on anyway
    """
    mistakes = tuple(mistakes)
    if any(one.spoils for one in mistakes) and not anyway:
        raise RigError("\n".join([*map(str, mistakes), "Nothing was computed; --anyway does it nevertheless"]))
    for one in mistakes:
        notice(str(one))


def refuse_spoilt_files(recording: Recording, anyway: bool, notice: Notice) -> None:
    """Refuse a recording whose files or sampled images are spoilt, unless `anyway`."""
    refuse_mistakes(recording_file_mistakes(recording), anyway, notice)
    for name, quarters in quarter_turns(recording.design).items():
        notice(
            f"{recording.folder}: cube {name} was taken off and put back, {WORDS[quarters]}; its place is "
            "known only to what that may do, so its "
            "markers hold no pose"
        )
    if recording.has_images and recording.corners is None and recording.design.targets:
        from vision.checks.image_sample import dictionary_and_identity_mistakes

        refuse_mistakes(dictionary_and_identity_mistakes(recording), anyway, notice)


def refuse_spoilt_corners(recording: Recording, anyway: bool, notice: Notice) -> Callable[[Corners], None]:
    """What judges a recording's corners once they are read. It raises as `refuse_mistakes` does"""

    def look(corners: Corners) -> None:
        refuse_mistakes(find_corner_mistakes(recording, corners), anyway, notice)

    return look


def sample_corners(recording: Recording) -> Corners | None:
    """Corners of a recording: its own, or read in some frames' images; None where there are neither."""
    if recording.corners is not None:
        return recording.corners
    if not recording.has_images or not recording.design.targets:
        return None
    from vision.checks.image_sample import read_corners_of_image_sample

    return read_corners_of_image_sample(recording)[0]
