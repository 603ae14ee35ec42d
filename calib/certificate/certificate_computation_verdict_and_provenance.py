"""Computation of a certificate, its verdict and its provenance.

It is computed from held-out recordings.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from calib.certificate import certificate_sentences_and_quantity_texts
from calib.certificate.certificate_content_dataclasses import (
    CertifyOptions,
    Contents,
    measuring_conditions,
    ranges_of_measured_positions_rotations_and_axes,
)
from calib.certification import noise_free_errors_and_tolerance_limits, pose_error_promise_and_conformity
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.held_out_pose_error_statistics import error_statistics, errors_before_and_after_correction
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    HeldPoses,
    held_out_poses,
    pose_repeatability,
)
from calib.certification.iso230_and_iso9283_tests import (
    iso230_tests_of_corrected_axes,
    iso9283_accuracy_and_repeatability,
    speeds_and_loads_of_test,
)
from calib.certification.pose_error_promise_and_conformity import (
    CONFORMS,
    FAILS,
    POSITION,
    ROTATION,
    Conformity,
    Unit,
    greatest_scaled_error_bound,
    pose_error_promise,
    promise_by_cell,
)
from calib.certification.uncertainty_budget import (
    rms_position_and_rotation_uncertainty,
    thermometer_covariance,
    uncertainty_budget,
)
from calib.files import calibration_file
from calib.files.calibration_file import calibration_json_text
from calib.models.machine_parameters_and_file_entries import corrected_pose_covariance
from calib.samples.commanded_and_measured_pose_samples import Sampled
from calib.samples.position_confounds_and_poses_on_one_clock import confound_sentences, confounds_of_recordings
from rig.array_and_json_types import Floats, Json
from rig.errors import NotEnoughData
from rig.recording.frame_selection_and_content_hashes import content_hashes_of_frames, sorted_hashes_of_frames
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import (
    Evidence,
    MissingEvidence,
    OneLineRepr,
    Verdict,
    judge_evidence,
    result_html,
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Certificate(OneLineRepr, Contents):
    """A certificate that a notebook shows in its own sentences; see Contents."""

    def __str__(self) -> str:
        return certificate_sentences_and_quantity_texts.promise_line(self)

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(
            str(self),
            [
                certificate_sentences_and_quantity_texts.length_scale_line(self),
                certificate_sentences_and_quantity_texts.measured_volume_line(self),
                *certificate_sentences_and_quantity_texts.promise_basis_lines(self),
                *certificate_sentences_and_quantity_texts.conformity_lines(self),
            ],
        )


def calibration_certificate(
    calibration: Calibration,
    held_out_recordings: Sequence[tuple[Recording, Sampled]],
    request: CertifyOptions,
    provenance: Json,
    rng: np.random.Generator,
) -> Certificate:
    """Certificate of a calibration from held-out recordings.

    rng : numpy Generator, for the draws of shared errors
    Raises NotEnoughData where these have too few configurations at rest
    """
    poses = combined_held_out_poses(calibration, held_out_recordings)
    units, scale = _units(calibration, poses), request.scale or 0.0
    promise = pose_error_promise(poses, request.coverage, request.confidence, scale, units, rng)
    repeatability = pose_repeatability(poses)
    at = poses.first
    contributions = uncertainty_budget(
        poses,
        _model(calibration, poses),
        repeatability,
        [(s.samples, s.measurement) for _, s in held_out_recordings],
        request.scale,
        thermometer_covariance(calibration, [(recording, s.samples) for recording, s in held_out_recordings]),
    )
    recordings = [recording for recording, _ in held_out_recordings]
    circumstances = measuring_conditions(poses, recordings, [s.source for _, s in held_out_recordings])
    duty = speeds_and_loads_of_test(poses, recordings, recordings[0].design, circumstances.payload, request.rated_load)
    return Certificate(
        calibration.correction.nominal.kind,
        request,
        promise,
        promise_by_cell(poses, request.coverage, request.confidence, scale, units, rng),
        ranges_of_measured_positions_rotations_and_axes(poses, calibration.correction.nominal),
        repeatability,
        iso9283_accuracy_and_repeatability(poses, duty),
        iso230_tests_of_corrected_axes(calibration.correction, poses),
        _judged(poses, request, rng),
        contributions,
        circumstances,
        poses.errors[at],
        error_statistics(poses.plain[at]),
        error_statistics(poses.errors[at]),
        provenance,
        confounds_of_recordings([recording for recording, _ in held_out_recordings]),
    )


def combined_held_out_poses(
    calibration: Calibration, held_out_recordings: Sequence[tuple[Recording, Sampled]]
) -> HeldPoses:
    """Held-out poses of a calibration's held-out recordings, combined as HeldPoses."""
    parts = []
    for recording, sampled in held_out_recordings:
        assert recording.commands is not None  # sample_recording refuses a recording without
        samples = calibration.with_physics(recording, sampled.samples)
        plain, errors = errors_before_and_after_correction(calibration.correction, samples)
        parts.append((samples, recording.commands, plain, errors))
    return held_out_poses(calibration.correction, parts)


