"""Result of a measurement.

Poses with covariance, held-out residuals, what to look at, and its verdict.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Json
from rig.formats.local_and_remote_input_files import read_text
from rig.formats.output_files import write_text
from rig.formats.rig_toml.camera_instrument_and_cube_entries import replace_cameras, replace_target_markers
from rig.formats.rig_toml.mechanism_entries import write_kinematics_file
from rig.model.arm_branches_and_hands import hand_names, seen_hand
from rig.model.design import Camera
from rig.model.pose import pose_to_vector, rms_uncertainty
from rig.recording import recording_tables
from rig.recording.recording_folder import Recording, copy_frames_commands_and_sensors
from rig.recording.recording_tables import Poses
from rig.recording.wanted_poses_and_roll_pitch_yaw import write_poses_as_roll_pitch_yaw
from rig.report.verdict_and_display import (
    AGREES,
    Evidence,
    MissingEvidence,
    OneLineRepr,
    Verdict,
    judge_evidence,
    result_html,
)
from vision.bundle.adjustment_validation_and_determinacy import DeterminedUnknowns, HeldOut, NotHeldOut
from vision.bundle.marker_displacements import Places, adjusted_markers
from vision.bundle.priors_of_unknowns import stated_lens_prior_sigmas
from vision.clocks_of_moving_exposures import Clocks
from vision.reading.marker_identity_mistakes import Suspect
from vision.reading.recording_corners import Collected
from vision.recording_adjustment import Measurement

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

    def write(self, folder: Path) -> None:
        """Write it as a recording into a folder: rig.toml with cameras as adjusted, poses.csv, rpy.csv, corners.csv and
        the tables of times.
        """
        m, recording = self.measurement, self.recording
        text = replace_cameras(read_text(recording.folder / "rig.toml"), m.design.cameras)
        write_text(folder / "rig.toml", replace_target_markers(text, adjusted_markers(m)) if m.places_free else text)
        write_kinematics_file(folder, recording.design.mechanism)
        hands = hand_names(recording.design.mechanism)
        hand = np.full(len(m.frames), hands.index(seen_hand(recording.design.mechanism))) if hands else None
        poses = Poses(m.frames, m.T_base_platform, m.covariance, hand=hand)
        recording_tables.write_poses(folder / "poses.csv", poses, hands)
        write_poses_as_roll_pitch_yaw(folder / "rpy.csv", poses)
        recording_tables.write_corners(folder / "corners.csv", m.corners())
        copy_frames_commands_and_sensors(recording.folder, folder, recording.exposures, recording.origin)
        for number, stage in m.stages.items():
            recording_tables.write_poses(
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
            "clocks": [one.tree() for one in self.clocks],
            "verdict": self.verdict.tree(),
        }


def camera_offset_lines(measured: Measurement) -> list[str]:
    """A line for each camera that was found to expose at other moments than its times say."""
    names, lines = [camera.name for camera in measured.design.cameras], []
    for name, offset in zip(names, measured.camera_offsets):
        if offset:
            side = "later" if offset > 0 else "earlier"
            lines.append(
                f"camera {name!r} exposes {abs(offset) * 1e3:.3f} ms {side} than its times say, relative to "
                f"{names[0]!r}; this is taken into account"
            )
    return lines


def focal_length_alarms(stated: Sequence[Camera], adjusted: Sequence[Camera]) -> list[str]:
    """Alarms of cameras whose focal length was adjusted too far.

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


def measurement_verdict(result: MeasurementResult) -> Verdict:
    """The verdict on a measurement."""
    m, total, (position, rotation) = result.measurement, result.frame_count, result.uncertainty
    size = f"poses to {position * 1e6:.1f} µm and {rotation * 1e6:.1f} µrad (standard uncertainty, RMS)"
    why = f"{len(m.frames)} of {total} frames solved, {size}"
    missing, unexplained = [], []
    if len(m.frames) < total:
        missing.append(MissingEvidence(f"{total - len(m.frames)} frames have no pose"))
    if result.suspects:
        missing.append(
            MissingEvidence(
                f"{len(result.suspects)} marker{'s are' if len(result.suspects) > 1 else ' is'} not as in rig.toml"
            )
        )
    missing += [
        MissingEvidence(text) for text in focal_length_alarms(result.recording.design.cameras, m.design.cameras)
    ]
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
