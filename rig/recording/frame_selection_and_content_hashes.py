"""Frame selection of a recording, and content hashes.

Selected by numbers; its frames are recognised by hashes.

What one camera saw in one frame is marked by its content: the image file's bytes, the corners found in it (marker,
corner, u, v), or, of an outside instrument, the pose's numbers; what measuring limbs read at it likewise. Neither the
frame's number, nor its time, nor the camera's name, nor the rest of rig.toml is part of a mark: data that are copied,
renumbered, cut short or told by another clock are the same data. What occurs twice within one recording (a black
image, a pose told to few digits) tells it from nothing and is no mark.

Marks go on through every step. A folder that `rig measure` made keeps, frame by frame, the marks of what it was
measured from, in its manifest; so the raw recording is known again in what was measured from it, and the other way
round. A calibration and an on-line state keep the marks of all that they were learnt from. Two things hold the same
data where they share a mark: what was measured anew of the same machine differs in every image by its noise, so that
chance does not do that.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from hashlib import sha256
from itertools import compress
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Integers
from rig.compute.worker_processes import worker_count
from rig.errors import FileError, NotEnoughData, RigError
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.output_files.staged_folder_and_manifest import file_sha256_or_empty, load_manifest
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.model.pose import pose_to_vector
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import LIMB, Recording

FRAME = re.compile(r"\s*([0-9]{1,18})(?:\s*-\s*([0-9]{1,18}))?\s*")


def parse_frame_ranges(text: str) -> tuple[tuple[int, int], ...]:
    """Parse frame ranges ((first, last), ..) from a text like 3,7-9.

    Raises RigError for anything else.
    """
    parts = [FRAME.fullmatch(part) for part in text.split(",")]
    if not all(parts):
        raise RigError(f"--mask takes frames, for example 3,7-9, not {short_repr(text)}")
    out = tuple((int(part[1]), int(part[2] or part[1])) for part in parts if part)
    if any(first > last for first, last in out):
        raise RigError(f"--mask {short_repr(text)}: a range runs from small to large")
    return out


def remove_frames(recording: Recording, frame_ranges: str) -> Recording:
    """The Recording with frames removed.

    By ranges like 3,7-9.
    Its commands remain.
    Raises RigError for what is no such list and for what names no frame of the recording, NotEnoughData where no frame
        is left
    """
    frames, gone = recording.exposures.times()[0], []
    for first, last in parse_frame_ranges(frame_ranges):
        own = frames[(frames >= first) & (frames <= last)]
        if not len(own):
            name = f"frame {first}" if first == last else f"frames {first} to {last}"
            raise RigError(f"--mask: {recording.folder} has no {name}; its frames are {frames[0]} to {frames[-1]}")
        gone.append(own)
    out = np.unique(np.concatenate(gone))
    if len(out) == len(frames):
        raise NotEnoughData(f"--mask leaves none of the {len(frames)} frames of {recording.folder}")
    return _without(recording, out)


def select_frames(recording: Recording, frames: Integers) -> Recording:
    """The Recording with only the selected frames (f,).

    Its commands remain.
    Raises NotEnoughData where it has none of them.
    """
    every = recording.exposures.times()[0]
    if not np.isin(every, frames).any():
        raise NotEnoughData(f"{recording.folder} has none of the {len(frames)} frames requested")
    return _without(recording, every[~np.isin(every, frames)])


def select_hand(recording: Recording, hand: str | int) -> Recording:
    """The Recording of one selected hand, by name or number.

    From 0, of an arm with several: its poses alone, the arm seen there.
    Raises RigError for a hand that the arm does not have, and for another machine
    """
    arm, poses, corners = require_arm(recording.design.mechanism).of_hand(hand), recording.poses, recording.corners
    if poses is not None and poses.hand is not None:
        poses = replace(poses.take(poses.hand == arm.hand), hand=None)
    mine = [one for one in recording.design.targets if one.body == "base" or one.stage == arm.hand]
    targets = tuple(one if one.body == "base" else replace(one, body="platform") for one in mine)
    if corners is not None:
        corners = corners.take(np.isin(corners.marker, [number for target in targets for number in target.ids]))
    design = replace(recording.design, mechanism=arm, targets=targets)
    return replace(recording, design=design, poses=poses, corners=corners)


def hands_with_seen_targets(recording: Recording, corners: Corners | None) -> tuple[str, ...]:
    """Names of the hands whose targets are seen.

    Hands of an arm with several that have targets, and of these corners where corners are known.
    """
    bodies = [(one.stage, one.ids) for one in recording.design.targets if one.body != "base"]
    seen = [k for k, ids in bodies if corners is None or np.isin(corners.marker, ids).any()]
    return tuple(name for k, name in enumerate(hand_names(recording.design.mechanism)) if k in seen)


def recording_and_corners_of_first_seen_hand(recording: Recording, corners: Corners) -> tuple[Recording, Corners]:
    """Recording and Corners of the first hand whose target is seen.

    First of an arm's hands; as they are without one.
    """
    names = hands_with_seen_targets(recording, corners)
    if not names:
        return recording, corners
    recording = select_hand(replace(recording, corners=corners), names[0])
    return recording, corners if recording.corners is None else recording.corners


def is_of_several_hands(recording: Recording) -> bool:
    """Whether a recording is of several hands of one arm.

    By poses or by targets.
    """
    names, poses = hand_names(recording.design.mechanism), recording.poses
    seen = any(target.stage for target in recording.design.targets)
    return bool(names) and (seen or (poses is not None and poses.hand is not None))


def require_one_hand_shown(recording: Recording) -> None:
    """Raise RigError for a recording that shows several hands.

    It says how to choose one.
    """
    if is_of_several_hands(recording):
        raise RigError(
            f"{recording.folder} is of several hands ({', '.join(hand_names(recording.design.mechanism))}), and this "
            "is done for one: choose it with --hand NAME where the command has it, or select_hand(recording, NAME)"
        )


def _without(recording: Recording, out: Integers) -> Recording:
    """The Recording without frames (k,)."""
    seen, corners = recording.exposures, recording.corners
    keep = ~np.isin(seen.frame, out)
    seen = replace(
        seen,
        frame=seen.frame[keep],
        t=seen.t[keep],
        camera=list(compress(seen.camera, keep)),
        image=list(compress(seen.image, keep)),
    )
    corners = None if corners is None else corners.take(~np.isin(corners.frame, out))
    poses = None if recording.poses is None else recording.poses.take(~np.isin(recording.poses.frame, out))
    return replace(
        recording,
        exposures=seen,
        corners=corners,
        poses=poses,
        stages={k: own.take(~np.isin(own.frame, out)) for k, own in recording.stages.items()},
    )


LENGTH = 16  # hexadecimal digits of a mark: two of a million alike in one case of 4e7
Marks = dict[int, frozenset[str]]  # of each frame that has any


def content_hashes_of_frames(recording: Recording) -> Marks:
    """Content hashes of a recording's frames.

    And of the data they were measured from.
    Raises FileError for an image that cannot be read.
    """
    if recording.parts:
        return {
            part.frames + frame: own
            for part in recording.parts
            for frame, own in content_hashes_of_frames(part.recording).items()
        }
    with hash_frame_contents_in_background(recording) as marked:
        return marked()


@contextmanager
def hash_frame_contents_in_background(recording: Recording) -> Iterator[Callable[[], Marks]]:
    """Hash the contents of a recording's frames in background threads.

    Returns a function that gives the hashes
    """
    paths = [recording.folder / name for name in recording.exposures.image if name]
    if worker_count() < 2:
        yield lambda: _marks(recording, dict(zip(paths, map(file_sha256_or_empty, paths))))
        return
    pool = ThreadPoolExecutor(worker_count())
    try:
        digests = pool.map(file_sha256_or_empty, paths)
        yield lambda: _marks(recording, dict(zip(paths, digests)))
    finally:
        pool.shutdown(cancel_futures=True)


def _marks(recording: Recording, digests: dict[Path, str]) -> Marks:
    """digests : of the images' files"""
    found = [
        *_images(recording, digests),
        *((frame, mark) for part in (_corners, _poses, _limbs) for frame, mark in part(recording)),
    ]
    often = Counter(mark for _, mark in found)
    out = defaultdict(set)
    for frame, mark in found:
        if often[mark] == 1:
            out[frame].add(mark)
    origin = load_manifest(recording.folder).origin
    for line in origin.data if origin is not None else ():
        number, _, mark = line.partition(" ")
        if number.isdigit():
            out[int(number)].add(mark)
    return {frame: frozenset(own) for frame, own in out.items()}


