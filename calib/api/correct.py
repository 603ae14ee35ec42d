"""Correction of wanted poses.

The commands that give them through a calibration.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import require_commands_in_axis_ranges
from calib.correction.physical_effects_of_calibration_and_their_compensation import require_sensor_coverage
from calib.correction.timed_command_sequence_and_pose_space_correction_map import HOLDING
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_error_model_and_instrument_observations import tool_parameter_slice
from calib.models.machine_parameters_and_file_entries import corrected_pose_covariance
from calib.models.wanted_pose_commands import (
    RouteCommands,
    commands_along_route,
    pace_with_hold_times,
    pose_commands_for_controller_with_own_kinematics,
)
from rig.array_and_json_types import Floats, Integers, Json
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import AXES as HEXAPOD_AXES
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import PoseFrames as PoseFrames
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import xyz_mm_uvw_degrees_of_poses
from rig.errors import RigError, Unreachable
from rig.formats.csv_and_parquet_tables_and_time_origin import PLAIN, TableFormat
from rig.formats.output_files import write_text
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.pose import pose_difference, pose_to_vector
from rig.recording.corner_and_pose_csv_tables import POSE_COLUMNS, POSE_UNITS, Poses
from rig.recording.recording_folder import Sensors
from rig.recording.wanted_poses_and_roll_pitch_yaw import WantedPoses
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html

APPROACHES = ("auto", "always", "never")


@dataclass(frozen=True, slots=True, eq=False)
class CorrectOptions:
    """sensors : Sensors over the poses' time, None for as when calibrated; start : (axes,) m or rad where the axes
    stand at first, None for home; approach : one of APPROACHES, whether to come to a pose from one side, past what an
    axis remembers: "auto" where that makes it surer
    skip_unreachable : whether poses out of reach are left out, not refused
    uncorrected : whether to command what the nominal model says; single_step : whether to command X + KSF(X), the
    method's first step, not the exact fixed point
    pose_frames : frames of a controller that takes poses, which are written in place of lengths; None for lengths
    hand : whose poses are wanted, of an arm with several; joints that do not move it stay at the start
    """

    sensors: Sensors | None = None
    start: Floats | None = None
    approach: str = "auto"
    skip_unreachable: bool = False
    uncorrected: bool = False
    single_step: bool = False
    pose_frames: PoseFrames | None = None
    hand: str | None = None

    def __post_init__(self) -> None:
        if self.approach not in APPROACHES:
            raise ValueError(f"approach takes {APPROACHES}, got {self.approach!r}")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CorrectionResult(OneLineRepr):
    """Commands for wanted poses. calibration; wanted : Wanted; index : (n,) which of them are commanded; commanded :
    RouteCommands of these; out_of_reach : (frame, why) of the others; single_step : whether these are the method's
    first step; uncorrected : whether they are by the nominal model; pose_frames : of a controller that takes poses, or
    None
    """

    calibration: Calibration
    wanted: WantedPoses
    index: Integers
    commanded: RouteCommands
    out_of_reach: tuple[tuple[int, str], ...] = ()
    single_step: bool = False
    uncorrected: bool = False
    pose_frames: PoseFrames | None = None

    @property
    def frames(self) -> Integers:
        """(n,) frames of the poses that are commanded."""
        return self.wanted.poses.frame[self.index]

    @property
    def values(self) -> Floats:
        """(n, axes) m or rad to command."""
        return self.commanded.values

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the values of a command: axes, or a pose's."""
        if self.pose_frames is None:
            return self.calibration.correction.nominal.axes
        return HEXAPOD_AXES if self.pose_frames.angles else POSE_COLUMNS

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the values of a command; none of what a controller takes, which is in mm and degrees."""
        if self.pose_frames is None:
            return mechanisms.axis_units(self.calibration.correction.nominal)
        return ("",) * 6 if self.pose_frames.angles else POSE_UNITS

    def commands(self, values: Floats, pose: Integers) -> Floats:
        """(m, columns) to command for values (m, axes) m or rad, near the wanted poses of indices pose (m,): the same,
        or poses (m, rad; or X .. W in mm, degrees) for a controller that takes these. Raises NotConverged where no pose
        gives the lengths.
        """
        if self.pose_frames is None:
            return values
        near = self.wanted.poses.T_base_platform[self.index[pose]]
        nominal = self.calibration.correction.nominal
        command = pose_commands_for_controller_with_own_kinematics(nominal, values, near, self.pose_frames)
        angles = self.pose_frames.angles
        return xyz_mm_uvw_degrees_of_poses(command, angles) if angles else pose_to_vector(command)

    @property
    def covariance(self) -> Floats | None:
        """(n, 6, 6) of the poses that come of them (m, rad, on the right), None where they are not corrected."""
        return self.commanded.covariance

    @property
    def extrapolated(self) -> int:
        """How many of the commands lie beyond the samples of an extended correction."""
        field = self.calibration.correction.extension
        return 0 if field is None else int((~field.inside(self.values)).sum())

    @property
    def single_step_miss(self) -> float:
        """m or rad, the most by which the single step misses the fixed point."""
        T = self.wanted.poses.T_base_platform[self.index]
        return float(np.nanmax(np.abs(self.calibration.correction.missed(T, self.values))))

    @property
    def rest(self) -> Floats | None:
        """(n, 6) m and rad that a machine of fewer than six axes leaves to the wanted poses, None of other machines."""
        correction = self.calibration.correction
        if not correction.deficient:
            return None
        return pose_difference(self.commanded.T_base_platform, self.wanted.poses.T_base_platform[self.index])

    @property
    def direction_uncertainty(self) -> float | None:
        """rad RMS, standard uncertainty of wanted directions by its length; None where whole poses are wanted."""
        if not self.wanted.directions or self.covariance is None:
            return None
        return float(np.sqrt(np.trace(self.covariance[:, 3:5, 3:5], axis1=1, axis2=2).mean()))

    @property
    def poses(self) -> Poses | None:
        """Poses that come of the commands, with covariance; None where they are those wanted and not corrected."""
        covariance, T = self.commanded.covariance, self.commanded.T_base_platform
        if covariance is None and self.rest is None:
            return None
        if covariance is None:
            covariance = corrected_pose_covariance(self.calibration, T, self.values)
        return Poses(self.frames, T, covariance)

    def __str__(self) -> str:
        done = f"{len(self.index)} of {len(self.wanted.poses.frame)} poses"
        covariance = self.covariance
        if covariance is None:
            return f"{done}, not corrected" if self.uncorrected else f"{done}, by a single step"
        position, rotation = rms_and_greatest_uncertainty(covariance)[0]
        return f"{done}, standard uncertainty {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad RMS"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        lines = [f"out of reach: frame {frame}, {why}" for frame, why in self.out_of_reach]
        rows = [
            (str(frame), *(f"{value:.6f}" for value in row)) for frame, row in zip(self.frames, self._held().tolist())
        ]
        return result_html(str(self), lines, [("frame", *self.columns), *rows])

    def tree(self) -> Json:
        """What `rig correct --json` prints."""
        return {
            "schema": "corrected/1",
            "wanted": len(self.wanted.poses.frame),
            "written": len(self.index),
            "out_of_reach": [{"frame": frame, "reason": why} for frame, why in sorted(self.out_of_reach)],
            "commands": [
                {"frame": int(frame), "values": values} for frame, values in zip(self.frames, self._held().tolist())
            ],
        }

    def _held(self) -> Floats:
        """(n, columns) to command at the poses."""
        return self.commands(self.values, np.arange(len(self.values)))

    def write(self, path: Path, form: TableFormat = PLAIN) -> None:
        """Write the commands, in time with the rows on the way. form : of the file; what MOV takes is in mm and degrees
        in any
        """
        axes, frames, wanted = self.columns, self.frames, self.wanted
        if wanted.t is None:
            lines = [[str(frame), *cells] for frame, cells in zip(frames, form.figures(self._held(), self.units))]
            write_text(path, "\n".join([form.line(("frame", *axes)), *map(form.line, lines)]) + "\n")
            return
        route, lines = self.commanded.route, []
        commands = self.commands(route.values(self.values), np.asarray(route.pose, np.int64))
        for t, pose, doing, cells in zip(route.t.tolist(), route.pose, route.doing, form.figures(commands, self.units)):
            held = doing == HOLDING
            time = wanted.origin.text(t if held else round(t, 6))
            lines.append([str(frames[pose]) if held else "", time, *cells])
        write_text(path, "\n".join([form.line(("frame", "t", *axes)), *map(form.line, lines)]) + "\n")


def correct(
    calibration: Calibration, wanted: WantedPoses | RigidTransform, options: CorrectOptions = CorrectOptions()
) -> CorrectionResult:
    """CorrectionResult for wanted poses T_base_platform in their order.

    All known effects compensated.
    wanted : RigidTransform (n,) or (), each held until all has come to rest; or Wanted, with frames and with times
    Raises Unreachable listing the poses that leave the axes' ranges or come too soon, NotConverged where no commands
        are found, RigError for a log of sensors that does not cover the poses
    """
    calibration = _of_chosen_hand(calibration, options)
    if isinstance(wanted, RigidTransform):
        T = RigidTransform.from_matrix(wanted.as_matrix().reshape(-1, 4, 4))
        wanted = WantedPoses(Poses(np.arange(len(T)), T, None))
    if options.single_step and calibration.physics is not None and not options.uncorrected:
        raise RigError(
            "--single-step is for corrections that depend on the configuration only; this calibration includes "
            "physics besides"
        )
    unreached: dict[int, str] = {}
    if wanted.directions:
        if not isinstance(calibration.correction, ArmCorrection):
            raise RigError("directions are wanted of arms, as of a telescope's mount; state whole poses")
        wanted, unreached = _pointed(calibration.correction, wanted, options.skip_unreachable)
    _require_log(options.sensors, wanted)
    start = _start(options.start, calibration)
    count = len(wanted.poses.frame)
    keep, refused = (
        np.delete(np.arange(count), list(unreached)),
        [(int(wanted.poses.frame[i]), why) for i, why in unreached.items()],
    )
    while len(keep):  # first what no command reaches, then what lies beyond the limits or comes too soon
        try:
            done = _commanded(calibration, wanted, keep, start, options)
            break
        except Unreachable as error:
            refused += [
                (int(wanted.poses.frame[keep[i]]), line.split(": ", 1)[1])
                for i, line in zip(error.index, error.violations)
            ]
            keep = np.delete(keep, error.index)
    if refused and (not options.skip_unreachable or not len(keep)):
        raise unreachable_poses_error(refused, count)
    result = CorrectionResult(
        calibration, wanted, keep, done, tuple(refused), options.single_step, options.uncorrected, options.pose_frames
    )
    result.commands(done.values, np.arange(len(keep)))  # that no pose gives the lengths is said before any is written
    return result


def unreachable_poses_error(unreachable_frames: list[tuple[int, str]], count: int) -> Unreachable:
    """Error (Unreachable) that lists unreachable poses, of `count` in all."""
    return Unreachable(
        f"{len(unreachable_frames)} of {count} wanted poses cannot be reached:",
        [frame for frame, _ in unreachable_frames],
        [f"frame {frame}: {line}" for frame, line in sorted(unreachable_frames)],
    )


def rms_and_greatest_uncertainty(covariance: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    """RMS and greatest standard uncertainty of poses.

    Each is (m, rad), of covariances (n, 6, 6).
    """
    position, rotation = (
        np.sqrt(np.trace(covariance[:, part, part], axis1=1, axis2=2)) for part in (slice(0, 3), slice(3, 6))
    )
    rms = float(np.sqrt(np.mean(position**2))), float(np.sqrt(np.mean(rotation**2)))
    return rms, (float(np.max(position)), float(np.max(rotation)))


def _commanded(
    calibration: Calibration, wanted: WantedPoses, keep: Integers, start: Floats, options: CorrectOptions
) -> RouteCommands:
    """RouteCommands for the wanted poses to keep. Raises Unreachable for those that cannot be."""
    T, correction = wanted.poses.T_base_platform[keep], calibration.correction
    pace = None if wanted.t is None else pace_with_hold_times(calibration, wanted.t[keep], options.sensors)
    plain = None
    if options.uncorrected:
        plain = correction.uncorrected(T)
    elif options.single_step:
        plain = correction.single_step(T)
    done = commands_along_route(calibration, T, start, pace, options.sensors, options.approach, plain)
    require_commands_in_axis_ranges(done.values, correction.nominal, [f"pose {i}" for i in range(len(keep))])
    return done


def _pointed(
    correction: ArmCorrection, wanted: WantedPoses, skip_unreachable: bool
) -> tuple[WantedPoses, dict[int, str]]:
    """(Wanted directions as whole poses, {index: why} of those that none reaches, which stay as they are).

    Raises Unreachable, naming frames, where these are not to be skipped
    """
    T, frame = wanted.poses.T_base_platform, wanted.poses.frame
    reached, unreached = np.arange(len(frame)), {}
    try:
        poses = correction.poses_pointing_along(T)
    except Unreachable as error:
        why = [line.split(": ", 1)[1] for line in error.violations]
        if not skip_unreachable or len(error.index) == len(frame):
            lines = [f"frame {frame[i]}: {text}" for i, text in zip(error.index, why)]
            raise Unreachable(str(error).splitlines()[0], error.index, lines) from None
        unreached, reached = dict(zip(map(int, error.index), why)), np.delete(reached, error.index)
        poses = correction.poses_pointing_along(T[reached])
    matrix = T.as_matrix()
    matrix[reached] = poses.as_matrix()
    whole = replace(wanted.poses, T_base_platform=RigidTransform.from_matrix(matrix))
    return replace(wanted, poses=whole), unreached


def _require_log(sensors: Sensors | None, wanted: WantedPoses) -> None:
    """Raise RigError for a log in time where the poses have no times, or that does not cover them."""
    if sensors is None:
        return
    if wanted.t is not None:
        require_sensor_coverage(sensors, wanted.t, wanted.origin.shown)
    elif len(sensors.t) > 1:
        raise RigError(
            f"the sensors' log has {len(sensors.t)} rows, and the wanted poses have no times: state in a column t when "
            "each is to be held, or give "
            "one row that applies to all"
        )


def _of_chosen_hand(calibration: Calibration, options: CorrectOptions) -> Calibration:
    """The calibration of the hand that is chosen, other joints at the start.

    Raises RigError where none is chosen, and for
        one that was not measured, whose errors the calibration does not know.
    """
    names = hand_names(calibration.correction.nominal)
    if options.hand is None:
        if names:
            raise RigError(f"poses are wanted of one hand; choose it with --hand NAME: {', '.join(names)}")
        return calibration
    seen = calibration.of_hand(options.hand)
    assert isinstance(seen.correction, ArmCorrection)
    if not options.uncorrected and not calibration.covariance[tool_parameter_slice(seen.correction.nominal)].any():
        raise RigError(
            f"the hand {options.hand!r} was not measured in this calibration, so the errors of its poses are not "
            "known; --uncorrected commands what the nominal model says"
        )
    return replace(seen, correction=seen.correction.with_other_joints_at(_start(options.start, calibration)))


def _start(values: Floats | None, calibration: Calibration) -> Floats:
    """(axes,) m or rad where the axes stand at first. Raises RigError for what is no such place."""
    nominal = calibration.correction.nominal
    if values is None:
        return mechanisms.kinematics_of(nominal).home_values(nominal)
    values = np.asarray(values, float)
    if values.shape != (len(nominal.axes),) or not np.isfinite(values).all():
        shown = ",".join(f"{value:g}" for value in values.ravel())
        raise RigError(
            f"--start must be home or {len(nominal.axes)} values separated by commas, m or rad, got {shown!r}"
        )
    try:
        require_commands_in_axis_ranges(values[None], nominal, ["the start"])
    except Unreachable as error:
        raise RigError(f"--start is invalid: {error.violations[0]}") from None
    return values
