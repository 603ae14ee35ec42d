"""Refusal of a recording whose mistakes make its results meaningless; what is unlikely is noticed line by
line.
"""

from collections.abc import Callable, Iterable

from rig.checks.mistake import Mistake
from rig.checks.recording_files import recording_file_mistakes
from rig.errors import RigError
from rig.model.design_comparison_and_cube_remounting import WORDS, quarter_turns_of_cubes
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Corners
from vision.checks.corner_mistake_search import find_corner_mistakes

Notice = Callable[[str], None]


def ignore_notice(line: str) -> None:
    """Let a notice pass."""


def refuse_mistakes(mistakes: Iterable[Mistake], allow_mistakes: bool, notice: Notice) -> None:
    """Refuse mistakes that make results meaningless, unless allowed; the others are noticed, a line each.

    allow_mistakes : whether to go on though a mistake makes results meaningless
    Raises RigError with all of it where one does and nobody goes on anyway
    """
    mistakes = tuple(mistakes)
    if any(one.spoils for one in mistakes) and not allow_mistakes:
        raise RigError("\n".join([*map(str, mistakes), "Nothing was computed; --anyway does it nevertheless"]))
    for one in mistakes:
        notice(str(one))


def refuse_spoilt_files(recording: Recording, allow_mistakes: bool, notice: Notice) -> None:
    """Refuse a recording whose files or sampled images are spoilt, unless mistakes are allowed."""
    refuse_mistakes(recording_file_mistakes(recording), allow_mistakes, notice)
    for name, quarters in quarter_turns_of_cubes(recording.design).items():
        notice(
            f"{recording.folder}: cube {name} was taken off and put back, {WORDS[quarters]}; its place is "
            "known only to what that may do, so its "
            "markers hold no pose"
        )
    if recording.has_images and recording.corners is None and recording.design.targets:
        from vision.checks.image_sample import dictionary_and_identity_mistakes

        refuse_mistakes(dictionary_and_identity_mistakes(recording), allow_mistakes, notice)


def make_spoilt_corner_refusal(recording: Recording, allow_mistakes: bool, notice: Notice) -> Callable[[Corners], None]:
    """Make the function that refuses spoilt Corners of a recording once they are read, as `refuse_mistakes` does"""

    def look(corners: Corners) -> None:
        refuse_mistakes(find_corner_mistakes(recording, corners), allow_mistakes, notice)

    return look


def recorded_or_sampled_corners(recording: Recording) -> Corners | None:
    """Recorded corners of a recording, else corners sampled from some frames' images; None where neither is there."""
    if recording.corners is not None:
        return recording.corners
    if not recording.has_images or not recording.design.targets:
        return None
    from vision.checks.image_sample import read_corners_of_image_sample

    return read_corners_of_image_sample(recording)[0]
