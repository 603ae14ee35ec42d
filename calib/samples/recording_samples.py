"""Samples of a recording, from its instrument's poses, its images or its poses.csv."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.samples.pose_samples import Samples, add_stage_measurements, pair_samples, planar_samples
from rig.array_and_json_types import Floats
from rig.errors import NotEnoughData, RigError
from rig.model.design import Instrument
from rig.model.mechanism_kinds_singularity_and_cardan_twist import has_links
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Corners, Poses
from vision.reading.recording_corners import Collected
from vision.recording_adjustment import Measurement
from vision.recording_measurement import measure_recording

UNSTATED = (1e-5, 1e-4)  # m, rad; standard deviations of poses for which nobody states any
CAMERAS = Instrument("free", "free", *UNSTATED)  # that see an arm's hand, or the room from it


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """samples : Samples; source : where the poses came from, in words; measurement, collected : from vision, or None
    files : beside the recording, from which the poses were computed; data : marks of what those were learnt from (see
        rig.recording.frame_selection_and_content_hashes)
    instrument : who saw the poses and whether it is known where it stands and where its target sits: of an arm that
    cameras see neither is, so that its base among the base's targets and its hand in the platform's frame are solved
    for; None where all are known
    assumed : whether the noise is not stated of poses.csv, so that UNSTATED stands for it."""

    samples: Samples
    source: str
    measurement: Measurement | None
    collected: Collected | None
    files: tuple[Path, ...] = ()
    data: tuple[str, ...] = ()
    instrument: Instrument | None = None
    assumed: bool = False


def sample_recording(
    recording: Recording,
    free: tuple[str, ...] = ("poses", "lenses"),
    progress: Callable[[str, int, int], None] | None = None,
    on_corners: Callable[[Corners], None] | None = None,
) -> Sampled:
    """Samples of a recording (Sampled): from its instrument's poses, its corners or images, or poses.csv.

    progress : called with (label, done, of), or None; on_corners : called with the Corners before they are measured, or
        None
    Raises RigError without commands, NotEnoughData without poses, and what look raises
    """
    recording.commanded()  # a recording that nobody commanded fails before its images are read
    poses = recording.poses
    if poses is not None and (
        recording.design.instrument is not None or (recording.corners is None and not recording.has_images)
    ):
        stated = poses.covariance is not None or recording.design.instrument is not None
        return Sampled(
            samples_within_freedoms(recording, _from_poses(recording, poses)),
            "poses.csv",
            None,
            None,
            instrument=recording.design.instrument,
            assumed=not stated,
        )
    if recording.corners is None and not recording.has_images:
        raise NotEnoughData(
            f"{recording.folder}: there are no images, no corners.csv and no poses.csv, so nothing was measured"
        )
    measured, collected = measure_recording(recording, free, progress=progress, check_corners=on_corners)
    own = measured.covariance - measured.common @ np.swapaxes(measured.common, 1, 2)
    source = "images" if collected is not None else "corners.csv"
    found = pair_samples(recording, measured.frames, measured.T_base_platform, own, measured.common)
    for stage, below in measured.stages.items():
        alone = below.covariance - below.common @ np.swapaxes(below.common, 1, 2)
        found = add_stage_measurements(found, stage, below.frames, below.T_base_platform, alone, below.common)
    return Sampled(
        samples_within_freedoms(recording, found),
        source,
        measured,
        collected,
        instrument=CAMERAS if has_links(recording.design.mechanism) else None,
    )


def samples_within_freedoms(recording: Recording, samples: Samples) -> Samples:
    """Samples restricted to the freedoms of a recording's machine: planar ones of two struts."""
    return planar_samples(samples) if recording.design.mechanism.pose_coordinates == (0, 1) else samples


def _from_poses(recording: Recording, poses: Poses) -> Samples:
    instrument = recording.design.instrument
    if instrument is not None and not has_links(recording.design.mechanism):
        _require_whole_poses(recording, instrument)
    found = pair_samples(recording, poses.frame, poses.T_base_platform, _covariance(poses, instrument))
    for stage, below in recording.stages.items():
        found = add_stage_measurements(found, stage, below.frame, below.T_base_platform, _covariance(below, instrument))
    return found


def _require_whole_poses(recording: Recording, instrument: Instrument) -> None:
    """Raise RigError for an instrument whose place is estimated with arms alone, or that measures a part of poses."""
    kind = recording.design.mechanism.kind
    if "free" in (instrument.base, instrument.tool):
        raise RigError(
            f'{recording.folder}: an instrument whose pose is unknown (base or tool "free") is estimated '
            "for arms only, not for a "
            f"mechanism of kind {kind!r}; state its poses in the rig's own frames"
        )
    if instrument.kind != "pose":
        raise RigError(
            f"{recording.folder}: an [instrument] of kind {instrument.kind!r} calibrates arms, not a "
            f"mechanism of kind {kind!r}"
        )
    if instrument.rotation_sigma is None:
        raise RigError(
            f"{recording.folder}: [instrument] states no rotation_sigma, and positions alone calibrate arms, "
            "not a mechanism of "
            f"kind {kind!r}"
        )


def _covariance(poses: Poses, instrument: Instrument | None) -> Floats:
    """(n, 6, 6) of poses: their own, or what their instrument states."""
    if poses.covariance is not None:
        return poses.covariance
    position, rotation = (
        (instrument.position_sigma, instrument.rotation_sigma or np.inf) if instrument is not None else UNSTATED
    )
    variances = np.repeat([position**2, rotation**2], 3)
    if instrument is not None and instrument.kind == "distance":
        variances[1:] = np.inf
    return np.broadcast_to(np.diag(variances), (len(poses.frame), 6, 6))
