"""Python entry point of vision.

A recording measured, its poses with covariance, its cameras adjusted.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rig.recording.frame_selection_and_content_hashes import require_one_hand_shown
from rig.recording.recording_folder import Recording
from vision.bundle.adjustment_validation_and_determinacy import crossvalidate_adjustment, determined_combinations
from vision.bundle.marker_displacements import compare_stated_and_adjusted_places
from vision.checks.recording_refusal_and_cube_layout_remarks import (
    Notice,
    ignore_notice,
    make_spoilt_corner_refusal,
    refuse_spoilt_files,
)
from vision.clocks_of_moving_exposures import clocks_of_recording
from vision.measurement_result import MeasurementResult, camera_offset_lines
from vision.predict import marker_map
from vision.reading.marker_identity_mistakes import find_suspicious_markers
from vision.reading.recording_corners import image_reader
from vision.recording_adjustment import has_hand_cameras, invert_measured_poses, recording_seen_from_hand
from vision.recording_measurement import PLACES, measure_recording, recording_with_unstated_markers_placed

Progress = Callable[[str, int, int], None]
HELD = ("lenses", "poses")


@dataclass(frozen=True, slots=True)
class MeasureOptions:
    """hold : what of the cameras remains as stated, of "poses" and "lenses"; places : whether the markers' places on
    their bodies are adjusted too: "stated", "free", or "auto", where the stated ones contradict what is seen
    detect : whether to read the images even where corners.csv is there; anyway : whether to go on though a mistake
    makes results meaningless
    """

    hold: tuple[str, ...] = ()
    places: str = "auto"
    detect: bool = False
    anyway: bool = False

    def __post_init__(self) -> None:
        if set(self.hold) - set(HELD) or self.places not in PLACES:
            raise ValueError(f"hold takes {HELD}, places {PLACES}; got {self.hold} and {self.places!r}")


def measure(
    recording: Recording,
    options: MeasureOptions = MeasureOptions(),
    progress: Progress | None = None,
    notice: Notice = ignore_notice,
) -> MeasurementResult:
    """MeasurementResult of a recording, as `rig measure` makes it.

    progress : called with (label, done, of), or None; notice : called with lines on what is unlikely in the recording
    Raises RigError for a recording whose results would mean nothing (see MeasureOptions.anyway), NotEnoughData for one
    with neither corners nor images

    >>> import rig, vision
    >>> found = vision.measure(rig.load("tests/data/bench/check")).measurement
    >>> len(found.frames), found.covariance.shape
    (6, (6, 6, 6))
    >>> found.noise < 0.1  # px, standard deviation of a corner
    True
    """
    require_one_hand_shown(recording)
    recording = recording_with_unstated_markers_placed(recording, options.detect, progress)
    refuse_spoilt_files(recording, options.anyway, notice)
    measured, collected = measure_recording(
        recording,
        tuple(part for part in HELD if part not in options.hold),
        options.detect,
        progress,
        options.places,
        make_spoilt_corner_refusal(recording, options.anyway, notice),
    )
    held = crossvalidate_adjustment(measured.used(), measured.adjustment)
    determination = determined_combinations(measured.adjustment)
    stated = measured.adjustment.stated.placed.stated[measured.adjustment.unknowns.seen].any()
    moved = (
        compare_stated_and_adjusted_places(measured, recording.exposures.times()[1])
        if measured.places_free and stated
        else None
    )
    seen, as_seen = recording_seen_from_hand(recording), measured
    if has_hand_cameras(recording.design):
        as_seen, determination = invert_measured_poses(measured), determination.from_the_hand()
    read = image_reader(seen) if any(recording.exposures.image) else None
    wrong = find_suspicious_markers(as_seen, marker_map(seen.design), collected.repeated if collected else (), read)
    own = measured.covariance - measured.common @ np.swapaxes(measured.common, 1, 2)
    clocks = clocks_of_recording(recording, measured.frames, measured.T_base_platform, own, measured.common)
    statement = [*map(str, clocks), *camera_offset_lines(measured), *determination.lines()]
    return MeasurementResult(recording, measured, held, collected, moved, statement, wrong, determination, clocks)
