"""Calibration provenance (inputs, data, versions, arguments), the Calibration made with it, and its used frames."""

import hashlib
import platform
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_accuracy_claim_sentences import Calibration
from calib.certification.error_claim_over_workspace import Claim
from calib.certification.platform_certification import Certified
from calib.correction.physics_compensation import Physics
from calib.models.arm.certification import CertifiedArm as ArmCertified
from calib.models.chain.certification_and_page import CertifiedChain as ChainCertified
from calib.models.machine_models import calibration_with_workspace
from calib.samples.confounded_conditions import confounds_of_samples
from calib.samples.pose_samples import Sampled
from rig.array_and_json_types import Floats, Json
from rig.formats import local_and_remote_input_files
from rig.formats.local_and_remote_input_files import read_bytes
from rig.recording.frame_selection_and_content_hashes import (
    content_hashes_of_frames,
    frames_with_known_hashes,
    hashes_of_frames,
)
from rig.recording.image_file_check_and_reading import LARGEST_IMAGE_FILE
from rig.recording.recording_folder import Recording

PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "rig")
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
    source = calibration_provenance(recording, arguments, SEED, sampled.source == "images", sampled.files, sampled.data)
    if previous_calibration is not None:
        source = additional_pass_provenance(source, *previous_calibration)
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


def calibration_provenance(
    recording: Recording,
    arguments: Sequence[str],
    seed: int,
    used_images: bool,
    other_files: Iterable[Path] = (),
    data: Iterable[str] = (),
) -> Json:
    """Provenance of a calibration as a dict: hashes of its inputs and their data, versions, arguments and seed.

    Marks of the data: see rig.recording.frame_selection_and_content_hashes.
    recording : Recording; used_images : whether they were read; other_files : other files that were read, data : marks
        of theirs
    """
    files: dict[str, str] = {}
    for k, part in enumerate(recording.apart):
        own = _input_digests(part.recording, used_images)
        files |= (
            {f"{k + 1} {part.recording.name}/{name}": digest for name, digest in own.items()}
            if recording.parts
            else own
        )
    files.update({Path(path).name: _hash([path]) for path in other_files})
    return {
        "recording": recording.name,
        "inputs_sha256": files,
        "data": sorted({*hashes_of_frames(content_hashes_of_frames(recording)), *data}),
        "arguments": list(arguments),
        "seed": seed,
        "versions": package_versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _input_digests(recording: Recording, used_images: bool) -> dict[str, str]:
    """{file: SHA-256} of a recording's files, its images together. used_images : whether they were read"""
    folder = recording.folder
    files = {
        name: _hash([folder / name])
        for name in local_and_remote_input_files.list_folder(folder)
        if name.endswith((".toml", ".csv"))
    }
    if used_images:
        names = sorted(name for name in recording.exposures.image if name)
        files[f"images ({len(names)})"] = _hash([folder / name for name in names])
    return files


def package_versions() -> dict[str, str]:
    """Versions {package name: version} of the packages that results depend on."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def additional_pass_provenance(own: Json, previous_provenance: Calibration, requested_pass: Json) -> Json:
    """Provenance of an additional pass: its own, the passes before it, and the marks of all data."""
    kept = ("recording", "inputs_sha256", "arguments", "created", "pass")
    first = {name: previous_provenance.provenance[name] for name in kept if name in previous_provenance.provenance}
    passes = [*previous_provenance.provenance.get("passes", []), first]
    return {
        **own,
        "pass": requested_pass,
        "data": [*previous_provenance.provenance.get("data", []), *own["data"]],
        "passes": passes,
    }


def frames_used_in_calibration(calibration: Calibration, recording: Recording) -> list[int]:
    """Frames of a recording that were used in a calibration, directly or through its measurement."""
    return frames_with_known_hashes(content_hashes_of_frames(recording), calibration.provenance.get("data", ()))


def _hash(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(read_bytes(Path(path), LARGEST_IMAGE_FILE))
    return digest.hexdigest()