def manifest_lines_of_frame_hashes(hashes: Marks) -> tuple[str, ...]:
    """Lines of a manifest with the hashes of frames.

    "frame hash" each.
    """
    return tuple(f"{frame} {mark}" for frame, own in sorted(hashes.items()) for mark in sorted(own))


def sorted_hashes_of_frames(hashes: Marks, frames: Iterable[int] | None = None) -> list[str]:
    """Sorted hashes of some frames.

    Their union, of all frames by default.
    """
    return sorted(set().union(*(own for frame, own in hashes.items() if frames is None or frame in set(frames))))


def frames_with_known_hashes(hashes: Marks, known_hashes: Collection[str]) -> list[int]:
    """Frames whose hashes are among known hashes."""
    known_hashes = frozenset(known_hashes)
    return sorted(frame for frame, own in hashes.items() if own & known_hashes)


def _images(recording: Recording, digests: dict[Path, str]) -> list[tuple[int, str]]:
    out = []
    for frame, name in zip(recording.exposures.frame.tolist(), recording.exposures.image):
        if name:
            whole = digests[recording.folder / name]
            if not whole:
                raise FileError(recording.folder / name, "cannot be read")
            out.append((frame, whole[:LENGTH]))
    return out


def _corners(recording: Recording) -> list[tuple[int, str]]:
    c = recording.corners
    if c is None:
        return []
    seen = defaultdict(list)
    for frame, camera, marker, corner, (u, v) in zip(
        c.frame.tolist(), c.camera, c.marker.tolist(), c.corner.tolist(), c.uv.tolist()
    ):
        seen[frame, camera].append((marker, corner, f"{u:.5f} {v:.5f}"))
    return [(frame, _mark("corners", sorted(rows))) for (frame, _), rows in seen.items()]


def _poses(recording: Recording) -> list[tuple[int, str]]:
    p = recording.poses
    if p is None:
        return []
    rows = np.atleast_2d(pose_to_vector(p.T_base_platform))
    return [(frame, _mark("pose", [f"{value:.9f}" for value in row])) for frame, row in zip(p.frame.tolist(), rows)]


def _limbs(recording: Recording) -> list[tuple[int, str]]:
    log = recording.sensors
    names = (
        sorted((name for name in log.channels if LIMB.fullmatch(name)), key=lambda name: int(name[1:]))
        if log is not None
        else []
    )
    if log is None or not names:
        return []
    frames, t = recording.exposures.times()
    within = (log.t[0] <= t) & (t <= log.t[-1])
    lengths = np.stack([np.interp(t[within], log.t, log.channels[name]) for name in names], axis=1)
    return [
        (frame, _mark("limbs", [f"{value:.8f}" for value in row]))
        for frame, row in zip(frames[within].tolist(), lengths)
    ]


def _mark(kind: str, content: Sequence[object]) -> str:
    return sha256(repr((kind, content)).encode()).hexdigest()[:LENGTH]
