"""Preparation of a run: compilation, cameras and exposures, bench, observation and displays from the arguments."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.files import calibration_file
from calib.online.limb_pose_source import write_withdrawal
from calib.online.measuring_limb_poses import LiveLimbPoses
from calib.online.run_learning import Learner
from rig.arrays import Floats, Pixels
from rig.cli.shared import poses_from_readings
from rig.cli.shared.run_observation import Display, RunObserver, Stopping
from rig.cli.shared.run_page import RunPage
from rig.cli.shared.run_terminal_display import terminal_display
from rig.driving.cameras import CameraError, open_camera
from rig.driving.cameras.grab_and_settling import CLIPPED, Settling, Shutter, set_exposure_for_markers
from rig.driving.clock import Clock
from rig.driving.move_and_record_loop import Bench
from rig.driving.serial_port import Sensing
from rig.driving.straight_move_profile import Way, trapezoidal_profile
from rig.driving.strut_driver import Driver
from rig.errors import RigError
from rig.formats.output_files import write_bytes
from rig.model import mechanisms
from rig.model.design import Camera, Design
from rig.model.mechanism_kinds import has_plates
from vision.corners.marker_detection import detect_markers, grey_images_for_reader_and_fit
from vision.corners.marker_reader import read_markers
from vision.hand_mounted_cameras import has_hand_cameras
from vision.predict import markers_expected_in_image
from vision.reading.live_measurement import Live
from vision.targets import MarkerMap, marker_cells, marker_map

GREY, BLACK, WHITE = 70, 20, 190  # of 255
CELL = 8  # px of a cell before it is drawn as it is seen


def warm_up(design: Design) -> None:
    """Warm up for a run: compile kernels by measuring one drawn image of a hexapod at home, and discard the result."""
    m = design.mechanism
    if not has_plates(m) or not design.cameras or not any(target.body == "platform" for target in design.targets):
        return
    markers, live = marker_map(design), Live(design)
    images = draw_markers(design.cameras, m.home, markers)
    live.take(0, images)
    live.close()
    for camera in design.cameras:
        detect_markers(images[camera.name], camera, markers, T_base_platform=m.home)
    learner, lengths = Learner(m), mechanisms.kinematics_of(m).inverse(m.home, m)
    for _ in range(2):  # the second is held against the first
        learner.learn(lengths, m.home, 1e-10 * np.eye(6))


def draw_markers(cameras: tuple[Camera, ...], T_base_platform: RigidTransform, markers: MarkerMap) -> dict[str, Pixels]:
    """Draw markers as each camera sees them: {camera: (height, width) uint8}, without occlusion."""
    return {camera.name: _picture(camera, T_base_platform, markers) for camera in cameras}


def _picture(camera: Camera, T_base_platform: RigidTransform, markers: MarkerMap) -> Pixels:
    image = np.full((camera.height, camera.width), GREY, np.uint8)
    for row, quad in zip(*markers_expected_in_image(camera, T_base_platform, markers)):
        cells = np.kron(marker_cells(markers.dictionary[row], int(markers.id[row])), np.ones((CELL, CELL)))
        printed = (BLACK + (WHITE - BLACK) * cells).astype(np.uint8)
        low, high = CELL - 0.5, len(cells) - CELL - 0.5  # the marker has a ring of white about it
        square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
        H = cv2.getPerspectiveTransform(square, quad.astype(np.float32))
        seen = cv2.warpPerspective(printed, H, (camera.width, camera.height), flags=cv2.INTER_AREA)
        where = cv2.warpPerspective(np.full_like(printed, 255), H, (camera.width, camera.height))
        image[where > 127] = seen[where > 127]
    return cv2.GaussianBlur(image, (0, 0), 0.7)


FIRST_EXPOSURE = 0.01  # s that the first exposure takes where it is looked for
COMPRESSION = 1  # of the PNG files


def open_cameras(design: Design, clock: Clock) -> Shutter:
    """Open all cameras of a design. Raises CameraError where one has no source or does not open; the others close."""
    opened = []
    try:
        for camera in design.cameras:
            opened.append(open_camera(camera, clock))
    except RigError:
        for source in opened:
            source.close()
        raise
    return Shutter(tuple(opened), clock)


def open_bench(design: Design, driver: Driver, shutter: Shutter, settling: Settling, clock: Clock) -> Bench:
    """Open the Bench of a run, with its sensors if any. Raises RigError for settling by limbs that nobody reads."""
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
        _move_time_profile(design),
        save_image,
        sensing.read if sensing else None,
        sensing.limbs if sensing else None,
    )


def _move_time_profile(design: Design) -> Callable[[Floats, Floats, float, float], Way]:
    """How a move goes in time: (start, goal (axes,) m, begun, ended s) -> Way, by the controller's stated speeds and
    accelerations.
    """
    c = design.driver()

    def way(start: Floats, goal: Floats, begun: float, ended: float) -> Way:
        travel = np.abs(goal - start)
        cruise = float((travel / c.max_speed).max())
        if not travel.any():
            return ()
        ramp = None if c.max_acceleration is None else float((travel / c.max_acceleration).max() / cruise)
        return trapezoidal_profile(begun, ended, cruise, ramp)

    return way


def save_image(path: Path, image: Pixels) -> None:
    """Save an image as PNG, complete before this returns. Raises FileError where the disk is full."""
    data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION])[1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path.parent} cannot be made: {error.strerror}") from None
    write_bytes(path, data.tobytes())


def set_exposures(shutter: Shutter, design: Design, stated: float | None) -> list[str]:
    """Set exposures of all cameras, s (None: bright markers without clipping); returns lines of a report."""
    said, markers = [], marker_map(design)
    for source in shutter.sources:
        if not source.can_set_exposure:
            said.append(f"camera {source.name!r} sets its exposure itself")
        elif stated is not None:
            said.append(f"camera {source.name!r}: exposure {source.set_exposure(stated) * 1e3:.3g} ms")
        else:
            exposure, level = set_exposure_for_markers(
                source, partial(_marker_white_level, camera=design.camera(source.name), markers=markers), FIRST_EXPOSURE
            )
            said.append(
                f"camera {source.name!r}: exposure {exposure * 1e3:.3g} ms, markers' white at {level:.0f} of 255"
            )
    return said


def _marker_white_level(image: Pixels, camera: Camera, markers: MarkerMap) -> tuple[float, float]:
    """(level of white, of 255; share that clips) of the markers in an image; of the whole image where none is read.

    Raises CameraError for an image of another size.
    """
    eight, full = grey_images_for_reader_and_fit(image)
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


if TYPE_CHECKING:
    import numpy as np

    from rig.driving.clock import Clock
    from rig.driving.run_steps_and_progress import Step
    from rig.model.design import Design

SHARED_DRAWS = 42  # draws that all poses by limbs have in common: their geometry


def run_observer_of_arguments(
    arguments: Namespace, design: Design, planned: tuple[Step, ...], start: Floats, clock: Clock, stopping: Stopping
) -> RunObserver:
    """Run observer that the arguments request, by accepted limbs where they are named. start : (axes,) m.

    Raises RigError for a calibration of another kind of machine, and for limbs that do not stand for vision.
    """
    every = poses_from_readings.vision_check_interval(arguments)
    accepted = poses_from_readings.accepted_limbs_for_run(arguments, design) if arguments.limbs is not None else None
    calibration = calibration_file.load(arguments.calibration) if arguments.calibration else None
    if calibration is not None:
        calibration.refuse_physics("watching a run")
    if calibration is not None and calibration.correction.nominal.kind != design.mechanism.kind:
        raise RigError(
            f"{arguments.calibration} is of a mechanism of kind {calibration.correction.nominal.kind!r}, the rig's is "
            f"{design.mechanism.kind!r}"
        )
    measured = not arguments.no_measure and (
        has_hand_cameras(design) or any(target.body == "platform" for target in design.targets)
    )
    learner = None
    if measured and has_plates(design.mechanism):
        learner = Learner(
            design.mechanism,
            calibration,
            tuple(arguments.tolerance) if arguments.tolerance else None,
            0 if accepted is None else SHARED_DRAWS,
        )
    looking = RunObserver(design, planned, start, clock, Live(design) if measured else None, learner, stopping)
    if accepted is not None:
        looking.source = LiveLimbPoses(accepted, every)
        looking.withdraw = partial(_withdraw, arguments)
    return looking


def _withdraw(arguments: Namespace, source: LiveLimbPoses, frame: int, reason: str) -> None:
    write_withdrawal(arguments.limbs, source.accepted, str(arguments.out), frame, reason)


@contextmanager
def run_displays(arguments: Namespace, observer: RunObserver) -> Iterator[list[Display]]:
    """Displays of a run that the arguments request: terminal, and the page, served while the context lasts."""
    if arguments.page is None:
        yield [terminal_display()]
        return
    with RunPage(observer, arguments.page) as page:
        print(f"the run's page, for this computer alone: {page.url}", flush=True)
        yield [terminal_display(), page]
