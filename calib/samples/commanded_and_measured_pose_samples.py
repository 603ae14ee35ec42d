"""Samples of commanded and measured poses.

With their conditions: from an instrument's poses, images or poses.csv.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.samples.exposure_conditions import Conditions, conditions_of_exposures
from calib.samples.freely_placed_instrument_poses_combined_with_tilts import (
    UNSTATED,
    has_translation_only_platform,
    pose_covariance,
    poses_with_platform_tilts,
    recording_in_machine_frames,
)
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import NotEnoughData, RigError
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.base_and_link_tilt_sensors import TiltReadings, gravity_at_exposures
from rig.model.design import Instrument
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, has_links, nearest_reachable_poses
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.frame_selection_and_content_hashes import (
    hands_with_seen_targets,
    is_of_several_hands,
    require_one_hand_shown,
    select_hand,
)
from rig.recording.recording_folder import Recording

if TYPE_CHECKING:
    from vision.reading.corner_reading_from_recording_images import Collected
    from vision.recording_adjustment_with_hand_and_stages import Measurement


@dataclass(frozen=True, slots=True, eq=False)
class Below:
    """What was measured of a stage of a chain below the last in the n configurations of Samples.

    stage : number, from 1; T_base_stage : RigidTransform (n,); covariance, common : as of Samples, with the same shared
    draws; seen : (n,) bool, where it was measured: all else is void elsewhere
    """

    stage: int
    T_base_stage: RigidTransform
    covariance: Floats
    common: Floats
    seen: Booleans

    def take(self, index: Booleans | Integers | slice) -> Below:
        """The same of an index or mask (n,)."""
        return Below(self.stage, self.T_base_stage[index], self.covariance[index], self.common[index], self.seen[index])


def tilt_readings(recording: Recording, t: Floats) -> TiltReadings | None:
    """TiltReadings of a recording at times t (n,) s.

    They are of those sensors that were logged; None without any.
    """
    design, log = recording.design, recording.sensors
    if log is None:
        return None
    channel = partial(log.at, t)
    read = [(sensor, sensor.angles(log.channels, channel)) for sensor in design.tilt_sensors]
    shown = [(sensor, angles) for sensor, angles in read if angles is not None]
    if not shown:
        return None
    gravity = gravity_at_exposures(design.gravity, log.channels, channel, len(t))
    down = gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
    return TiltReadings(tuple(sensor for sensor, _ in shown), np.stack([angles for _, angles in shown], axis=1), down)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """n visited configurations.

    frame : (n,) numbers; t : (n,) s; commanded : (n, axes) m or rad
    T_base_platform : RigidTransform (n,), measured (GDK of the commanded configuration)
    covariance : (n, 6, 6) of each measured pose, tangent on the right, errors shared by all poses left out; diagonal
    and infinite for rotations that were not measured
    common : (n, 6, k) factor of the shared errors: error = common z + own, z ~ N(0, I) once for all poses,
        docs/mathematics.md (6)
    known : (n, axes) m or rad by which the axes stood beyond their commands, as far as physics that is known says; None
        for none
    below : (Below, ..) of a chain, what else was measured
    conditions : Conditions under which they were measured, None where no recording says
    tilts : TiltReadings, None without tilt sensors
    sway : (n, 6) tangent, on the right, that physics beyond its joints has, taken off an arm's poses; None for none
    hand : (n,) number, from 0, of the hand that each pose is of; None of machines with one, and of one hand's samples
    """

    frame: Integers
    t: Floats
    commanded: Floats
    T_base_platform: RigidTransform
    covariance: Floats
    common: Floats
    known: Floats | None = None
    below: tuple[Below, ...] = ()
    conditions: Conditions | None = None
    tilts: TiltReadings | None = None
    sway: Floats | None = None
    hand: Integers | None = None

    def __post_init__(self) -> None:
        if not len(self.frame):
            raise NotEnoughData("there is no frame with both a command and a measured pose")

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def measured(self) -> str:
        """What of a pose was measured: "pose", "position" or "orientation" alone, the "direction" of its z axis, or the
        "distance" of the target from the frame's origin, which then stands along x. What was not has an infinite
        variance."""
        known = np.isfinite(np.diag(self.covariance[0]))
        if known.tolist() == [False, False, False, True, True, False]:
            return "direction"
        return {(True, True): "pose", (True, False): "position", (False, True): "orientation"}.get(
            (bool(known[:3].all()), bool(known[3:].all())), "distance"
        )

    def take(self, index: Booleans | Integers | slice) -> Samples:
        """The samples of an index or mask (n,)."""
        return Samples(
            self.frame[index],
            self.t[index],
            self.commanded[index],
            self.T_base_platform[index],
            self.covariance[index],
            self.common[index],
            None if self.known is None else self.known[index],
            tuple(one.take(index) for one in self.below),
            None if self.conditions is None else self.conditions.take(index),
            None if self.tilts is None else self.tilts.take(index),
            None if self.sway is None else self.sway[index],
            None if self.hand is None else self.hand[index],
        )

    def by_hand(self) -> list[tuple[int, Booleans, Samples]]:
        """[(number, mask (n,), Samples)] of each hand's own, of an arm with several."""
        assert self.hand is not None
        masks = [(int(number), self.hand == number) for number in np.unique(self.hand)]
        return [(number, mask, replace(self.take(mask), hand=None)) for number, mask in masks]

    @property
    def effective(self) -> Floats:
        """(n, axes) m or rad that commands became by the physics that is known."""
        return self.commanded if self.known is None else self.commanded + self.known

    def total_covariance(self) -> Floats:
        """(n, 6, 6) covariance of each pose, shared errors included."""
        return self.covariance + self.common @ np.swapaxes(self.common, 1, 2)


