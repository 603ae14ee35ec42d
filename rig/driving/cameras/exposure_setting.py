"""An exposure at which the markers' white is bright and does not clip."""

from collections.abc import Callable

import numpy as np

from rig.driving.cameras.camera_interface import CameraError, Source

WHITE = 200.0  # of 255, where the markers' white is brought to
WHITE_SLACK = 0.1  # share of that which is off without harm
CLIPPED = 250.0  # of 255; brighter than this may be anything
CLIPS = 0.005  # share of the markers' pixels that may be brighter
STEPS = 8  # of setting and looking
RANGE = (1e-5, 1.0)  # s


def set_exposure_for_markers(
    source: Source, white: Callable[[np.ndarray], tuple[float, float]], start: float
) -> tuple[float, float]:
    """Set a camera's exposure so that markers do not clip; returns (exposure s, level of white of 255).

    white : (image) -> (level of the markers' white, of 255; share of their pixels that clip); start : s
    Raises CameraError where no exposure does it.
    """
    exposure = source.set_exposure(start)
    low, high = RANGE
    for _ in range(STEPS):
        level, clips = white(source.grab().image)
        bright = clips > CLIPS or level >= CLIPPED
        if not bright and abs(level - WHITE) <= WHITE_SLACK * WHITE:
            return exposure, level
        if bright:
            high = exposure
        elif level < WHITE:
            low = exposure
        wanted = exposure / 2 if bright else exposure * WHITE / max(level, 1.0)
        if not low < wanted < high:
            wanted = (low * high) ** 0.5
        before, exposure = exposure, source.set_exposure(wanted)
        if exposure == before:
            break
    if not bright and level > WHITE / 4:
        return exposure, level  # as good as this camera's steps allow
    raise CameraError(
        f"camera {source.name!r}: no exposure found at which markers are bright and do not clip; at "
        f"{exposure * 1e3:.3g} ms white is "
        f"at {level:.0f} of 255 and {clips:.1%} clip: change the light or the aperture"
    )
