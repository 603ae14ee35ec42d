"""Calibration of a rig from recordings.

Its options, and its result: geometry, corrections, and what they leave out.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from calib.api.correction_extension_over_configuration_or_pose_space import (
    ExtendedCorrection,
    ExtendOptions,
    certify_correction_extension,
)
from calib.api.recording_check_combination_and_view import check_and_combine_recordings
from calib.certification import platform_certification
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.calibration_evidence_verdict_and_claim_check import calibration_verdict
from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.certification.platform_certification import Progress, ignore_progress
from calib.correction.correction_tables import (
    correction_summand_column_names,
    correction_summand_csv_rows,
    strut_correction_summands,
)
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.correction.simultaneous_camera_and_geometry_fit import refine_correction_with_cameras
from calib.diagnosis import geometry_refitted_with_diagnosed_effects
from calib.diagnosis.geometry_refitted_with_diagnosed_effects import (
    Findings,
    findings_of_diagnosis,
    findings_with_missing_instrument_effects_added,
    load_findings,
)
from calib.diagnosis.left_out_physics_and_refutation_of_calibrations import (
    calibration_with_left_out_physics,
    mark_as_not_searched_for_left_out_physics,
)
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    fit_of_effects_shown_by_instruments,
)
from calib.diagnosis.recording_diagnosis import DiagnosisOptions, diagnose
from calib.files.calibration_file import SEED, calibration_with_provenance
from calib.models.arm import arm_calibration_page_and_c_source as arm_page
from calib.models.arm import arm_certification as arm_certification
from calib.models.arm.joint_space_correction_and_workspace_claim import (
    arm_workspace_claim,
    commanded_minus_joint_values_by_stated_arm,
)
from calib.models.arm.mount_pointing_terms import PointingTerms, pointing_terms
from calib.models.chain import chain_certification_and_page as chain_certification
from calib.models.chain.chain_correction_over_configuration_space import chain_correction_summands
from calib.models.machine_parameters_and_file_entries import Certified
from calib.online.measuring_limb_poses_checked_by_vision import LimbSource, sample_recording_by_checked_measuring_limbs
from calib.report import platform_and_lens_calibration_pages as platform_page
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples, sample_recording
from calib.samples.position_confounds_and_poses_on_one_clock import (
    estimate_clocks_from_samples,
    recording_and_poses_on_commands_clock,
)
from rig.array_and_json_types import Floats, Json
from rig.effects.catalogue.effect_list import Plugin, effect_catalogue_with_user_files
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import Kinds
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    require_arm,
    require_chain,
    require_hexapod,
    require_parallel,
)
from rig.recording.corner_and_pose_csv_tables import write_table
from rig.recording.recording_folder import Recording
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import OneLineRepr, Verdict, result_html
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice, ignore_notice
from vision.clock_offset_drive_lag_and_camera_time_offset_estimation import Clocks


@dataclass(frozen=True, slots=True, eq=False)
class CalibrateOptions:
    """diagnosis : folder that `rig diagnose` wrote, whose findings are refined with the geometry; find : whether to
    diagnose the recording first and take in what is found; effects : files of effects besides the catalogue
    quick : whether not to search for what the geometry leaves out; joint : whether to solve cameras, lenses and
    geometry once more from all corners together
    extend : how corrections are extended over a space, None for the geometry and its remainder; limbs : measuring limbs
    as the source of poses, None for vision or poses.csv
    anyway : whether to go on though a mistake makes results meaningless; arguments : of a command, for the provenance
    """

    diagnosis: Path | None = None
    find: bool = False
    effects: tuple[Plugin, ...] = ()
    quick: bool = False
    joint: bool = False
    extend: ExtendOptions | None = None
    limbs: LimbSource | None = None
    anyway: bool = False
    arguments: tuple[str, ...] = ()

    @property
    def with_findings(self) -> bool:
        """Whether the physics that a diagnosis finds is taken in."""
        return self.find or self.diagnosis is not None

    def __post_init__(self) -> None:
        requested = "--find" if self.find else "--diagnosis"
        if self.with_findings and self.joint:
            raise RigError(
                f"{requested} solves cameras, lenses, geometry and physics from all corners together; omit --joint"
            )
        if self.with_findings and self.limbs is not None:
            raise RigError(f"{requested} needs the camera images of every pose; omit --limbs")
        if self.with_findings and self.extend is not None:
            raise RigError(f"{requested} corrects findings by their models, --extend by interpolation; give only one")
        if self.effects and not self.with_findings:
            raise RigError("--effects extends a diagnosis: give --find or --diagnosis as well")
        if self.extend is not None and self.joint:
            raise RigError("--extend cannot be combined with --joint: give only one of them")

    def refuse_unsuited(self, design: Design) -> None:
        """Raise RigError for what a design's machine takes none of."""
        mechanism = design.mechanism
        if self.with_findings and mechanism.bodies:
            raise RigError(
                f"{'--find' if self.find else '--diagnosis'} is for platforms on struts and for arms; a chain is "
                "corrected by its geometry only"
            )
        if self.extend is not None:
            self.extend.refuse_unsuited(design)
        elif self.joint and mechanism.axes and mechanism.strut_joints is None:
            raise RigError(
                f"--joint solves a hexapod's cameras and struts together; "
                f"a mechanism of kind {mechanism.kind!r} takes none "
                "of it"
            )


