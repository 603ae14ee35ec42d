"""Combination of recordings, and moved cameras.

Of one rig; each is measured alone first to find the cameras that were moved.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.design_contradictions_and_cube_quarter_turns import WORDS
from rig.model.pose import log
from rig.recording.combined_recordings import (
    Owners,
    combined_camera_name,
    first_recording_by_camera,
    is_measured_by_instrument,
    join_recordings,
    last_remount_recording_by_target,
    require_one_rig,
    sensor_channels_missing_in_some_recordings,
)
from rig.recording.frame_selection_and_content_hashes import (
    content_hashes_of_frames,
    frames_with_known_hashes,
    sorted_hashes_of_frames,
)
from rig.recording.recording_folder import Recording
from vision.recording_adjustment_with_hand_and_stages import Measurement
from vision.recording_measurement import measure_recording

# probability, over all cameras together, with which cameras that stand still are taken for moved: which costs little
ALIKE = 1e-3
HELD = 1e-12  # m, rad; standard deviation of what a datum holds, and rounding lets stray
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """A camera of a recording (its number, from 0) that stands elsewhere than before, by how far (m, rad).
    NaN where it is another camera by what its rig.toml states."""

    recording: int
    camera: str
    distance: float
    angle: float


@dataclass(frozen=True, slots=True, eq=False)
class CombinedRecordings:
    """recording : one Recording of all; owners : Owners; moved : (Elsewhere, ..); dropped : channels that not all of
    them logged
    """

    recording: Recording
    owners: Owners
    moved: tuple[Elsewhere, ...]
    dropped: tuple[str, ...]

    def lines(self) -> list[str]:
        """What is shared and what is each one's own, in words."""
        parts = self.recording.parts
        first, *rest = (
            f"{part.recording.name} ({len(part.recording.exposures.times()[0])} frames"
            + (f", counted from {part.frames} on)" if k else ")")
            for k, part in enumerate(parts)
        )
        out = [f"{len(parts)} recordings of one rig: {', '.join([first, *rest])}"]
        alone = sorted({c for own in self.owners for c in own} - {m.camera for m in self.moved})
        out.append(
            "shared: the machine"
            + (", the targets" if self.recording.design.targets else "")
            + (
                f", where camera{'s' * (len(alone) > 1)} {', '.join(alone)} stand{'s' * (len(alone) == 1)}"
                if alone
                else ""
            )
            + "; separate: poses, history of moves, start of clock and warming up, log"
        )
        for m in self.moved:
            now = combined_camera_name(m.camera, self.owners[m.recording])
            how = (
                "is stated differently"
                if np.isnan(m.distance)
                else f"stands elsewhere, by {m.distance * 1e3:.3g} mm and {m.angle * 1e3:.3g} mrad"
            )
            out.append(f"camera {m.camera} {how} in {parts[m.recording].recording.name}: it is camera {now} here")
        for k, seats in enumerate(last_remount_recording_by_target([part.recording.design for part in parts])):
            for target in parts[k].recording.design.targets:
                if target.turned is not None and seats[target.name] == k:
                    out.append(
                        f"cube {target.name} was put back {WORDS[target.turned]} for "
                        f"{parts[k].recording.name}: it is target "
                        f"{combined_camera_name(target.name, seats)} here, with a separate pose"
                    )
        return out + ([f"not tested, since not all logged them: {', '.join(self.dropped)}"] if self.dropped else [])


