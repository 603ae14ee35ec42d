"""Combined recordings of one rig.

One timeline, moved cameras and remounted cubes as separate ones.

What the machine is stays shared. Each recording keeps its own poses, its log and its own beginning: effects that
remember (a play's side, a lag, how long it has been warm, how far a clock has run) know nothing of the recording
before.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Integers
from rig.errors import RigError
from rig.formats import local_and_remote_input_files
from rig.model.design import Camera, Design, Target
from rig.model.design_contradictions_and_cube_quarter_turns import design_contradictions, is_same_lens_sensor_and_mount
from rig.recording.corner_and_pose_csv_tables import Corners, Poses
from rig.recording.exposures_and_image_files import Exposures
from rig.recording.recording_folder import PAYLOAD, Commands, Recording, RecordingPart, Sensors

GAP = 60.0  # s on the common timeline between the end of a recording and the next one's beginning
HELD = 30.0  # s of it for which the axes are where the next recording begins
Owners = tuple[
    dict[str, int], ...
]  # of each recording: {camera, or target: number (from 0) of the recording in which it came to stand there}


def require_one_rig(recordings: Sequence[Recording]) -> None:
    """Raise RigError unless all recordings are of one rig.

    And of one kind of data.
    """
    first = recordings[0]
    seen: set[str] = set()
    for recording in recordings:
        place = str(local_and_remote_input_files.absolute_path(recording.folder))
        if place in seen:
            raise RigError(f"{recording.folder} is named twice; the same poses do not count twice")
        seen.add(place)
        found = design_contradictions(first.design, recording.design)
        if found:
            raise RigError(
                f"{recording.folder} is not of the rig of {first.folder}, as their rig.toml state it; these differ:\n"
                + "\n".join(f"  {text}" for text in found)
            )
        if (recording.commands is None) != (first.commands is None):
            lacks = recording if recording.commands is None else first
            raise RigError(
                f"{lacks.folder} has no commands.csv, and the other has: without commands nothing of "
                "the machine can be shared"
            )
        if _data(recording) != _data(first):
            raise RigError(
                f"{first.folder} has {_data(first)} and {recording.folder} {_data(recording)}: let rig "
                "measure process both alike"
            )


def first_recording_by_camera(recordings: Sequence[Recording]) -> Owners:
    """First recording that has each camera as it is, by camera.

    It is a new one where lens or mount differs.
    """
    out: list[dict[str, int]] = []
    for k, recording in enumerate(recordings):
        out.append(
            {
                c.name: next((j for j in range(k) if _is(recordings[j], c, out[j], j)), k)
                for c in recording.design.cameras
            }
        )
    return tuple(out)


def _is(recording: Recording, camera: Camera, owners: dict[str, int], number: int) -> bool:
    """Whether a camera of a recording (its number) came to stand there in it, and is stated like this one."""
    return owners.get(camera.name) == number and is_same_lens_sensor_and_mount(
        recording.design.camera(camera.name), camera
    )


def join_recordings(recordings: Sequence[Recording], owners: Owners) -> Recording:
    """Join recordings into one Recording.

    They are its `parts`.
    Frames of the k-th (from 0) count on from k times a power of ten, its cameras and cubes with a place of their own
    are called "NAME@k+1"
    Raises RigError as `require_one_rig`
    """
    require_one_rig(recordings)
    first, parts, end = recordings[0], [], 0.0
    step = 10 ** len(str(max(int(r.exposures.frame.max()) for r in recordings)))
    for k, recording in enumerate(recordings):
        low, high = _span(recording)
        parts.append(RecordingPart(recording, k * step, end + GAP - low if k else 0.0))
        end = parts[-1].t + high
    cameras: dict[str, Camera] = {}
    for recording, own in zip(recordings, owners):
        for camera in recording.design.cameras:
            name = combined_camera_name(camera.name, own)
            cameras.setdefault(name, replace(camera, name=name))
    seats = last_remount_recording_by_target([recording.design for recording in recordings])
    design = replace(first.design, cameras=tuple(cameras.values()), targets=_targets(recordings, seats))
    skipped = tuple(one for r in recordings for one in r.skipped)
    return replace(
        first,
        design=design,
        commands=_commands(parts),
        exposures=_exposures(parts, owners),
        sensors=_sensors(parts),
        corners=_corners(parts, owners, seats),
        poses=_poses(parts, None),
        skipped=skipped,
        parts=tuple(parts),
        stages={k: poses for k in first.stages if (poses := _poses(parts, k)) is not None},
    )


def combined_camera_name(camera: str, owners: dict[str, int]) -> str:
    """Name of a camera among the combined recordings.

    NAME or NAME@k.
    owners : of its recording.
    """
    return camera if owners[camera] == 0 else f"{camera}@{owners[camera] + 1}"


def is_measured_by_instrument(recording: Recording) -> bool:
    """Whether a recording is measured by an instrument.

    By poses of an outside one.
    """
    return recording.poses is not None and (
        recording.design.instrument is not None or (recording.corners is None and not recording.has_images)
    )


def _data(recording: Recording) -> str:
    """What measures a recording, in words."""
    if is_measured_by_instrument(recording):
        return "poses of an instrument"
    if recording.corners is not None:
        return "corners" if recording.corners.covariance is None else "corners with their covariance"
    return "images"


def _span(recording: Recording) -> tuple[float, float]:
    """(s, s) from the earliest to the latest that a recording tells."""
    parts = [
        recording.exposures.t,
        *([recording.commands.t] if recording.commands is not None else []),
        *([recording.sensors.t] if recording.sensors is not None else []),
    ]
    return float(min(t.min() for t in parts)), float(max(t.max() for t in parts))


def _commands(parts: Sequence[RecordingPart]) -> Commands | None:
    t, values, starts = [], [], []
    for k, part in enumerate(parts):
        own = part.recording.commands
        if own is None:
            return None
        if k:
            t.append(
                np.array([part.t + own.t[0] - HELD])
            )  # an exposure told too early by the clock finds the axes where they begin
            values.append(own.values[:1])
            starts.append(part.t + own.t[0])
        t.append(part.t + own.t)
        values.append(own.values)
    return Commands(np.concatenate(t), np.concatenate(values), np.array(starts))


def _exposures(parts: Sequence[RecordingPart], owners: Owners) -> Exposures:
    seen = [(part, part.recording.exposures) for part in parts]
    return Exposures(
        np.concatenate([part.frames + e.frame for part, e in seen]),
        np.concatenate([part.t + e.t for part, e in seen]),
        [combined_camera_name(name, own) if name else "" for (_, e), own in zip(seen, owners) for name in e.camera],
        [
            str(local_and_remote_input_files.absolute_path(part.recording.folder) / name) if name else ""
            for part, e in seen
            for name in e.image
        ],
    )


def last_remount_recording_by_target(designs: Sequence[Design]) -> Owners:
    """Recording in which each target was last remounted, by target.

    It is the first recording for a target that was never remounted.
    """
    out: list[dict[str, int]] = []
    for k, design in enumerate(designs):
        own = {}
        for target in design.targets:
            before = None if not k else next(t.turned for t in designs[k - 1].targets if t.name == target.name)
            own[target.name] = (
                0 if target.turned is None or not k else out[-1][target.name] if target.turned == before else k
            )
        out.append(own)
    return tuple(out)


def _targets(recordings: Sequence[Recording], seats: Owners) -> tuple[Target, ...]:
    """The targets of all, a cube that was put back as another whose identities are shifted."""
    step, out = _shift(recordings), dict[str, Target]()
    for recording, own in zip(recordings, seats):
        for target in recording.design.targets:
            name = combined_camera_name(target.name, own)
            out.setdefault(name, replace(target, name=name, shift=step * own[target.name]))
    return tuple(out.values())


def _shift(recordings: Sequence[Recording]) -> int:
    """A power of ten above all identities."""
    return 10 ** len(str(max((i for target in recordings[0].design.targets for i in target.ids), default=0)))


def _corners(parts: Sequence[RecordingPart], owners: Owners, seats: Owners) -> Corners | None:
    found = [(part, part.recording.corners, own) for part, own in zip(parts, owners)]
    seen = [(part, c, own) for part, c, own in found if c is not None]
    if len(seen) < len(found):
        return None
    covariance = [c.covariance for _, c, _ in seen if c.covariance is not None]
    return Corners(
        np.concatenate([part.frames + c.frame for part, c, _ in seen]),
        [combined_camera_name(name, own) for _, c, own in seen for name in c.camera],
        np.concatenate([_keys(c.marker, part, seat, parts) for (part, c, _), seat in zip(seen, seats)]),
        np.concatenate([c.corner for _, c, _ in seen]),
        np.concatenate([c.uv for _, c, _ in seen]),
        np.concatenate(covariance) if len(covariance) == len(seen) else None,
    )


def _keys(markers: Integers, part: RecordingPart, seat: dict[str, int], parts: Sequence[RecordingPart]) -> Integers:
    """(n,) of identities (n,), shifted where their cube was put back in a later recording than the first."""
    step, out = _shift([p.recording for p in parts]), markers.copy()
    for target in part.recording.design.targets:
        if seat[target.name]:
            out[np.isin(markers, target.ids)] += step * seat[target.name]
    return out


def _poses(parts: Sequence[RecordingPart], stage: int | None) -> Poses | None:
    """Poses of all, of the platform or of a chain's stage below it (its number), or None where one has none."""
    found = [(part, part.recording.poses if stage is None else part.recording.stages.get(stage)) for part in parts]
    seen = [(part, p) for part, p in found if p is not None]
    covariance = [p.covariance for _, p in seen if p.covariance is not None]
    if len(seen) < len(found):
        return None
    if 0 < len(covariance) < len(seen):
        lacks = next(part for part, p in seen if p.covariance is None)
        name = "poses.csv" if stage is None else f"poses_stage{stage}.csv"
        raise RigError(f"{lacks.recording.folder / name} states no covariance, and another recording's does")
    hands = [p.hand for _, p in seen if p.hand is not None]
    return Poses(
        np.concatenate([part.frames + p.frame for part, p in seen]),
        RigidTransform.concatenate([p.T_base_platform for _, p in seen]),
        np.concatenate(covariance) if covariance else None,
        hand=np.concatenate(hands) if hands else None,
    )