def pair_commands_with_measured_poses(
    recording: Recording,
    frames: Integers,
    T_base_platform: RigidTransform,
    covariance: Floats,
    common: Floats | None = None,
) -> Samples:
    """Samples that pair a recording's commands with poses measured at some of its frames.

    frames : (f,) numbers of the measured frames; covariance : (f, 6, 6) without what `common` (f, 6, k) adds
    Raises RigError without commands, NotEnoughData where no frame has both.
    """
    known, t, values = recording.commanded()
    at = np.searchsorted(known, frames)
    common = np.zeros((len(frames), 6, 0)) if common is None else common
    return Samples(
        np.asarray(frames),
        t[at],
        values[at],
        T_base_platform,
        covariance,
        common,
        conditions=conditions_of_exposures(recording, t[at]),
        tilts=tilt_readings(recording, t[at]),
    )


def add_chain_stage_measurements(
    samples: Samples,
    stage: int,
    frames: Integers,
    T_base_stage: RigidTransform,
    covariance: Floats,
    common: Floats | None = None,
) -> Samples:
    """Samples with measurements of a chain's stage (from 1) added at frames (f,).

    covariance : (f, 6, 6) without what `common` (f, 6, k) adds, by the same draws as the platform's
    """
    if not len(frames):
        return samples
    common = np.zeros((len(frames), 6, 0)) if common is None else common
    at = np.searchsorted(frames, samples.frame)
    seen = np.isin(samples.frame, frames)
    row = np.where(seen, np.minimum(at, len(frames) - 1), 0)
    return replace(samples, below=(*samples.below, Below(stage, T_base_stage[row], covariance[row], common[row], seen)))


def samples_of_movable_coordinates(samples: Samples, mechanism: Mechanism) -> Samples:
    """Samples of the coordinates that a mechanism can move.

    They have what tilt sensors on its platform add to its poses; of fewer freedoms than six, only those of its
    platform's coordinates count as measured. The other coordinates are as at home and their covariance is 0: no axis
    moves them, and what is seen of them says how the target sits on the platform.
    """
    if samples.tilts is not None and not has_links(mechanism):
        poses = samples.T_base_platform, samples.covariance, samples.common
        fused = poses_with_platform_tilts(samples.tilts, *poses, samples.measured)
        samples = replace(samples, T_base_platform=fused[0], covariance=fused[1], common=fused[2], tilts=None)
    some = list(mechanism.pose_coordinates)
    if len(some) == 6:
        return samples
    measured = samples.T_base_platform.as_matrix()
    T = nearest_reachable_poses(samples.T_base_platform, mechanism)
    turned = np.swapaxes(T.rotation.as_matrix(), 1, 2) @ measured[:, :3, :3]  # measured axes to the nearest pose's
    to = np.zeros((len(samples), 6, 6))
    to[:, :3, :3] = to[:, 3:, 3:] = turned
    to[:, [k for k in range(6) if k not in some]] = 0
    covariance = to @ samples.covariance @ np.swapaxes(to, 1, 2)
    return replace(samples, T_base_platform=T, covariance=covariance, common=to @ samples.common)


def pose_covariance_pseudoinverse(covariance: Floats) -> Floats:
    """Pseudoinverse (n, 6, 6) of pose covariances.

    It is 0 in the directions in which a machine has no freedom.
    """
    none = np.diag(1.0 * ~covariance.any(axis=(0, 1)))
    return cast(Floats, np.linalg.inv(covariance + none) - none)


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


Progress = Callable[[str, int, int], None]  # called with (label, done, of)


