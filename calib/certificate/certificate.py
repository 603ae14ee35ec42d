"""What a certificate states, from a calibration and recordings that it was not made from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.certificate import certificate_sentences
from calib.certificate.certificate_contents import Asked, Contents
from calib.certificate.measuring_conditions import conditions, volume
from calib.certify import tolerance_conformity, tolerance_limits
from calib.certify.calibration import Calibration
from calib.certify.held_out_errors import error_figures, errors_before_and_after
from calib.certify.held_out_poses import HeldPoses, held_poses
from calib.certify.iso230_axis_errors import iso230
from calib.certify.iso9283 import duty_of, iso9283
from calib.certify.pose_error_promise import POSITION, ROTATION, Unit, depth_bound, pose_error_promise, promise_by_cell
from calib.certify.repeatability import pose_repeatability
from calib.certify.tolerance_conformity import Conformity
from calib.certify.uncertainty_budget import rms_uncertainty, thermometer_covariance, uncertainty_budget
from calib.models.corrected_pose_covariance import pose_covariance
from calib.samples.confounded_conditions import confounds_of_recordings
from calib.samples.recording_samples import Sampled
from rig.errors import NotEnoughData
from rig.recording.recording_folder import Recording
from rig.report.notebook_display import result_html


@dataclass(frozen=True, slots=True, eq=False)
class Certificate(Contents):
    """A certificate that a notebook shows in its own sentences; see Contents."""

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(
            certificate_sentences.promise_line(self),
            [
                certificate_sentences.scale_line(self),
                certificate_sentences.volume_line(self),
                *certificate_sentences.basis_lines(self),
                *certificate_sentences.conformity_lines(self),
            ],
        )


def certificate_of(
    calibration: Calibration,
    held: Sequence[tuple[Recording, Sampled]],
    asked: Asked,
    provenance: dict[str, Any],
    rng: np.random.Generator,
) -> Certificate:
    """Certificate of a Calibration by recordings held out. rng : numpy Generator, for the draws of shared errors

    Raises NotEnoughData where these have too few configurations at rest
    """
    poses = combined_held_out_poses(calibration, held)
    units, scale = _units(calibration, poses), asked.scale or 0.0
    promise = pose_error_promise(poses, asked.coverage, asked.confidence, scale, units, rng)
    again = pose_repeatability(poses)
    at = poses.first
    contributions = uncertainty_budget(
        poses,
        _model(calibration, poses),
        again,
        [(s.samples, s.measurement) for _, s in held],
        asked.scale,
        thermometer_covariance(calibration, [(recording, s.samples) for recording, s in held]),
    )
    recordings = [recording for recording, _ in held]
    circumstances = conditions(poses, recordings, [s.source for _, s in held])
    duty = duty_of(poses, recordings, recordings[0].design, circumstances.payload, asked.rated_load)
    return Certificate(
        calibration.correction.nominal.kind,
        asked,
        promise,
        promise_by_cell(poses, asked.coverage, asked.confidence, scale, units, rng),
        volume(poses, calibration.correction.nominal),
        again,
        iso9283(poses, duty),
        iso230(calibration.correction, poses),
        _judged(poses, asked, rng),
        contributions,
        circumstances,
        poses.errors[at],
        error_figures(poses.plain[at]),
        error_figures(poses.errors[at]),
        provenance,
        confounds_of_recordings([recording for recording, _ in held]),
    )


def combined_held_out_poses(calibration: Calibration, held: Sequence[tuple[Recording, Sampled]]) -> HeldPoses:
    """HeldPoses of recordings under a calibration."""
    parts = []
    for recording, sampled in held:
        assert recording.commands is not None  # sample_recording refuses a recording without
        samples = calibration.with_physics(recording, sampled.samples)
        plain, errors = errors_before_and_after(calibration.correction, samples)
        parts.append((samples, recording.commands, plain, errors))
    return held_poses(calibration.correction, parts)


def _model(calibration: Calibration, poses: HeldPoses) -> np.ndarray:
    """(n, 6, 6) of the parameters alone: what axes and poses scatter shows in the poses themselves."""
    geometry = Calibration(
        calibration.correction, calibration.covariance, np.zeros_like(calibration.scatter), (), (), None, {}
    )
    return pose_covariance(geometry, poses.T_base_platform, poses.commanded)


def _units(calibration: Calibration, poses: HeldPoses) -> tuple[float, float]:
    """(m, rad) in which errors count for a pose's depth: RMS errors of the poses that the calibration itself held out,
    or, of one that held out none, what its parameters and measuring lead to expect. Neither has seen an error of
    `poses`."""
    if calibration.held_out is not None:
        after = calibration.held_out.after
        if after.position[0] > 0 and after.rotation[0] > 0:
            return after.position[0], after.rotation[0]
    return rms_uncertainty(pose_covariance(calibration, poses.T_base_platform, poses.commanded) + poses.own)


def _judged(poses: HeldPoses, asked: Asked, rng: np.random.Generator) -> tuple[Conformity, ...]:
    if not asked.tolerances:
        return ()
    if not poses.rotations and any(quantity == "rotation" for quantity, _ in asked.tolerances):
        raise NotEnoughData("no rotation was measured, so none can be held against a tolerance")
    units = tuple(Unit(POSITION if quantity == "position" else ROTATION, size) for quantity, size in asked.tolerances)
    enough = len(poses.first) >= tolerance_limits.least_sample_size(asked.coverage, tolerance_conformity.GUARD)
    depth = (
        depth_bound(poses, poses.first, units, (asked.coverage, tolerance_conformity.GUARD), asked.scale or 0.0, rng)
        if enough
        else None
    )
    beyond = [int((np.linalg.norm(poses.errors[poses.first][:, unit.of], axis=1) > unit.size).sum()) for unit in units]
    return tolerance_conformity.tolerance_conformity(asked.tolerances, depth, asked.scale is not None, beyond)
