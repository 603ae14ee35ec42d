"""Measuring limbs' acceptance, and platform poses from their readings.

Vision accepts the limbs; poses come from readings of limbs or of instruments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.api.parameter_learning_pose_by_pose_from_recording import LearningResult, learn_from_samples
from calib.api.recording_check_combination_and_view import refuse_unfit_recording_and_make_corner_check
from calib.certification import (
    loop_closure_checks_of_redundant_measuring_limbs,
    measuring_limb_calibration_slips_and_vision_agreement,
)
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.measuring_limb_calibration_slips_and_vision_agreement import Agreement
from calib.files.calibration_file import calibration_provenance
from calib.models.machine_parameters_and_file_entries import corrected_pose_covariance
from calib.online import accepted_measuring_limbs_file, measuring_limb_poses_checked_by_vision
from calib.online.accepted_measuring_limbs_file import Accepted
from calib.online.measuring_limb_poses_checked_by_vision import (
    LimbPoses,
    LimbSource,
    checked_limb_poses_and_accepted_limbs,
)
from calib.report.online_learning_and_limb_vision_agreement_pages import (
    measuring_limbs_verdict,
    write_measuring_limbs_page,
)
from calib.samples.commanded_and_measured_pose_samples import Sampled, sample_recording
from rig.array_and_json_types import Floats, Integers, Json
from rig.errors import RigError
from rig.formats.csv_and_parquet_tables_and_time_origin import Table
from rig.formats.local_and_remote_input_files import read_bytes
from rig.formats.numbers_and_units import count_text
from rig.formats.output_files import write_bytes
from rig.model import mechanisms
from rig.model.pose import rms_uncertainty
from rig.recording import corner_and_pose_csv_tables
from rig.recording.corner_and_pose_csv_tables import Poses, write_poses
from rig.recording.recording_folder import Recording, copy_frames_commands_and_sensors
from rig.recording.wanted_poses_and_roll_pitch_yaw import write_poses_as_roll_pitch_yaw
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import OneLineRepr, Verdict, result_html
from vision.api import Progress
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice, ignore_notice

FIGURES = ("bias", "scatter", "expected", "limits", "surely", "tolerance", "moved", "passed")


@dataclass(frozen=True, slots=True)
class AcceptLimbsOptions:
    """tolerance : (m, rad) within which each axis must agree with vision; use : names of the six limbs that give the
    pose, None for the six that determine it best; arguments : of a command, for the provenance
    """

    tolerance: tuple[float, float] = (5e-5, 2e-4)
    use: tuple[str, ...] | None = None
    arguments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if min(self.tolerance) <= 0:
            raise RigError("--tolerance takes two positive numbers, m and rad")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LimbAcceptance(OneLineRepr):
    """Measuring limbs compared with vision. recording; by_vision : its poses; accepted : limbs, agreement and verdict;
    channels : names of all limbs; check_error, check_sigma : (n, checks) m, of the limbs beyond six, held out
    """

    recording: Recording
    by_vision: Sampled
    accepted: Accepted
    channels: tuple[str, ...]
    check_error: Floats
    check_sigma: Floats

    @property
    def agreement(self) -> Agreement:
        """How far limbs and vision agree."""
        return self.accepted.agreement

    @property
    def passed(self) -> bool:
        """Whether the limbs may stand for vision."""
        return self.accepted.verdict == "accepted"

    @property
    def withdrawal_reason(self) -> str | None:
        """Why the limbs cannot stand for vision though they agreed, None where nothing says so."""
        return None if self.accepted.withdrawn is None else self.accepted.withdrawn.reason

    @property
    def verdict(self) -> Verdict:
        """The verdict on the limbs."""
        return measuring_limbs_verdict(self.agreement, self.withdrawal_reason)

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.verdict.rests_on)

    def tree(self) -> Json:
        """What `rig limbs test --json` prints."""
        found, gone, limbs = self.agreement, self.accepted.withdrawn, self.accepted.limbs
        closures = [
            {
                "limb": self.channels[i],
                "mean": float(e.mean()),
                "rms": float((e**2).mean() ** 0.5),
                "expected": float((s**2).mean() ** 0.5),
            }
            for i, e, s in zip(
                [] if limbs.checks is None else limbs.checks.limbs, self.check_error.T, self.check_sigma.T
            )
        ]
        return {
            "schema": "insitu/1",
            "verdict": self.verdict.tree(),
            "poses": found.n,
            "order": "x y z rx ry rz, m and rad",
            "pose_from": [self.channels[i] for i in limbs.chosen],
            "closures": closures,
            **{name: getattr(found, "proven_limits" if name == "surely" else name).tolist() for name in FIGURES},
            "withdrawn": gone and {"frame": gone.frame, "reason": gone.reason},
        }

    def save(self, path: Path) -> None:
        """Save the limbs with their verdict, for LimbSource."""
        accepted_measuring_limbs_file.save_limbs(path, self.accepted)

    def write_page(self, path: Path, links: Sequence[Link] = ()) -> None:
        """Write the page of it."""
        write_measuring_limbs_page(
            path, self.recording.name, self.agreement, self.by_vision.source, self.withdrawal_reason, links
        )

    def learn(self, state: Path | None, progress: Progress, notice: Notice) -> LearningResult:
        """LearningResult of the struts from the limbs' poses. state : of a filter to go on with, where it is there"""
        poses = measuring_limb_poses_checked_by_vision.limb_poses(self.recording, self.accepted)
        sampled = measuring_limb_poses_checked_by_vision.samples_of_limb_poses(self.recording, poses)
        return learn_from_samples(self.recording, sampled, state, progress, notice)