def sample_recording(
    recording: Recording,
    free_quantities: tuple[str, ...] = ("poses", "lenses"),
    progress: Progress | None = None,
    on_corners: Callable[[Corners], None] | None = None,
    several_hands: bool = False,
) -> Sampled:
    """Samples of a recording (Sampled).

    They come from its instrument's poses, its corners or images, or poses.csv.
    progress : called with (label, done, of), or None; on_corners : called with the Corners before they are measured, or
        None; several_hands : whether poses may be of several hands
    Raises RigError without commands, and for poses of several hands that may not be, NotEnoughData without poses, and
    what look raises
    """
    if not several_hands:
        require_one_hand_shown(recording)
    recording.commanded()  # a recording that nobody commanded fails before its images are read
    poses = recording.poses
    if poses is not None and (
        recording.design.instrument is not None or (recording.corners is None and not recording.has_images)
    ):
        stated = poses.covariance is not None or recording.design.instrument is not None
        return Sampled(
            samples_of_movable_coordinates(_from_poses(recording), recording.design.mechanism),
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
    if is_of_several_hands(recording):
        return _sample_hands(recording, free_quantities, progress)
    from vision.recording_measurement import (
        measure_recording,  # opens OpenCV: only where images or corners are measured
    )

    measured, collected = measure_recording(recording, free_quantities, progress=progress, check_corners=on_corners)
    own = measured.covariance - measured.common @ np.swapaxes(measured.common, 1, 2)
    source = "images" if collected is not None else "corners.csv"
    found = pair_commands_with_measured_poses(
        recording, measured.frames, measured.T_base_platform, own, measured.common
    )
    for stage, below in measured.stages.items():
        alone = below.covariance - below.common @ np.swapaxes(below.common, 1, 2)
        found = add_chain_stage_measurements(found, stage, below.frames, below.T_base_platform, alone, below.common)
    return Sampled(
        samples_of_movable_coordinates(found, recording.design.mechanism),
        source,
        measured,
        collected,
        instrument=CAMERAS if has_links(recording.design.mechanism) else None,
    )


def _sample_hands(recording: Recording, free: tuple[str, ...], progress: Progress | None) -> Sampled:
    """Sampled of cameras that see targets of an arm's several hands: each hand's measured by themselves, all together.

    What poses of one hand share, as the places of cameras, is a draw of its own for each hand. A hand that is not
    measured is named in the source, with the reason. Raises NotEnoughData where no hand is measured
    """
    names = hand_names(recording.design.mechanism)
    found, missing = dict[str, Sampled](), dict[str, str]()
    for name in names:
        if name not in hands_with_seen_targets(recording, recording.corners):
            stated = name in hands_with_seen_targets(recording, None)
            missing[name] = "none of its markers is seen" if stated else "it has no target"
            continue
        try:
            found[name] = sample_recording(select_hand(recording, name), free, progress)
        except NotEnoughData as error:
            missing[name] = str(error)
    unmeasured = "; ".join(f"{name} was not measured: {reason}" for name, reason in missing.items())
    if not found:
        raise NotEnoughData(f"{recording.folder}: {unmeasured}")
    return _joined_hands(recording, found, f" of {', '.join(found)} ({unmeasured})" if missing else "")


def _joined_hands(recording: Recording, measured: dict[str, Sampled], which: str) -> Sampled:
    """Sampled of all hands that are measured. measured : by the hand's name; which : hands, for the source"""
    names, parts = hand_names(recording.design.mechanism), list(measured.values())
    count = [0, *np.cumsum([part.samples.common.shape[2] for part in parts]).tolist()]
    common = [
        np.pad(part.samples.common, ((0, 0), (0, 0), (before, count[-1] - after)))
        for part, before, after in zip(parts, count, count[1:])
    ]
    frame = np.concatenate([part.samples.frame for part in parts])
    hand = np.concatenate([np.full(len(part.samples), names.index(name)) for name, part in measured.items()])
    order = np.lexsort((hand, frame))
    found = pair_commands_with_measured_poses(
        recording,
        frame[order],
        RigidTransform.concatenate([part.samples.T_base_platform for part in parts])[order],
        np.concatenate([part.samples.covariance for part in parts])[order],
        np.concatenate(common)[order],
    )
    return Sampled(replace(found, hand=hand[order]), parts[0].source + which, None, None, instrument=CAMERAS)


def _from_poses(recording: Recording) -> Samples:
    recording = recording_in_machine_frames(recording)
    assert recording.poses is not None
    poses, instrument, m = recording.poses, recording.design.instrument, recording.design.mechanism
    if instrument is not None and not has_links(m):
        _require_whole_poses(recording, instrument)
    covariance = pose_covariance(poses, instrument, m)
    found = pair_commands_with_measured_poses(recording, poses.frame, poses.T_base_platform, covariance, poses.common)
    found = replace(found, hand=poses.hand)
    for stage, below in recording.stages.items():
        own = pose_covariance(below, instrument, m)
        found = add_chain_stage_measurements(found, stage, below.frame, below.T_base_platform, own, below.common)
    return found


def _require_whole_poses(recording: Recording, instrument: Instrument) -> None:
    """Raise RigError for an instrument whose place is estimated with arms alone, or that measures a part of poses."""
    kind = recording.design.mechanism.kind
    if "free" in (instrument.base, instrument.tool):
        raise RigError(
            f'{recording.folder}: an instrument whose pose is unknown (base or tool "free") is not estimated for a '
            f"mechanism of kind {kind!r}; state its poses in the rig's own frames"
        )
    if instrument.kind != "pose":
        raise RigError(
            f"{recording.folder}: an [instrument] of kind {instrument.kind!r} calibrates arms, not a "
            f"mechanism of kind {kind!r}"
        )
    if instrument.rotation_sigma is None and not has_translation_only_platform(recording.design.mechanism):
        raise RigError(
            f"{recording.folder}: [instrument] states no rotation_sigma, and positions alone calibrate arms, "
            "not a mechanism of "
            f"kind {kind!r}"
        )
