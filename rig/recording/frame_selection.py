"""Selection of frames of a recording: frames removed or retained by number."""

import re
from dataclasses import replace
from itertools import compress

import numpy as np

from rig.arrays import Integers
from rig.errors import NotEnoughData, RigError
from rig.formats.input_files import short_repr
from rig.recording.corner_and_pose_tables import Poses
from rig.recording.recording_folder import Recording

FRAME = re.compile(r"\s*([0-9]{1,18})(?:\s*-\s*([0-9]{1,18}))?\s*")


def parse_frame_ranges(text: str) -> tuple[tuple[int, int], ...]:
    """Frame ranges ((first, last), ..) parsed from text like 3,7-9. Raises RigError.
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
    """The Recording with frames removed, by ranges like 3,7-9; its commands remain.

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
    """The Recording with only the selected frames (f,); its commands remain.
    Raises NotEnoughData where it has none of them.
    """
    every = recording.exposures.times()[0]
    if not np.isin(every, frames).any():
        raise NotEnoughData(f"{recording.folder} has none of the {len(frames)} frames that are asked for")
    return _without(recording, every[~np.isin(every, frames)])


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
    if corners is not None:
        keep = ~np.isin(corners.frame, out)
        corners = replace(
            corners,
            frame=corners.frame[keep],
            camera=list(compress(corners.camera, keep)),
            marker=corners.marker[keep],
            corner=corners.corner[keep],
            uv=corners.uv[keep],
            covariance=None if corners.covariance is None else corners.covariance[keep],
        )
    poses = None if recording.poses is None else _others(recording.poses, out)
    return replace(
        recording,
        exposures=seen,
        corners=corners,
        poses=poses,
        stages={k: _others(own, out) for k, own in recording.stages.items()},
    )


def _others(poses: Poses, out: Integers) -> Poses:
    """Poses of other frames than these (k,)."""
    keep = ~np.isin(poses.frame, out)
    return replace(
        poses,
        frame=poses.frame[keep],
        T_base_platform=poses.T_base_platform[keep],
        covariance=None if poses.covariance is None else poses.covariance[keep],
    )
