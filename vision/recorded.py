"""A recording -> its measurement, from whichever it has: corners as they stand, or images, read and looked at again."""

import numpy as np

from rig.errors import NotEnoughData
from vision.collect import collect, image_reader, look_again
from vision.identity import LOOKED_AT, why_none
from vision.measure import measure
from vision.observations import from_corners
from vision.targets import marker_map


def measure_recording(recording, free=("poses", "lenses"), detect_anew=False, progress=None):
    """(Measurement, Collected or None) of a recording.

    free : what is adjusted, see vision.adjust; detect_anew : read the images even where corners.csv is there
    progress : called with (label, done, of), or None
    Raises NotEnoughData for a recording with neither corners nor images, and what reading and measuring raise
    """
    design = recording.design
    if not design.cameras or not design.targets:
        raise NotEnoughData(f"{recording.folder}: rig.toml has {len(design.cameras)} cameras and {len(design.targets)} targets; "
                            "measuring takes at least one of each")
    if not any(target.body == "platform" for target in design.targets):
        raise NotEnoughData(f"{recording.folder}: rig.toml has no target on the platform, so its pose cannot be seen")
    frames, _ = recording.exposures.times()
    markers = marker_map(design)

    def said(label):
        return (lambda done, of: progress(label, done, of)) if progress else None

    if recording.corners is not None and not detect_anew:
        observed = from_corners(recording.corners, frames, design, markers)
        return measure(observed, design, markers, free, said("locating")), None
    if not recording.has_images:
        raise NotEnoughData(f"{recording.folder}: frames.csv names no images and there is no corners.csv, so there is nothing to measure")
    found = collect(recording, markers, said("reading images"))
    if not len(found.corners.frame):
        raise NotEnoughData(f"{recording.folder}: no marker of rig.toml was found in any of {_why_none(recording, found, markers)}")
    measured = measure(from_corners(found.corners, frames, design, markers), design, markers, free, said("locating"))
    again = look_again(recording, found, measured, markers, said("looking again"))
    if len(again.corners.frame) > len(found.corners.frame):
        found = again
        measured = measure(from_corners(found.corners, frames, design, markers), design, markers, free, said("locating"))
    return measured, found


def _why_none(recording, found, markers):
    """How many images there are, and what some of them show instead of the rig's markers."""
    e = recording.exposures
    images = [(frame, camera) for frame, camera, name in zip(e.frame, e.camera, e.image) if name]
    if found.left_out:
        return f"{len(images)} images that could be placed: " + "; ".join(sorted({reason for *_, reason in found.left_out})[:5])
    read, some = image_reader(recording), {round(k) for k in np.linspace(0, len(images) - 1, min(2 * LOOKED_AT, len(images)))}
    why = why_none([read(*images[k]) for k in sorted(some)], markers)
    return f"{len(images)} images" + (f"; of {len(some)} that were looked at again, {why}" if why else "")
