"""What a run works with, from a rig.toml: cameras opened and exposed well, sensors, how images are put on disk, how a
move goes in time.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from rig.driving.cameras import CameraError, open_source
from rig.driving.cameras.camera_synchronisation import Shutter
from rig.driving.cameras.exposure_setting import CLIPPED, set_exposure_for_markers
from rig.driving.cameras.settling_check import Settling
from rig.driving.clock import Clock
from rig.driving.driver import Driver
from rig.driving.operator_loop import Bench
from rig.driving.sensor_port import Sensing
from rig.driving.trapezoidal_profile import Way, trapezoidal_profile
from rig.errors import RigError
from rig.formats.output_files import write_bytes
from rig.model.design import Camera, Design
from vision.corners.marker_detection import grey_image
from vision.corners.marker_reader import read_markers
from vision.targets import MarkerMap, marker_map

START = 0.01  # s that the first exposure takes where it is looked for
COMPRESSION = 1  # of the PNG files


def open_cameras(design: Design, clock: Clock) -> Shutter:
    """All cameras of a design, open. Raises CameraError for one that states no source or does not open; the others are
    closed then.
    """
    opened = []
    try:
        for camera in design.cameras:
            opened.append(open_source(camera, clock))
    except RigError:
        for source in opened:
            source.close()
        raise
    return Shutter(tuple(opened), clock)


def run_equipment(design: Design, driver: Driver, shutter: Shutter, settling: Settling, clock: Clock) -> Bench:
    """The Bench of a design, its sensors opened where it states any. Raises RigError for settling by limbs that nobody
    reads.
    """
    sensing = Sensing(design.sensors, clock) if design.sensors else None
    channels = set(design.sensors.channels) if design.sensors else set()
    if settling.by == "limbs" and not {f"m{i + 1}" for i in range(6)} <= channels:
        raise RigError("settling by limbs takes a [sensors] table with the channels m1 .. m6")
    return Bench(
        driver,
        shutter,
        clock,
        settling,
        design.driver().tolerance,
        move_time_profile(design),
        save_image,
        sensing.read if sensing else None,
        sensing.limbs if sensing else None,
    )


def move_time_profile(design: Design) -> Callable[[np.ndarray, np.ndarray, float, float], Way]:
    """How a move goes in time: (start, goal (axes,) m, begun, ended s) -> Way, by the controller's stated speeds and
    accelerations.
    """
    c = design.driver()

    def way(start: np.ndarray, goal: np.ndarray, begun: float, ended: float) -> Way:
        travel = np.abs(goal - start)
        cruise = float((travel / c.max_speed).max())
        if not travel.any():
            return ()
        ramp = None if c.max_acceleration is None else float((travel / c.max_acceleration).max() / cruise)
        return trapezoidal_profile(begun, ended, cruise, ramp)

    return way


def save_image(path: Path, image: np.ndarray) -> None:
    """Put an image on disk, whole, before this returns. Raises FileError where the disk takes no more."""
    data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION])[1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path.parent} cannot be made: {error.strerror}") from None
    write_bytes(path, data.tobytes())


def set_exposures(shutter: Shutter, design: Design, stated: float | None) -> list[str]:
    """Set every camera's exposure (s; None: so that markers are bright and do not clip); what there is to say of it."""
    said, markers = [], marker_map(design)
    for source in shutter.sources:
        if not source.can_set_exposure:
            said.append(f"camera {source.name!r} sets its exposure itself")
        elif stated is not None:
            said.append(f"camera {source.name!r}: exposure {source.set_exposure(stated) * 1e3:.3g} ms")
        else:
            exposure, level = set_exposure_for_markers(
                source, partial(marker_white_level, camera=design.camera(source.name), markers=markers), START
            )
            said.append(
                f"camera {source.name!r}: exposure {exposure * 1e3:.3g} ms, markers' white at {level:.0f} of 255"
            )
    return said


def marker_white_level(image: np.ndarray, camera: Camera, markers: MarkerMap) -> tuple[float, float]:
    """(level of white, of 255; share that clips) of the markers in an image; of the whole image where none is read.

    Raises CameraError for an image of another size.
    """
    eight, full = grey_image(image)
    if full.shape != (camera.height, camera.width):
        raise CameraError(
            f"camera {camera.name!r} gives {full.shape[1]} x {full.shape[0]} px, but rig.toml has "
            f"{camera.width} x {camera.height} px"
        )
    quads = read_markers(eight, markers).corners
    boxes = [
        full[max(int(low[1]), 0) : int(high[1]) + 1, max(int(low[0]), 0) : int(high[0]) + 1]
        for low, high in zip(quads.min(axis=1), quads.max(axis=1))
    ] or [full]
    bright = [np.percentile(box, 90) for box in boxes if box.size]
    return float(np.percentile(bright, 90)), float(np.mean([(box >= CLIPPED).mean() for box in boxes if box.size]))
