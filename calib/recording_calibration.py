"""Calibration, diagnosis and certificate of recordings, as the commands and a notebook call them."""

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from calib.certificate import certificate as statement
from calib.certificate.certificate import Certificate
from calib.certificate.certificate_contents import Asked
from calib.certify.calibration import Calibration
from calib.certify.platform_certification import Progress
from calib.diagnose.calibration_left_out_physics import search_left_out_physics
from calib.diagnose.recording_diagnosis import DiagnosisOptions, diagnose
from calib.diagnose.report.diagnosis_report import Report
from calib.diagnose.report.report_entries import diagnosis_report
from calib.files import calibration_file
from calib.files.calibration_from_recording import SEED, calibration_with_provenance
from calib.models.machine_models import model_of
from calib.samples.recording_samples import Sampled, sample_recording
from rig.errors import RigError
from rig.model.mechanism_kinds import require_axes
from rig.recording.frame_content_hashes import content_hashes, frames_with_known_hashes, hashes_of_frames
from rig.recording.recording_folder import Recording


def calibrated(recording: Recording, progress: Progress | None = None) -> Calibration:
    """Calibration of a recording, as `rig calibrate` makes it.

    What it leaves out is looked for as `diagnosed` does, and stands in its claim. progress : called with (label, done,
    of), or None
    Raises RigError without commands, NotEnoughData without poses, NotConverged where no geometry agrees with them
    """
    rng = np.random.default_rng(SEED)
    with threadpool_limits(
        1
    ):  # sums of products are rounded by how many threads share them: the result is the same for any number
        sampled = sample_recording(recording, progress=progress)
        mechanism = recording.design.mechanism
        found, claim = model_of(mechanism).certify(sampled, require_axes(mechanism), rng, progress)
        made = calibration_with_provenance(recording, sampled, found, claim)
        return search_left_out_physics(made, recording, sampled, progress)


def diagnosed(
    recording: Recording,
    only: Sequence[str] | None = None,
    without: Sequence[str] = (),
    progress: Progress | None = None,
) -> Report:
    """Diagnosis report of a recording: what physics its model leaves out, as `rig diagnose` finds it.

    only, without : names of effects (or "EFFECT PLACE") that alone are asked for, or left out
    Raises RigError for a name that there is not, NotEnoughData where the recording tells nothing
    """
    options = DiagnosisOptions(None if only is None else tuple(only), tuple(without))
    return diagnosis_report(diagnose(recording, options, progress))


def certified(
    calibration: Calibration,
    recordings: Sequence[Recording],
    request: Asked | None = None,
    progress: Progress | None = None,
) -> Certificate:
    """Certificate of a calibration by recordings it was not made from, as `rig certify` makes it.
    request : what of, 95 % with 95 % by default

    Raises RigError for a recording that took part in fitting, NotEnoughData where these have too few configurations
    """
    held = held_out_recordings(calibration, recordings, progress)
    made = calibration.provenance
    source = {
        "calibration": {"recording": made.get("recording"), "created": made.get("created")},
        "versions": calibration_file.package_versions(),
        "seed": SEED,
        "recordings": [recording.name for recording in recordings],
    }
    return statement.calibration_certificate(
        calibration, held, Asked() if request is None else request, source, np.random.default_rng(SEED)
    )


def held_out_recordings(
    calibration: Calibration,
    recordings: Sequence[Recording],
    progress: Progress | None = None,
    named: str = "the calibration",
) -> list[tuple[Recording, Sampled]]:
    """Held-out recordings [(Recording, Sampled)]: none of whose data was used in the calibration.
    named : the calibration, in words

    Raises RigError naming what did
    """
    if not calibration.provenance.get("data"):
        raise RigError(
            f"{named} does not say which data it was made from, so nothing can be shown to be held out; calibrate again"
        )
    known: set[str] = set()
    for recording in recordings:
        path, frames = recording.folder, len(recording.exposures.times()[0])
        same = calibration_file.frames_used_in_calibration(calibration, recording)
        if same:
            raise RigError(
                f"{path}: {len(same)} of {frames} frames (the first: {same[0]}) took part in fitting {named}, "
                "themselves or what was measured from them; a certificate takes poses that did not. Of a "
                "recording alone, --mask keeps "
                "some frames from rig calibrate, and then the others from rig certify"
            )
        calibration.refuse_kind(recording.design.mechanism.kind, str(path))
        of = content_hashes(recording)
        twice = frames_with_known_hashes(of, known)
        if twice:
            raise RigError(
                f"{path}: {len(twice)} of {frames} frames are in another of the recordings; the same pose "
                "does not count twice"
            )
        known |= set(hashes_of_frames(of))
    return [(recording, sample_recording(recording, progress=progress)) for recording in recordings]
