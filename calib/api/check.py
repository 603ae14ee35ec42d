"""All that is wrong or unlikely with a recording: its files, corners, images and poses."""

from pathlib import Path

from calib.checks.recording_preparation import pose_mistakes
from rig.api import CheckResult, check_files
from rig.checks.mistake_report import sort_mistakes
from vision.checks import find_corner_mistakes
from vision.checks.cube_layout_remarks import cube_layout_remarks


def check(path: Path | str, detect: bool = False) -> CheckResult:
    """CheckResult of a recording's folder, as `rig check` states it.

    detect : whether to read some images even where corners.csv is there, and hold both against each other

    >>> import calib
    >>> print(calib.check("tests/data/bench/check"))
    good: nothing wrong or unlikely was found
    """
    recording, files = check_files(Path(path))
    if recording is None:
        return files
    found = [*files.found, *pose_mistakes(recording)]
    corners = recording.corners
    if recording.has_images and (corners is None or detect):
        from vision.checks.image_sample import read_corners_of_image_sample

        seen, more = read_corners_of_image_sample(recording)
        found += more
        corners = corners or seen
    if corners is not None:
        found += find_corner_mistakes(recording, corners, thorough=True)
    return CheckResult(sort_mistakes(found), cube_layout_remarks(recording.design))