def accept_limbs(
    recording: Recording, options: AcceptLimbsOptions = AcceptLimbsOptions(), progress: Progress | None = None
) -> LimbAcceptance:
    """Acceptance of measuring limbs by a recording (LimbAcceptance), as `rig limbs test` makes it.

    Both limbs and vision measured in it.
    progress : called with (label, done, of), or None
    Raises RigError for a recording without limbs' readings, and for other limbs than it has
    """
    design = recording.design
    measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(
        design
    )  # limbs that determine no pose are refused before anything is read
    frames, every = measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(recording)
    stated = measuring_limb_calibration_slips_and_vision_agreement.stated_limbs(design)
    requested = None if options.use is None else _limb_numbers(options.use, stated.channels)
    by_vision = sample_recording(recording, progress=progress)
    sigma, home = (
        stated.length_sigma,
        measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design).home,
    )
    chosen = (
        loop_closure_checks_of_redundant_measuring_limbs.best_six_limbs(stated, home, by_vision.samples.T_base_platform)
        if requested is None
        else requested
    )
    nominal = measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design, chosen)
    samples = measuring_limb_calibration_slips_and_vision_agreement.samples_with_limb_readings_as_commands(
        by_vision.samples, frames, every[:, chosen]
    )
    T, expected = measuring_limb_calibration_slips_and_vision_agreement.held_out_limb_poses_and_expected_covariance(
        samples, nominal, sigma
    )
    found = measuring_limb_calibration_slips_and_vision_agreement.limb_agreement(
        samples.T_base_platform, T, expected, options.tolerance
    )
    six = replace(
        measuring_limb_calibration_slips_and_vision_agreement.calibrated_limbs_and_identification(
            samples, nominal, sigma
        )[0],
        chosen=chosen,
    )
    both = every[np.searchsorted(frames, samples.frame)]
    limbs = replace(
        six, checks=loop_closure_checks_of_redundant_measuring_limbs.fit_redundant_limb_checks(six, stated, both)
    )
    source = calibration_provenance(recording, options.arguments, 0, by_vision.source == "images")
    accepted = Accepted(limbs, nominal, found, None, source)
    slipped = measuring_limb_calibration_slips_and_vision_agreement.detect_limb_slip(samples, limbs, sigma)
    if slipped is not None:
        limb = chosen[slipped.limb - 1] + 1
        reason = (
            f"limb {limb} is longer by {slipped.size * 1e6:+.1f} +- {slipped.sigma * 1e6:.1f} um than it reads: "
            "it slipped"
        )
        accepted = accepted_measuring_limbs_file.limbs_with_acceptance_withdrawn(
            accepted, str(recording.folder), slipped.frame, reason
        )
    error, check_sigma = loop_closure_checks_of_redundant_measuring_limbs.held_out_redundant_limb_errors_and_sigma(
        limbs, stated, both
    )
    return LimbAcceptance(recording, by_vision, accepted, stated.channels, error, check_sigma)


