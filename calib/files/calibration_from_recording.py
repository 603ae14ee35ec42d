"""Calibration from a recording's fit, with its provenance and its workspace."""

from collections.abc import Sequence

import numpy as np

from calib.certification.calibration import Calibration
from calib.certification.platform_certification import Certified
from calib.certification.workspace_claim import Claim
from calib.correction.physics_compensation import Physics
from calib.files import calibration_file
from calib.models.arm.certification import Certified as ArmCertified
from calib.models.chain.certification import Certified as ChainCertified
from calib.models.corrected_pose_covariance import calibration_with_workspace
from calib.samples.confounded_conditions import confounds_of_samples
from calib.samples.recording_samples import Sampled
from rig.arrays import Floats
from rig.formats.json_tree import Json
from rig.recording.recording_folder import Recording

SEED = 0  # of draws; results are the same from run to run


def calibration_with_provenance(
    recording: Recording,
    sampled: Sampled,
    certified: Certified | ArmCertified | ChainCertified,
    claim: Claim,
    arguments: Sequence[str] = (),
    known: tuple[Physics, Floats] | None = None,
    previous_calibration: tuple[Calibration, Json] | None = None,
) -> Calibration:
    """Calibration of a recording's fit, with its provenance and workspace.

    arguments : of the command; known : (Physics, covariance of the parameters with it, m^2), or None;
        previous_calibration : on which this is one more pass
    """
    frames, found = sampled.samples.frame, certified.found
    covariance, scatter, together = found.covariance, found.scatter, None
    if isinstance(certified, Certified) and certified.covariance is not None and certified.strut_covariance is not None:
        covariance, together = (
            certified.covariance,
            certified.strut_covariance,
        )  # with all that these samples leave unknown
        scatter = np.sqrt(np.diag(together))
    physics, covariance = (None, covariance) if known is None else known
    source = calibration_file.calibration_provenance(
        recording, arguments, SEED, sampled.source == "images", sampled.files, sampled.data
    )
    if previous_calibration is not None:
        source = calibration_file.additional_pass_provenance(source, *previous_calibration)
    return calibration_with_workspace(
        Calibration(
            certified.correction,
            covariance,
            scatter,
            tuple(frames[found.inliers].tolist()),
            tuple(frames[~found.inliers].tolist()),
            certified.held_out,
            source,
            claim,
            physics,
            confounds=confounds_of_samples(sampled.samples, recording.design.mechanism),
            strut_covariance=together,
        )
    )