SEARCHED = CalibrateOptions()  # the geometry and its remainder, and what they leave out searched for


Known = tuple[Physics, Floats] | None  # physics fitted with the geometry, and the covariance of both, m^2


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CalibrationResult(OneLineRepr):
    """A calibration with what it was made from. recording : one, of all; sampled : its poses; samples : Samples that
    were fitted, with what physics says of their commands; done : what was fitted; extended : the extension, or None
    clocks : of cameras and commands, taken into account, of each recording with enough exposures in motion
    """

    calibration: Calibration
    recording: Recording
    sampled: Sampled
    samples: Samples
    done: Certified
    extended: ExtendedCorrection | None = None
    clocks: tuple[Clocks, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The verdict on it."""
        return calibration_verdict(self.calibration)

    @property
    def pointing_terms(self) -> PointingTerms | None:
        """Pointing terms of a two-axis mount of which directions were measured; None of all else."""
        if self.sampled.samples.measured != "direction":
            return None
        return pointing_terms(self.recording.design, self.calibration, self.samples.effective)

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.verdict.rests_on) + self.calibration._repr_html_()

    def tree(self) -> Json:
        """What `rig calibrate --json` prints."""
        held, claim, confounds = self.calibration.held_out, self.calibration.claim, self.calibration.confounds
        return {
            "schema": "calibrated/1",
            "held_out": held and asdict(held),
            "claim": claim and asdict(claim),
            "poses": len(self.sampled.samples),
            "clocks": [one.tree() for one in self.clocks],
            "confounds": confounds and confounds.tree(),
            "pointing_terms": None if self.pointing_terms is None else self.pointing_terms.tree(),
            "lost_vertices": [] if self.extended is None else self.extended.lost.tolist(),
            "verdict": self.verdict.tree(),
        }

    def write_page(self, path: Path, links: Sequence[Link] = ()) -> None:
        """Write the page of it."""
        rest = (path, self.recording, self.calibration, self.samples)
        if isinstance(self.done, arm_certification.CertifiedArm):
            arm_page.write_arm_calibration_page(*rest, self.done, links)
        elif isinstance(self.done, chain_certification.CertifiedChain):
            chain_certification.write_chain_calibration_page(*rest, self.done, links)
        else:
            platform_page.write_platform_calibration_page(*rest, self.done.found, links)

    def write_summands(self, path: Path) -> None:
        """Write the correction values at the recorded configurations (ksf.csv). Raises RigError where there are none:
        of an arm whose poses do not determine its joints
        """
        nominal, samples = self.calibration.correction.nominal, self.sampled.samples
        if hand_names(nominal):
            raise RigError("correction values by joint are for arms with one hand: several share joints")
        if nominal.link_rows is not None:
            if samples.measured in arm_certification.UNPLACED:
                raise RigError(arm_certification.UNPLACED[samples.measured])
            found = commanded_minus_joint_values_by_stated_arm(samples, nominal)
        elif nominal.bodies:
            found = chain_correction_summands(samples, nominal, samples.total_covariance())
        else:
            found = strut_correction_summands(samples, nominal)
        write_table(
            path, correction_summand_column_names(len(nominal.axes)), correction_summand_csv_rows(samples, found)
        )


def has_axis_correction_summands(design: Design) -> bool:
    """Whether a design's machine has correction summands, one per axis (ksf.csv)."""
    return not hand_names(design.mechanism)


def calibrate(
    recordings: Recording | Sequence[Recording],
    options: CalibrateOptions = SEARCHED,
    progress: Progress | None = None,
    notice: Notice = ignore_notice,
) -> CalibrationResult:
    """CalibrationResult of a recording, or of several of one rig jointly, as `rig calibrate` makes it.

    progress : called with (label, done, of), or None; notice : called with lines on what is unlikely in the recording
    Raises RigError without commands and for a recording whose results would mean nothing, NotEnoughData without poses,
        NotConverged where no geometry agrees with them
    """
    prepared = check_and_combine_recordings(recordings, options.anyway, notice, progress)
    recording, call = prepared.recording, progress or ignore_progress
    if prepared.joined and options.limbs is not None:
        raise RigError("--limbs reads the poses of one recording from measuring limbs; name one")
    options.refuse_unsuited(recording.design)
    kinds = effect_catalogue_with_user_files(options.effects)
    findings = None if options.diagnosis is None else load_findings(options.diagnosis, recording, kinds)
    with threadpool_limits(1):  # sums of products are rounded by how many threads share them
        if options.limbs is not None:
            sampled = sample_recording_by_checked_measuring_limbs(recording, options.limbs, progress, notice)
        else:
            sampled = sample_recording(recording, progress=progress, on_corners=prepared.look, several_hands=True)
        _require_tilt_readings(recording)
        clocks: tuple[Clocks, ...] = ()
        if not options.with_findings and options.limbs is None:  # which tell clocks and lags themselves
            clocks = estimate_clocks_from_samples(recording, sampled.samples)
            recording, sampled = recording_and_poses_on_commands_clock(recording, sampled, clocks)
        sampled = replace(sampled, files=(*sampled.files, *(plugin.path for plugin in options.effects)))
        return replace(_calibrated(recording, sampled, findings, kinds, options, call), clocks=clocks)


def _require_tilt_readings(recording: Recording) -> None:
    """Raise RigError for tilt sensors that are stated and were not logged."""
    known = () if recording.sensors is None else tuple(recording.sensors.channels)
    for sensor in recording.design.tilt_sensors:
        if sensor.channels(known) is None:
            raise RigError(
                f"rig.toml states the tilt sensor {sensor.name!r} ([[tilt_sensor]]), and sensors.csv has no "
                f"tilt_{sensor.name}_x_rad and tilt_{sensor.name}_y_rad (or _deg): log both, or take the sensor out"
            )


def _calibrated(
    recording: Recording,
    sampled: Sampled,
    findings: Findings | None,
    kinds: Kinds,
    options: CalibrateOptions,
    progress: Progress,
) -> CalibrationResult:
    """CalibrationResult of a recording's poses. findings : of a diagnosis that is named, or None"""
    rng = np.random.default_rng(SEED)
    mechanism = recording.design.mechanism
    if options.extend is not None:
        return _extended(recording, sampled, options, options.extend, rng, progress)
    pointing = sampled.samples.measured == "direction"
    if findings is None and (options.with_findings or pointing and not options.quick):
        instrument_fit = fit_of_effects_shown_by_instruments(recording, sampled)
        searched = sampled if instrument_fit is None else replace(sampled, samples=instrument_fit.samples)
        requested = DiagnosisOptions(sampled=searched, kinds=tuple(kinds.values()), detectable_sizes=False)
        findings = findings_of_diagnosis(diagnose(recording, requested, progress))
    findings = findings_with_missing_instrument_effects_added(findings, recording, sampled)
    known = None
    if mechanism.bodies:
        samples, done, claim = _fitted_chain(recording, sampled, rng, progress)
    elif mechanism.link_rows is not None:
        samples, done, claim, known = _fitted_arm(recording, sampled, findings, rng, progress)
    else:
        samples, done, claim, known = _fitted_platform(recording, sampled, findings, options.joint, rng, progress)
    made = calibration_with_provenance(recording, sampled, done, claim, options.arguments, known)
    if known is None:
        made = _searched(made, recording, sampled, options, progress)
    return CalibrationResult(made, recording, sampled, samples, done)


def _fitted_chain(
    recording: Recording, sampled: Sampled, rng: np.random.Generator, progress: Progress
) -> tuple[Samples, Certified, Claim]:
    """(the Samples fitted, Certified, Claim) of a chain."""
    chain = require_chain(recording.design.mechanism)
    done = chain_certification.certify_chain(sampled.samples, chain, rng, progress)
    return sampled.samples, done, chain_certification.chain_workspace_claim(sampled.samples, done, rng)


def _fitted_platform(
    recording: Recording,
    sampled: Sampled,
    findings: Findings | None,
    joint: bool,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[Samples, Certified, Claim, Known]:
    """(the Samples fitted, Certified, Claim, Known) of a platform on struts. findings : that are fitted with the
    geometry, or None; joint : whether cameras are adjusted with the struts
    """
    struts, samples = require_parallel(recording.design.mechanism), sampled.samples
    refit = None
    if findings is not None:
        refit = geometry_refitted_with_diagnosed_effects.refit_platform_with_findings(
            recording, sampled, findings, progress
        )
        samples = refit.samples
    if joint:
        require_hexapod(struts)
    done = platform_certification.certify_platform(samples, struts, rng, progress)
    if joint:
        progress("solving cameras and geometry jointly", 0, 1)
        correction, found = refine_correction_with_cameras(sampled, recording.design, done.correction, done.found)
        done = platform_certification.certified_with_refitted_correction(done, correction, found)
    if refit is not None:
        done = refit.drawn(done, rng)
    claim = platform_certification.platform_workspace_claim(samples, done, rng)
    return samples, done, claim, None if refit is None else refit.with_geometry(done)


def _fitted_arm(
    recording: Recording, sampled: Sampled, findings: Findings | None, rng: np.random.Generator, progress: Progress
) -> tuple[Samples, Certified, Claim, Known]:
    """(the Samples fitted, Certified, Claim, Known) of an arm. findings : that are fitted with the geometry, or None"""
    refit = together = None
    if findings is not None:
        refit = geometry_refitted_with_diagnosed_effects.refit_arm_with_findings(recording, sampled, findings, progress)
        together = refit.together
    samples = sampled.samples if together is None else together.samples
    arm = require_arm(recording.design.mechanism)
    done = arm_certification.certify_arm(sampled.samples, arm, sampled.instrument, rng, progress, together)
    claim = arm_workspace_claim(samples, done, rng)
    return samples, done, claim, None if refit is None else refit.with_geometry(done)


def _extended(
    recording: Recording,
    sampled: Sampled,
    options: CalibrateOptions,
    extend: ExtendOptions,
    rng: np.random.Generator,
    progress: Progress,
) -> CalibrationResult:
    """CalibrationResult of corrections that are extended over a space."""
    found = certify_correction_extension(extend, recording.design, sampled, rng, progress)
    before = None if extend.onto is None else (extend.onto, found.provenance)
    made = calibration_with_provenance(
        recording, sampled, found.done, found.claim, options.arguments, previous_calibration=before
    )
    return CalibrationResult(made, recording, sampled, sampled.samples, found.done, found)


def _searched(
    calibration: Calibration, recording: Recording, sampled: Sampled, options: CalibrateOptions, progress: Progress
) -> Calibration:
    """The Calibration with what it leaves out, as far as that is to be searched for."""
    if options.limbs is not None:
        return calibration
    return (
        mark_as_not_searched_for_left_out_physics(calibration)
        if options.quick
        else calibration_with_left_out_physics(calibration, recording, sampled, progress)
    )