def _model(calibration: Calibration, poses: HeldPoses) -> Floats:
    """(n, 6, 6) of the parameters alone: what axes and poses scatter shows in the poses themselves."""
    geometry = Calibration(
        calibration.correction, calibration.covariance, np.zeros_like(calibration.scatter), (), (), None, {}
    )
    return corrected_pose_covariance(geometry, poses.T_base_platform, poses.commanded)


def _units(calibration: Calibration, poses: HeldPoses) -> tuple[float, float]:
    """(m, rad) in which errors count for a pose's depth: RMS errors of the poses that the calibration itself held out,
    or, of one that held out none, what its parameters and measuring lead to expect. Neither has seen an error of
    `poses`."""
    if calibration.held_out is not None:
        after = calibration.held_out.after
        if after.position[0] > 0 and after.rotation[0] > 0:
            return after.position[0], after.rotation[0]
    return rms_position_and_rotation_uncertainty(
        corrected_pose_covariance(calibration, poses.T_base_platform, poses.commanded) + poses.own
    )


def _judged(poses: HeldPoses, options: CertifyOptions, rng: np.random.Generator) -> tuple[Conformity, ...]:
    if not options.tolerances:
        return ()
    if not poses.rotations and any(quantity == "rotation" for quantity, _ in options.tolerances):
        raise NotEnoughData("no rotation was measured, so none can be compared with a tolerance")
    units = tuple(Unit(POSITION if quantity == "position" else ROTATION, size) for quantity, size in options.tolerances)
    enough = len(poses.first) >= noise_free_errors_and_tolerance_limits.least_sample_size(
        options.coverage, pose_error_promise_and_conformity.GUARD
    )
    depth = (
        greatest_scaled_error_bound(
            poses,
            poses.first,
            units,
            (options.coverage, pose_error_promise_and_conformity.GUARD),
            options.scale or 0.0,
            rng,
        )
        if enough
        else None
    )
    beyond = [int((np.linalg.norm(poses.errors[poses.first][:, unit.of], axis=1) > unit.size).sum()) for unit in units]
    return pose_error_promise_and_conformity.tolerance_conformity(
        options.tolerances, depth, options.scale is not None, beyond
    )


SCALE = MissingEvidence(
    "the scale of the lengths is not certified",
    "Obtain a certified scale of the base targets and state it: `--scale-uncertainty 20e-6 --scale-source TEXT`",
)
TWICE = "Visit some configurations twice, `--plan sobol:40,repeat:20`: this determines the repeatability"
CHECK_PERIODICALLY = "Check periodically whether it is still valid: `rig watch calibration.json VISIT`"


def certificate_verdict(certificate: Certificate) -> Verdict:
    """Verdict of a certificate.

    It is against tolerances, or what is promised where there are none.
    """
    lines = (
        certificate_sentences_and_quantity_texts.conformity_lines(certificate)
        if certificate.conformity
        else [certificate_sentences_and_quantity_texts.promise_line(certificate)]
    )
    known = Evidence("") if certificate.known is None else certificate.known
    verdicts = {k.verdict for k in certificate.conformity}
    failed = tuple(
        f"{k.quantity} does not conform to its tolerance" for k in certificate.conformity if k.verdict == FAILS
    )
    missing = [*known.missing, *([SCALE] if certificate.options.scale is None else [])]
    if verdicts - {CONFORMS, FAILS}:
        missing.append(MissingEvidence("these poses do not determine whether all tolerances are met"))
    confounds = (
        [f"these recordings: {text}" for text in confound_sentences(certificate.confounds)]
        if certificate.known is None
        else known.confounds
    )
    steps = (*([TWICE] if certificate.repeatability.position is None else []), CHECK_PERIODICALLY)
    return judge_evidence(
        replace(
            known,
            statement="; ".join(line.removesuffix(".") for line in lines),
            steps=steps,
            confounds=tuple(confounds),
            missing=tuple(missing),
            refuted=(*failed, *known.refuted),
        )
    )


def certificate_provenance(
    path: Path | None, calibration: Calibration, recordings: Sequence[Recording], arguments: Sequence[str], seed: int
) -> Json:
    """Provenance of a certificate as a dict.

    Digests of its inputs, versions, seed, arguments, time and an id.
    path : of the calibration's file, None where it is in none yet
    The digests are of the calibration's file, or what would be in it, of each recording's tables and of the content
    marks of its exposures; the id is of what went in and what was asked, not of when.
    """
    text = calibration_json_text(calibration).encode() if path is None else path.read_bytes()
    inputs = {"calibration.json" if path is None else path.name: {"file": hashlib.sha256(text).hexdigest()}}
    for recording in recordings:
        name = recording.folder.resolve().name
        origin = calibration_file.calibration_provenance(recording, (), seed, recording.has_images)
        content = hashlib.sha256(
            "\n".join(sorted_hashes_of_frames(content_hashes_of_frames(recording))).encode()
        ).hexdigest()
        inputs[name if name not in inputs else str(recording.folder)] = {
            **origin["inputs_sha256"],
            "exposures": content,
        }
    made = calibration.provenance
    what = json.dumps([inputs, list(arguments)], sort_keys=True)
    return {
        "inputs_sha256": inputs,
        "calibration": {"recording": made.get("recording"), "created": made.get("created")},
        "versions": calibration_file.package_versions(),
        "seed": seed,
        "arguments": list(arguments),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "id": hashlib.sha256(what.encode()).hexdigest()[:16],
    }