def sensor_channels_missing_in_some_recordings(recordings: Sequence[Recording]) -> list[str]:
    """Sensor channels that are missing in some recordings.

    They are dropped.
    """
    own = [set(r.sensors.channels) if r.sensors is not None else set() for r in recordings]
    return sorted(name for name in set[str]().union(*own) - {PAYLOAD} if any(name not in one for one in own))


def _sensors(parts: Sequence[RecordingPart]) -> Sensors | None:
    """The logs one after the other, of the channels that all have."""
    recordings = [part.recording for part in parts]
    lost = sensor_channels_missing_in_some_recordings(recordings)
    names = [
        n
        for n in dict.fromkeys(n for r in recordings if r.sensors is not None for n in r.sensors.channels)
        if n not in lost
    ]
    if not names:
        return None
    t, values, starts = [], [], []
    for part in parts:
        log = part.recording.sensors or Sensors(part.recording.exposures.times()[1][:1], {PAYLOAD: np.zeros(1)})
        low, high = _span(part.recording)
        own = (
            np.union1d(log.t, [low, high]) if log.t[0] > low or log.t[-1] < high else log.t
        )  # the nearest row stands beyond a log
        starts.append(part.t + own[0])
        t.append(part.t + own)
        values.append(
            [np.interp(own, log.t, log.channels[n]) if n in log.channels else np.zeros(len(own)) for n in names]
        )
    return Sensors(
        np.concatenate(t),
        {n: np.concatenate([v[k] for v in values]) for k, n in enumerate(names)},
        np.array(starts[1:]),
    )
