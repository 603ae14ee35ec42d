"""Python entry point of vision.

It is `measure`, with its options and its result. A recording is measured: poses with covariance, cameras adjusted,
held-out residuals, a verdict and what to look at.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Json
from rig.formats.local_and_remote_input_files import read_text
from rig.formats.numbers_and_units import count_text
from rig.formats.output_files import write_text
from rig.formats.pandas_tables_of_poses_and_errors import DataFrame, pandas_table_of_columns, pandas_table_of_poses
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import (
    rig_toml_with_camera_values_replaced,
    rig_toml_with_target_markers_replaced,
)
from rig.formats.rig_toml.mechanism_entries import write_kinematics_file
from rig.model.arm_hands_effect_places_and_tolerances import hand_names, selected_hand_name
from rig.model.design import Camera
from rig.model.pose import pose_to_vector, rms_uncertainty
from rig.recording import corner_and_pose_csv_tables
from rig.recording.corner_and_pose_csv_tables import Poses
from rig.recording.frame_selection_and_content_hashes import require_one_hand_shown
from rig.recording.recording_folder import Recording, copy_frames_commands_and_sensors
from rig.recording.wanted_poses_and_roll_pitch_yaw import write_poses_as_roll_pitch_yaw
from rig.report.verdict_refutations_and_result_display import (
    AGREES,
    Evidence,
    MissingEvidence,
    OneLineRepr,
    Verdict,
    judge_evidence,
    result_html,
)
from vision.bundle.adjustment_cross_validation_and_determined_unknowns import (
    DeterminedUnknowns,
    HeldOut,
    NotHeldOut,
    crossvalidate_adjustment,
    determinacy_of_adjusted_unknowns,
)
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import stated_lens_prior_sigmas
from vision.bundle.marker_and_target_displacements import Places, adjusted_markers, compare_stated_and_adjusted_places
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import (
    Notice,
    ignore_notice,
    make_corner_check_raising_on_severe_mistakes,
    require_no_severe_mistakes_in_files_and_images,
)
from vision.clock_offset_drive_lag_and_camera_time_offset_estimation import (
    Clocks,
    clock_offset_and_drive_lag_by_recording,
)
from vision.marker_corner_prediction import marker_map
from vision.reading.corner_reading_from_recording_images import Collected, image_reader
from vision.reading.marker_identity_mistakes_and_expected_marker_places import Suspect, find_suspicious_markers
from vision.recording_adjustment_with_hand_and_stages import (
    Measurement,
    has_hand_cameras,
    measurement_with_inverted_poses,
    recording_seen_from_hand,
)
from vision.recording_measurement import PLACES, measure_recording, recording_with_unstated_markers_placed

SEEN = 0.1  # of the noise of corners, from which errors that come back in every frame are stated
ZOOMED = 2.0  # standard uncertainties of a stated focal length, from which its adjustment is an alarm
SOLVED = 0.5  # of the frames, below which a measurement is bad
TWICE = 2.0  # of the squares that the covariance predicts, from which it is not reliable
NAMED = 5  # frames without a pose that a notebook shows


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MeasurementResult(OneLineRepr):
    """What there is to say of a measurement. collected : what its images gave, or None; held : of frames held out;
    places : vision Places where markers' stated places were adjusted, else None; statement : lines on what the
    recording determines; suspects : markers that are not as in rig.toml
    determination : the combinations of unknowns that the recording determines, or None; clocks : of cameras and
    commands, of each recording with enough exposures in motion"""

    recording: Recording
    measurement: Measurement
    held: HeldOut | NotHeldOut
    collected: Collected | None = None
    places: Places | None = None
    statement: Sequence[str] = ()
    suspects: Sequence[Suspect] = ()
    determination: DeterminedUnknowns | None = None
    clocks: tuple[Clocks, ...] = ()

    @property
    def uncertainty(self) -> tuple[float, float]:
        """(m, rad) RMS standard uncertainty of the poses."""
        return rms_uncertainty(self.measurement.covariance)

    @property
    def frame_count(self) -> int:
        """How many frames the recording has."""
        return len(self.recording.exposures.times()[0])

    @property
    def verdict(self) -> Verdict:
        """The verdict on it."""
        return measurement_verdict(self)

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        m = self.measurement
        missed = [f"frame {frame} has no pose: {reason}" for frame, reason in list(m.unsolved.items())[:NAMED]]
        used = f"corners scatter by {m.noise:.4f} px; {m.inliers.sum()} of {len(m.inliers)} used"
        return result_html(str(self), [used, *map(str, self.suspects), *missed])

    def to_pandas(self) -> DataFrame:
        """DataFrame of the poses, as `pandas_table_of_poses` has it. Raises MissingLibrary without pandas."""
        m = self.measurement
        return pandas_table_of_poses(m.frames, m.T_base_platform, m.covariance)

    def residuals_to_pandas(self) -> DataFrame:
        """DataFrame of the corners: frame, camera, marker, corner, `u_px`, `v_px`, their residuals, and whether used.

        Residuals are NaN where a frame has no pose. Raises MissingLibrary without pandas
        """
        corners, parts = self.measurement.corners(), (self.measurement, *self.measurement.stages.values())
        residuals = np.concatenate([part.residuals for part in parts])
        return pandas_table_of_columns(
            {
                "frame": corners.frame,
                "camera": corners.camera,
                "marker": corners.marker,
                "corner": corners.corner,
                "u_px": corners.uv[:, 0],
                "v_px": corners.uv[:, 1],
                "residual_u_px": residuals[:, 0],
                "residual_v_px": residuals[:, 1],
                "used": np.concatenate([part.inliers for part in parts]),
            }
        )

    def write(self, folder: Path) -> None:
        """Write it as a recording into a folder: rig.toml with cameras as adjusted, poses.csv, rpy.csv, corners.csv and
        the tables of times.
        """
        m, recording = self.measurement, self.recording
        text = rig_toml_with_camera_values_replaced(read_text(recording.folder / "rig.toml"), m.design.cameras)
        write_text(
            folder / "rig.toml",
            rig_toml_with_target_markers_replaced(text, adjusted_markers(m)) if m.places_free else text,
        )
        write_kinematics_file(folder, recording.design.mechanism)
        hands = hand_names(recording.design.mechanism)
        hand = np.full(len(m.frames), hands.index(selected_hand_name(recording.design.mechanism))) if hands else None
        poses = Poses(m.frames, m.T_base_platform, m.covariance, hand=hand)
        corner_and_pose_csv_tables.write_poses(folder / "poses.csv", poses, hands)
        write_poses_as_roll_pitch_yaw(folder / "rpy.csv", poses)
        corner_and_pose_csv_tables.write_corners(folder / "corners.csv", m.corners())
        copy_frames_commands_and_sensors(recording.folder, folder, recording.exposures, recording.origin)
        for number, stage in m.stages.items():
            corner_and_pose_csv_tables.write_poses(
                folder / f"poses_stage{number}.csv", Poses(stage.frames, stage.T_base_platform, stage.covariance)
            )

    def tree(self) -> Json:
        """What `rig measure --json` prints."""
        m, stated = self.measurement, self.recording.design.cameras
        cameras = [
            {
                "name": camera.name,
                "matrix": camera.matrix.tolist(),
                "distortion": camera.distortion.tolist(),
                "moved": pose_to_vector(before.pose.inv() * camera.pose).tolist(),
            }
            for before, camera in zip(stated, m.design.cameras)
        ]
        return {
            "schema": "measured/1",
            "frames": self.frame_count,
            "solved": len(m.frames),
            "unsolved": {str(frame): reason for frame, reason in m.unsolved.items()},
            "position_m": self.uncertainty[0],
            "rotation_rad": self.uncertainty[1],
            "corner_px": float(m.noise),
            "corners": len(m.inliers),
            "used": int(m.inliers.sum()),
            "held_out": {"ratio": self.held.ratio, "rms_px": self.held.rms}
            if not isinstance(self.held, NotHeldOut)
            else None,
            "cameras": cameras,
            "camera_offsets_s": list(m.camera_offsets),
            "readouts": [one.tree() for one in m.readouts],
            "clocks": [one.tree() for one in self.clocks],
            "verdict": self.verdict.tree(),
        }


def camera_time_offset_and_readout_lines(measured: Measurement) -> list[str]:
    """A line for each camera that was found to expose at other moments than its times say, or whose readout time is not
    stated.
    """
    names, lines = [camera.name for camera in measured.design.cameras], []
    for name, offset in zip(names, measured.camera_offsets):
        if offset:
            side = "later" if offset > 0 else "earlier"
            lines.append(
                f"camera {name!r} exposes {abs(offset) * 1e3:.3f} ms {side} than its times say, relative to "
                f"{names[0]!r}; this is taken into account"
            )
    known = {one.camera for one in measured.readouts}
    return [
        *lines,
        *map(str, measured.readouts),
        *(
            f"the readout time of camera {camera.name!r} is neither stated nor determined by exposures in motion; "
            "poses at rest do not depend on it"
            for camera in measured.design.cameras
            if camera.shutter == "rolling" and camera.row_time is None and camera.name not in known
        ),
    ]


def too_large_focal_length_adjustment_sentences(stated: Sequence[Camera], adjusted: Sequence[Camera]) -> list[str]:
    """Sentences on focal lengths that were adjusted too far.

    That is by more than ZOOMED times what its stated one is taken to be worth. One sentence for each.
    """
    out = []
    for before, after in zip(stated, adjusted):
        moved, worth = np.diag(after.matrix - before.matrix)[:2], stated_lens_prior_sigmas(before)[:2]
        worst = int(np.argmax(np.abs(moved) / worth))
        if abs(moved[worst]) > ZOOMED * worth[worst]:
            focal = before.matrix[worst, worst]
            out.append(
                f"the focal length of camera {before.name!r} was adjusted by {moved[worst]:+.0f} px "
                f"({moved[worst] / focal:+.1%}), {abs(moved[worst]) / worth[worst]:.1f} times the standard uncertainty "
                f"of the stated one ({worth[worst] / focal:.0%}): state it as calibrated, and check positions and "
                "sides of the markers"
            )
    return out


def common_image_error_sentences(measured: Measurement) -> list[str]:
    """Sentences on the cameras whose corners lie off alike at the same place of the image in every frame.

    One for each such camera.
    """
    return [
        f"corners in camera {camera.name!r} lie off by {size:.2g} px (RMS) at the same places of its image in every "
        "frame: its lens is not as adjusted; the uncertainties allow for it, rig diagnose looks for its cause"
        for camera, size in zip(measured.design.cameras, measured.adjustment.common_image_errors)
        if size > SEEN * measured.noise
    ]


def measurement_verdict(result: MeasurementResult) -> Verdict:
    """The verdict on a measurement."""
    m, total, (position, rotation) = result.measurement, result.frame_count, result.uncertainty
    size = f"poses to {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad (standard uncertainty, RMS)"
    why = f"{len(m.frames)} of {total} frames solved, {size}"
    missing, unexplained = [], []
    if len(m.frames) < total:
        missing.append(MissingEvidence(count_text(total - len(m.frames), "frame has no pose", "frames have no pose")))
    if result.suspects:
        missing.append(
            MissingEvidence(
                f"{len(result.suspects)} marker{'s are' if len(result.suspects) > 1 else ' is'} not as in rig.toml"
            )
        )
    missing += [
        MissingEvidence(text)
        for text in too_large_focal_length_adjustment_sentences(result.recording.design.cameras, m.design.cameras)
    ]
    missing += [MissingEvidence(text) for text in common_image_error_sentences(m)]
    missing += [MissingEvidence(str(one)) for one in m.readouts if one.certain and one.stated == "global"]
    if isinstance(result.held, NotHeldOut):
        missing.append(MissingEvidence("no frame could be held out to check the uncertainties"))
    elif abs(result.held.ratio - 1) > 2 * result.held.scatter:
        if result.held.ratio > AGREES**2:
            unexplained.append(
                f"held-out frames deviate by {result.held.ratio:.1f} times the squares predicted: the "
                "uncertainties are not reliable"
            )
        elif result.held.ratio < 1 / AGREES**2:
            missing.append(
                MissingEvidence(
                    f"held-out frames deviate by {result.held.ratio:.2f} of the squares predicted: the noise of "
                    "corners, and with it every "
                    "uncertainty, is less than stated"
                )
            )
    beyond = (
        not isinstance(result.held, NotHeldOut)
        and result.held.ratio > TWICE
        and abs(result.held.ratio - 1) > 2 * result.held.scatter
    )
    refuted = [*unexplained] if beyond else []
    if len(m.frames) < SOLVED * total:
        refuted.append("fewer than half of the frames have a pose")
    return judge_evidence(
        Evidence(why, unexplained=() if beyond else tuple(unexplained), missing=tuple(missing), refuted=tuple(refuted))
    )


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
    require_no_severe_mistakes_in_files_and_images(recording, options.anyway, notice)
    measured, collected = measure_recording(
        recording,
        tuple(part for part in HELD if part not in options.hold),
        options.detect,
        progress,
        options.places,
        make_corner_check_raising_on_severe_mistakes(recording, options.anyway, notice),
    )
    held = crossvalidate_adjustment(measured.used(), measured.adjustment, measured.own_errors())
    determination = determinacy_of_adjusted_unknowns(measured.adjustment)
    stated = measured.adjustment.stated.placed.stated[measured.adjustment.unknowns.seen].any()
    moved = (
        compare_stated_and_adjusted_places(measured, recording.exposures.times()[1])
        if measured.places_free and stated
        else None
    )
    seen, as_seen = recording_seen_from_hand(recording), measured
    if has_hand_cameras(recording.design):
        as_seen, determination = measurement_with_inverted_poses(measured), determination.from_the_hand()
    read = image_reader(seen) if any(recording.exposures.image) else None
    wrong = find_suspicious_markers(as_seen, marker_map(seen.design), collected.repeated if collected else (), read)
    own = measured.covariance - measured.common @ np.swapaxes(measured.common, 1, 2)
    clocks = clock_offset_and_drive_lag_by_recording(
        recording, measured.frames, measured.T_base_platform, own, measured.common
    )
    statement = [*map(str, clocks), *camera_time_offset_and_readout_lines(measured), *determination.lines()]
    return MeasurementResult(recording, measured, held, collected, moved, statement, wrong, determination, clocks)
