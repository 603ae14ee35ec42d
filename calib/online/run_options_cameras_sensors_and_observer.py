"""Run options, and a run's cameras, sensors and observer.

All are opened: kernels compiled, cameras and their exposures, sensors, observer.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from calib.certification import measuring_limb_calibration_slips_and_vision_agreement
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.online import accepted_measuring_limbs_file
from calib.online.accepted_measuring_limbs_file import Accepted
from calib.online.live_learner_limb_watch_run_state_and_display import Learner
from calib.online.measuring_limb_poses_checked_by_vision import LimbSource, LiveLimbPoses, write_acceptance_withdrawal
from calib.online.observer_of_run_frames import RunObserver, RunStop
from rig.array_and_json_types import Floats
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.driving.axis_display_units_and_controller_counts import axis_milliunit_name
from rig.driving.axis_driver import Driver
from rig.driving.cameras import open_camera
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    SynchronisedCameras,
    set_marker_exposure_and_measure_white,
)
from rig.driving.driver_opening_and_settling import Settling
from rig.driving.driving_clock import Clock
from rig.driving.move_and_record_loop import RunEquipment
from rig.driving.move_profiles_and_path_check import TimedShares, trapezoidal_profile
from rig.driving.readings_entered_by_operator_during_run import ReadingForm, permitted_figure_counts_of_reading
from rig.driving.run_steps_from_plan_and_progress_from_journal import Step
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import open_sensors_of_rig_toml
from rig.errors import RigError
from rig.formats.numbers_and_units import SI, LengthAndAngleUnits
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import axis_units, is_hexapod, require_axes
from rig.recording.corner_and_pose_csv_tables import Corners
from vision.corner_observations_and_merging import observations_from_corners
from vision.corners.marker_detection_and_corner_fit import detect_markers
from vision.marker_corner_prediction import expected_marker_rows_and_corners_in_image, marker_map
from vision.pose.body_pose import FINEST
from vision.pose.frame_and_camera_poses import UndistortedCorners, locate_platform_and_moving_cameras
from vision.reading.live_measurement_and_corner_refit import Live
from vision.reading.parallel_image_map_rendered_markers_and_white_level import (
    marker_white_level_and_clipped_share,
    render_marker_images,
    save_image,
)
from vision.recording_adjustment_with_hand_and_stages import has_hand_cameras

ALARMS = ("jump", "camera", "covered", "unseen", "drift", "limbs")
FIRST_EXPOSURE = 0.01  # s that the first exposure takes where it is searched for
SHARED_DRAWS = 42  # draws that all poses by limbs have in common: their geometry


@dataclass(frozen=True, slots=True, eq=False)
class RunOptions:
    """seed : of the plan; settle : "time:SECONDS", "images", "limbs:LENGTH" or "ask"; exposure : s of all cameras,
    "keep" as they are, None so that markers are bright and do not clip
    calibration : what poses are expected by, or None; calibration_name : of its file, for messages; tolerance : (m,
    rad) of drift from it that is an alarm, or None; stop_on : kinds of ALARMS that end the run
    measure : whether frames are measured; limbs : measuring limbs in place of vision, or None; trust_position : whether
    the position that the controller reads is believed; resume : whether a run is gone on with; trace : file of the
    bytes exchanged with the controller, or None; cameras : whether those of the rig take images; without, or where it
    has none, places are visited for other instruments
    in_motion : m/s of the strut that moves most, at which cameras expose during the moves; None at rest; interval : s
    from one exposure in motion to the next, at least
    """

    seed: int = 0
    settle: str = "time:1"
    exposure: float | str | None = None
    calibration: Calibration | None = None
    calibration_name: str = "the calibration"
    tolerance: tuple[float, float] | None = None
    stop_on: frozenset[str] = frozenset()
    measure: bool = True
    limbs: LimbSource | None = None
    trust_position: bool = False
    resume: bool = False
    trace: Path | None = None
    cameras: bool = True
    in_motion: float | None = None
    interval: float = 0.25

    def uses_cameras(self, design: Design) -> bool:
        """Whether images are taken."""
        return self.cameras and bool(design.cameras)

    def __post_init__(self) -> None:
        if self.stop_on - set(ALARMS):
            unknown = ", ".join(sorted(self.stop_on - set(ALARMS)))
            raise RigError(f"--stop-on takes {', '.join(ALARMS)}, not {unknown}")
        if "drift" in self.stop_on and not self.tolerance:
            raise RigError("--stop-on drift takes a --calibration and a --tolerance")
        if self.limbs is not None and not self.measure:
            raise RigError(
                "--limbs with --no-measure: vision must measure some poses, or a slipping limb is never detected"
            )

    def accepted_limbs(self, design: Design) -> Accepted | None:
        """The limbs that stand for vision, None where none do. Raises RigError where nothing reads them."""
        if self.limbs is None:
            return None
        found = accepted_measuring_limbs_file.load_accepted_limbs_for_design(self.limbs.path, design)
        channels = measuring_limb_calibration_slips_and_vision_agreement.stated_limbs(design).channels
        if design.sensors is None or set(channels) - set(design.sensors.channels):
            raise RigError(
                f"--limbs takes a [sensors] table in rig.toml with the channels {channels[0]} .. {channels[-1]}"
            )
        return found

    def refuse_unsuited(self, design: Design) -> None:
        """Raise RigError for a calibration of another kind of machine than a design's, or with physics; and for what
        takes cameras where there are none.
        """
        if not self.uses_cameras(design) and (self.limbs is not None or self.settle == "images"):
            raise RigError("without cameras there is neither --settle images nor --limbs, which vision must check")
        if self.settle == "ask" and self.uses_cameras(design):
            raise RigError("--settle ask is for an operator's instrument in place of cameras: add --no-cameras")
        if self.in_motion is not None:
            self._refuse_unsuited_in_motion(design)
        calibration = self.calibration
        if calibration is None:
            return
        calibration.refuse_physics("watching a run")
        if calibration.correction.nominal.kind != design.mechanism.kind:
            raise RigError(
                f"{self.calibration_name} is of a mechanism of kind {calibration.correction.nominal.kind!r}, the "
                f"rig's is {design.mechanism.kind!r}"
            )

    def _refuse_unsuited_in_motion(self, design: Design) -> None:
        """Raise RigError for what takes struts at rest, or clocks that are known to agree."""
        if "rad" in axis_units(design.mechanism):
            raise RigError("--in-motion states a speed of struts or slides; this machine has joints that turn")
        if not self.uses_cameras(design):
            raise RigError("--in-motion exposes cameras during the moves, and this run has none")
        if any(camera.mount == "hand" for camera in design.cameras):
            raise RigError("--in-motion takes cameras that stand; one that the platform carries is exposed at rest")
        if self.calibration is not None or self.limbs is not None or self.stop_on & {"jump", "drift", "limbs"}:
            raise RigError(
                "in motion the clocks of cameras and controller must be known before a pose says anything of the "
                "struts, and they are found afterwards: leave out --calibration, --limbs and --stop-on jump, drift and "
                "limbs"
            )
        if not self.interval >= 0:
            raise RigError(f"--interval takes seconds of at least 0, not {self.interval:g}")


def compile_kernels_for_run(design: Design, in_two_processes: bool = False) -> bool:
    """Compile the kernels that a run needs.

    False of other machines than hexapods with cameras.
    By measuring one drawn image of a hexapod at home. in_two_processes : whether what only poses and the learner need
    is compiled beside what images need; both are kept, and loaded here
    """
    m = design.mechanism
    if not is_hexapod(m) or not design.cameras or not any(target.body == "platform" for target in design.targets):
        return False
    if in_two_processes:
        parallel_map(lambda part: part(design, m), [_compile_images, _compile_poses], items_per_process=1)
    markers, live = marker_map(design), Live(design)
    live.take(0, render_marker_images(design.cameras, m.home, markers))
    live.close()
    _compile_images(design, m)
    _compile_poses(design, m)
    return True


def _compile_images(design: Design, m: Hexapod) -> None:
    """Compile what finds markers where poses tell where they are."""
    T, markers = m.home, marker_map(design)
    images = render_marker_images(design.cameras, T, markers)
    for camera in design.cameras:
        detect_markers(images[camera.name], camera, markers, T_base_platform=T)


def _compile_poses(design: Design, m: Hexapod) -> None:
    """Compile what makes poses of corners, and what learns from poses."""
    markers = marker_map(design)
    seen = [(camera, expected_marker_rows_and_corners_in_image(camera, m.home, markers)) for camera in design.cameras]
    rows, names = np.concatenate([rows for _, (rows, _) in seen]), [c.name for c, (rows, _) in seen for _ in rows]
    corners = Corners(
        np.zeros(4 * len(rows), int),
        [name for name in names for _ in range(4)],
        np.repeat(markers.id[rows], 4),
        np.tile(np.arange(4), len(rows)),
        np.concatenate([quads.reshape(-1, 2) for _, (_, quads) in seen]),
        None,
    )
    observed = observations_from_corners(corners, np.zeros(1, int), design, markers)
    locate_platform_and_moving_cameras(UndistortedCorners(observed, design.cameras, markers, FINEST), design.cameras)
    learner, lengths = Learner(m), mechanisms.kinematics_of(m).inverse(m.home, m)
    for _ in range(2):  # the second is held against the first
        learner.learn(lengths, m.home, 1e-10 * np.eye(6))


def open_cameras(design: Design, clock: Clock) -> SynchronisedCameras:
    """Open all cameras of a design.

    Raises CameraError where one has no source or does not open; the others close.
    """
    opened = []
    try:
        for camera in design.cameras:
            opened.append(open_camera(camera, clock))
    except RigError:
        for source in opened:
            source.close()
        raise
    return SynchronisedCameras(tuple(opened), clock)


def open_sensors_and_assemble_equipment(
    design: Design,
    driver: Driver,
    shutter: SynchronisedCameras | None,
    settling: Settling,
    clock: Clock,
    interval: float,
    units: LengthAndAngleUnits = SI,
) -> RunEquipment:
    """Open a run's sensors, and assemble its RunEquipment.

    There may be no sensors. interval : s, as of RunOptions; units : of its rig.toml, in which an operator who is asked
    enters readings
    Raises RigError for settling by limbs that nobody reads.
    """
    sensing = open_sensors_of_rig_toml(design.sensors, clock) if design.sensors else None
    channels = set(design.sensors.channels) if design.sensors else set()
    if settling.by == "limbs" and not {f"m{i + 1}" for i in range(6)} <= channels:
        raise RigError("settling by limbs takes a [sensors] table with the channels m1 .. m6")
    return RunEquipment(
        driver,
        shutter,
        clock,
        settling,
        design.driver().tolerance,
        _move_time_profile(design),
        save_image,
        sensing.read if sensing else None,
        sensing.limbs if sensing else None,
        interval,
        ReadingForm(require_axes(design.mechanism), units, permitted_figure_counts_of_reading(design.instrument))
        if settling.by == "ask"
        else None,
        axis_milliunit_name(design.mechanism),
    )


def _move_time_profile(design: Design) -> Callable[[Floats, Floats, float, float], TimedShares]:
    """How a move goes in time: (start, goal (axes,) m, begun, ended s) -> Way, by the controller's stated speeds and
    accelerations.
    """
    c = design.driver()

    def profile(start: Floats, goal: Floats, begun: float, ended: float) -> TimedShares:
        travel = np.abs(goal - start)
        cruise = float((travel / c.max_speed).max())
        if not travel.any():
            return ()
        ramp = None if c.max_acceleration is None else float((travel / c.max_acceleration).max() / cruise)
        return trapezoidal_profile(begun, ended, cruise, ramp)

    return profile


def set_camera_exposures_and_report_lines(
    shutter: SynchronisedCameras, design: Design, stated_exposure: float | None, previous_exposures: dict[str, float]
) -> tuple[dict[str, float], list[str]]:
    """Set exposures of all cameras, and return lines that report them.

    stated_exposure : s of all, or None; previous_exposures : {camera: s} that the run had before, which it keeps where
        none is stated.
    Where there is neither, markers are made bright without clipping.
    Returns ({camera: s}, lines of a report)
    """
    made, lines, markers = dict[str, float](), [], marker_map(design)
    for source in shutter.sources:
        name = source.name
        wanted = previous_exposures.get(name) if stated_exposure is None else stated_exposure
        if not source.can_set_exposure:
            lines.append(f"camera {name!r} sets its exposure itself")
        elif wanted is not None:
            made[name] = source.set_exposure(wanted)
            lines.append(
                f"camera {name!r}: exposure {made[name] * 1e3:.3g} ms"
                + (", as before" if stated_exposure is None else "")
            )
        else:
            made[name], level = set_marker_exposure_and_measure_white(
                source,
                partial(marker_white_level_and_clipped_share, camera=design.camera(name), markers=markers),
                FIRST_EXPOSURE,
            )
            lines.append(f"camera {name!r}: exposure {made[name] * 1e3:.3g} ms, markers' white at {level:.0f} of 255")
    return made, lines


def make_run_observer(
    design: Design,
    planned: tuple[Step, ...],
    start: Floats,
    clock: Clock,
    stopping: RunStop,
    options: RunOptions,
    recording_path: Path,
) -> RunObserver:
    """Make the RunObserver of a run.

    It measures and learns during a run, by accepted limbs where the options name them.
    start : (axes,) m; recording_path : the recording, named where an acceptance is withdrawn
    """
    accepted = options.accepted_limbs(design)
    measured = (
        options.measure
        and options.uses_cameras(design)
        and (has_hand_cameras(design) or any(target.body == "platform" for target in design.targets))
    )
    learner = None
    if measured and is_hexapod(design.mechanism) and options.in_motion is None:
        shared = 0 if accepted is None else SHARED_DRAWS
        learner = Learner(design.mechanism, options.calibration, options.tolerance, shared)
    observer = RunObserver(design, planned, start, clock, Live(design) if measured else None, learner, stopping)
    if options.in_motion is not None:
        observer.ignore_limbs()
    if accepted is not None and options.limbs is not None:
        observer.source = LiveLimbPoses(accepted, options.limbs.every)
        observer.withdraw = partial(_withdraw, options.limbs.path, str(recording_path))
    return observer


def _withdraw(path: Path, recording: str, source: LiveLimbPoses, frame: int, reason: str) -> None:
    write_acceptance_withdrawal(path, source.accepted, recording, frame, reason)
