"""View of a recording.

A picture of one frame, a page with the rig in three dimensions, or a file for Rerun.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from calib.report.recording_and_plan_pages import write_recording_page
from rig.effects.texts.effect_texts_and_user_effect_files import parse_effect, require_nonzero_effect
from rig.formats.exporters import recording_as_rerun_tum_parquet
from rig.recording.recording_folder import Recording
from rig.report.pages.page_templates_and_index_page import Link


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """frame : number of the frame that a picture shows, None for all frames; rerun : whether all frames are written for
    the viewer Rerun, else as a page; enlarge : how much larger a picture's residuals are drawn
    effects : as `rig simulate` takes them, what each would do to the poses of a page

    Raises MissingLibrary where Rerun's library is needed and not installed
    """

    frame: int | None = None
    rerun: bool = False
    enlarge: float = 200.0
    effects: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.rerun:
            recording_as_rerun_tum_parquet.import_rerun()


def view(
    recording: Recording,
    path: Path,
    options: ViewOptions = ViewOptions(),
    links: Sequence[Link] = (),
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[str, ...]:
    """Write a view of a recording to a file, as `rig view` does.

    links : of a page; progress : called with (label, done, of), or None
    Returns sentences on what it shows
    Raises RigError for a frame or an effect that the recording cannot have, FileError for a picture's unknown format
    """
    if options.frame is not None:
        from vision.frame_pictures import measure_and_draw_frame, save_pictures_side_by_side

        pictures, measured = measure_and_draw_frame(recording, options.frame, options.enlarge, progress)
        return tuple(save_pictures_side_by_side(path, pictures, measured).splitlines())
    if options.rerun:
        rerun = recording_as_rerun_tum_parquet.import_rerun()
        left_out = recording_as_rerun_tum_parquet.write_rerun_file(recording, path, rerun)
        frames = f"{len(recording.exposures.times()[0])} frames"
        return (f"{left_out} images are left out: Rerun shows PNG and JPEG", frames) if left_out else (frames,)
    effects = [require_nonzero_effect(parse_effect(text)) for text in options.effects]
    write_recording_page(path, recording, effects, links)
    return ()