def _limb_numbers(names: Sequence[str], channels: tuple[str, ...]) -> Integers:
    """(6,) numbers, from 0, of limbs by their names. Raises RigError for anything but six of them, each once"""
    plain = [name.strip() for name in names]
    if set(plain) - set(channels) or len(set(plain)) != 6 or len(plain) != 6:
        raise RigError(f"--use takes six different limbs of {channels[0]} .. {channels[-1]}, not {','.join(names)!r}")
    return np.sort([channels.index(name) for name in plain])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MeasuredLimbPoses(OneLineRepr):
    """Poses by measuring limbs. recording; poses : LimbPoses; accepted : the limbs they are from."""

    recording: Recording
    poses: LimbPoses
    accepted: Accepted

    def __str__(self) -> str:
        position, rotation = rms_uncertainty(self.poses.covariance)
        return (
            f"{count_text(len(self.poses.frames), 'pose')} by limbs, to {position * 1e3:.4f} mm and "
            f"{rotation * 1e3:.4f} mrad"
        )

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self))

    def write(self, folder: Path) -> None:
        """Write it as a recording into a folder, rig.toml as stated."""
        recording, found = self.recording, self.poses
        write_bytes(folder / "rig.toml", read_bytes(recording.folder / "rig.toml"))
        poses = Poses(found.frames, found.T_base_platform, found.covariance)
        corner_and_pose_csv_tables.write_poses(folder / "poses.csv", poses)
        write_poses_as_roll_pitch_yaw(folder / "rpy.csv", poses)
        copy_frames_commands_and_sensors(recording.folder, folder, recording.exposures, recording.origin)


def measure_poses_by_limbs(
    recording: Recording,
    limbs: LimbSource,
    anyway: bool = False,
    progress: Progress | None = None,
    notice: Notice = ignore_notice,
) -> MeasuredLimbPoses:
    """Poses of a recording measured by its accepted measuring limbs, as `rig measure --limbs` makes them.

    Raises RigError for limbs that were not accepted, or with which vision no longer agrees
    """
    refuse_unfit_recording_and_make_corner_check(recording, anyway, notice)
    return MeasuredLimbPoses(recording, *checked_limb_poses_and_accepted_limbs(recording, limbs, progress, notice))


BEYOND = 0.05  # of an axis' range, by which a reading may lie beyond it


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PosesOfReadings(OneLineRepr):
    """Poses that a measuring machine's readings stand for. poses : Poses, corrected, with covariance; moved : m, RMS
    from what the nominal model reads; physics : whether the calibration knows physics, which is not taken off readings
    """

    poses: Poses
    moved: float
    physics: bool

    def __str__(self) -> str:
        assert self.poses.covariance is not None
        position, rotation = (
            float(np.sqrt(np.trace(self.poses.covariance[:, part, part], axis1=1, axis2=2).mean()))
            for part in (slice(0, 3), slice(3, 6))
        )
        return (
            f"{self.moved * 1e3:.4f} mm RMS from what the nominal model reads; "
            f"standard uncertainty {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad RMS"
        )

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(f"{count_text(len(self.poses.frame), 'pose')}: {self}")

    def write(self, path: Path) -> None:
        """Write the poses as poses.csv."""
        write_poses(path, self.poses)


def corrected_poses_of_readings(calibration: Calibration, readings: Table) -> PosesOfReadings:
    """Corrected poses of a measuring machine's readings.

    Readings stand in a table frame,l1..l6; of an arm: q1..qn.
    Raises FileError for a reading beyond its axis' range
    Source: configuration-space patent, [0062], [0068] to [0072], [0131]
    """
    correction, nominal = calibration.correction, calibration.correction.nominal
    kinematics = mechanisms.kinematics_of(nominal)
    values, frames = readings.matrix(nominal.axes), readings.whole("frame")
    far = np.abs(kinematics.signed_limit_excess(values, nominal)) > BEYOND * np.ptp(
        kinematics.travel_ranges(nominal), axis=1
    )
    if far.any():
        i, axis = np.argwhere(far)[0].tolist()
        readings.fail(f"{nominal.axes[axis]} is read beyond its range", i, nominal.axes[axis], values[i, axis])
    T = correction.predict(values)
    moved = np.linalg.norm(T.translation - kinematics.forward(values, nominal).translation, axis=1)
    return PosesOfReadings(
        Poses(frames, T, corrected_pose_covariance(calibration, T, values)),
        float(np.sqrt((moved**2).mean())),
        calibration.physics is not None,
    )