def combine_recordings(recordings: Sequence[Recording], progress: Progress | None = None) -> CombinedRecordings:
    """CombinedRecordings of several recordings.

    They are of one rig, in chronological order.
    progress : called with (label, done, of), or None

    Raises RigError naming what their rig.toml contradict each other in, and what measuring raises
    """
    require_one_rig_without_repeated_frames(recordings)
    owners = first_recording_by_camera(recordings)
    moved = [
        Elsewhere(k, name, np.nan, np.nan)
        for k, own in enumerate(owners)
        for name, j in own.items()
        if j == k and any(name in earlier for earlier in owners[:k])
    ]
    if not is_measured_by_instrument(recordings[0]):
        measured = [
            measure_recording(r, progress=None if progress is None else _of(progress, k, len(recordings)))[0]
            for k, r in enumerate(recordings)
        ]
        owners, found = _standing(owners, measured)
        moved += found
        if any(
            any(own.values()) for own in last_remount_recording_by_target([r.design for r in recordings])
        ):  # whose prints are read under one identity, and are two targets
            recordings = [
                r if r.corners is not None else replace(r, corners=m.corners()) for r, m in zip(recordings, measured)
            ]
    return CombinedRecordings(
        join_recordings(recordings, owners),
        owners,
        tuple(moved),
        tuple(sensor_channels_missing_in_some_recordings(recordings)),
    )


def require_one_rig_without_repeated_frames(recordings: Sequence[Recording]) -> None:
    """Raise RigError unless recordings are of one rig, and no frame of one is in another.

    Names what differs; data in two recordings would count twice.
    """
    require_one_rig(recordings)
    known: set[str] = set()
    for recording in recordings:
        of = content_hashes_of_frames(recording)
        twice = frames_with_known_hashes(of, known)
        if twice:
            raise RigError(
                f"{recording.folder}: {len(twice)} of {len(of)} frames are in another of the recordings; "
                "the same pose does not count twice"
            )
        known |= set(sorted_hashes_of_frames(of))


def _of(progress: Progress, number: int, count: int) -> Progress:
    return lambda label, done, of: progress(f"recording {number + 1} of {count} alone: {label}", done, of)


def _standing(owners: Owners, measured: Sequence[Measurement]) -> tuple[Owners, list[Elsewhere]]:
    """(Owners, [Elsewhere]) by where each measurement finds its cameras: one that stands where it stood is the latest
    of those there.
    """
    count = sum(len(own) for own in owners[1:])
    out: list[dict[str, int]] = [dict(owners[0])]
    moved, places = [], [_places(one) for one in measured]
    for k in range(1, len(owners)):
        here = dict(owners[k])
        for name, stated in owners[k].items():
            at = places[k].get(name)
            if stated == k or at is None:
                continue
            earlier = sorted({o[name] for o in out if name in o and o[name] >= stated}, reverse=True)
            apart = [(j, *_apart(places[j][name], at)) for j in earlier if name in places[j]]
            same = next((j for j, _, p in apart if p * count > ALIKE), None)
            if same is None and apart:
                here[name] = k
                _, motion, _ = apart[0]
                moved.append(Elsewhere(k, name, float(np.linalg.norm(motion[:3])), float(np.linalg.norm(motion[3:]))))
            elif same is not None:
                here[name] = same
        out.append(here)
    return tuple(out), moved


def _places(measured: Measurement) -> dict[str, tuple[RigidTransform, Floats]]:
    """{camera: (pose, (6, 6) covariance, tangent on the right)} of the cameras that stand still."""
    a, covariance = measured.adjustment, measured.adjustment.shared_covariance
    return {
        a.state.cameras[i].name: (a.state.cameras[i].pose, covariance[part, part])
        for i, part in a.unknowns.poses.items()
    }


def _apart(one: tuple[RigidTransform, Floats], other: tuple[RigidTransform, Floats]) -> tuple[Floats, float]:
    """((6,) motion from one place to the other, probability of as much by chance), in the directions that no datum
    holds: a camera alone in a hand, whose stated place holds the hand's frame, stands where it stood."""
    motion = log(one[0].inv() * other[0])
    values, vectors = np.linalg.eigh(one[1] + other[1])
    free = values > HELD**2
    if not free.any():
        return motion, 1.0
    return motion, float(scipy.special.chdtrc(free.sum(), ((vectors[:, free].T @ motion) ** 2 / values[free]).sum()))
