"""rig correct: correct wanted poses by a calibration.

rig correct serve: serve corrections.
By a calibration: corrected commands for wanted poses, or corrected poses of readings. The server answers programs of
this computer on a loopback port.
"""

from __future__ import annotations

import signal
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import escaped_output_progress_error_table_and_refutations, input_file_options_and_loading
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_hand_option,
    add_json_result_option,
    add_overwrite_option,
    calibration_of_chosen_hand,
    file_or_stdout,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import count_text, parse_numbers, parse_quantity, parse_whole_number

if TYPE_CHECKING:
    from calib.api.correct import CorrectionResult, CorrectOptions, PoseFrames
    from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
    from rig.array_and_json_types import Floats
    from rig.formats.csv_and_parquet_tables_and_time_origin import TableFormat
    from rig.formats.numbers_and_units import LengthAndAngleUnits
    from rig.recording.wanted_poses_and_roll_pitch_yaw import WantedPoses

ANGLES_OF_KINDS = {"gcs": "moving", "hxp": "moving", "symetrie": "fixed"}  # of --as, for controllers' own forms
TURNING_SYSTEMS = {"hxp": "Tool", "symetrie": "Object"}  # about whose origin such a controller turns


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig correct` to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument(
        "--poses",
        metavar="FILE",
        type=Path,
        help="frame,x,y,z,rx,ry,rz of the wanted poses, or frame,azimuth,elevation of a mount; with a column t (s), "
        "the time of each pose, the "
        "commands run in time",
    )
    group.add_argument(
        "--forward",
        metavar="FILE",
        type=Path,
        help="the reverse, for a measuring machine: frame,l1..l6 (an arm: q1..qn) "
        "read from its limbs -> the corresponding poses, corrected, with covariance",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        required=True,
        help="frame,l1..l6 (an arm: q1..qn) to command; in time frame,t,.. with no frame in intermediate rows",
    )
    parser.add_argument(
        "--sensors",
        metavar="FILE",
        type=Path,
        help="sensors.csv over the same time: temperatures, payload, as far as logged",
    )
    parser.add_argument(
        "--start",
        metavar="LENGTHS",
        default="home",
        help="initial axis values: home (the default), or values separated by commas, with their units or in m and rad",
    )
    parser.add_argument(
        "--approach",
        choices=("auto", "always", "never"),
        default="auto",
        help="approach a pose from one side, beyond any lost motion: auto (the default) does where that makes it surer",
    )
    parser.add_argument("--skip-unreachable", action="store_true", help="exclude, and list, unreachable poses")
    parser.add_argument(
        "--uncorrected", action="store_true", help="command what the nominal model says, for comparison"
    )
    parser.add_argument(
        "--single-step",
        action="store_true",
        help="command X + KSF(X), the method's first step, not the exact fixed point",
    )
    parser.add_argument(
        "--as",
        dest="kind",
        choices=("lengths", "poses", *ANGLES_OF_KINDS),
        default="lengths",
        help="what the controller takes: axis values (the default), or poses of a hexapod, frame,x,y,z,rx,ry,rz: "
        "its own nominal kinematics, that of rig.toml, makes the corrected lengths of them; gcs, hxp, symetrie: "
        "the same as MOV of PI, HexapodMoveAbsolute of Newport and C_MOVE_PTP of Symétrie take it, "
        "frame,X,Y,Z,U,V,W, mm and degrees",
    )
    for name, text in (
        ("work", "frame in the base frame, x,y,z,rx,ry,rz, m and rad"),
        ("tool", "frame in the platform frame, x,y,z,rx,ry,rz, m and rad"),
        ("pivot", "point in the tool frame, x,y,z, m, that a turn leaves where it is (SPI)"),
    ):
        parser.add_argument(
            f"--{name}", metavar="NUMBERS", help=f"of --as poses, gcs, hxp and symetrie: the controller's {name} {text}"
        )
    parser.add_argument(
        "--units",
        metavar="mm,deg",
        help="units of lengths and angles in --poses, --out, --start, --work, --tool and --pivot (default m,rad)",
    )
    parser.add_argument(
        "--decimal",
        choices=("point", "comma"),
        default="point",
        help="decimal sign in --poses and --out: point, commas between the cells (the default), or comma, semicolons",
    )
    add_hand_option(parser)
    input_file_options_and_loading.add_user_effect_files_option(parser)
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig correct`.

    Write corrected commands for wanted poses, or corrected poses of readings.
    """
    from calib.api.correct import correct
    from rig.recording.corner_and_pose_csv_tables import write_poses
    from rig.recording.wanted_poses_and_roll_pitch_yaw import load_wanted_poses

    if arguments.forward and (
        arguments.uncorrected
        or arguments.single_step
        or arguments.skip_unreachable
        or arguments.sensors
        or arguments.kind != "lengths"
        or arguments.units
        or arguments.decimal != "point"
    ):
        raise RigError(
            "--uncorrected, --single-step, --skip-unreachable, --sensors, --as poses, --units and --decimal apply to "
            "commands for wanted poses, not to --forward"
        )
    calibration = input_file_options_and_loading.calibration_of_arguments(arguments)
    out, chosen = arguments.outputs.file(arguments.out), calibration_of_chosen_hand(arguments, calibration)
    if arguments.forward:
        return _write_read_poses(arguments, chosen, out)
    escaped_output_progress_error_table_and_refutations.read_and_print_refutations(arguments.calibration)
    form = _format(arguments)
    wanted = load_wanted_poses(arguments.poses, form, chosen.correction.nominal)
    result = correct(calibration, wanted, _options(arguments, wanted, calibration, form.units))
    result.write(out, form)
    arguments.result = result.tree()
    poses = result.poses
    pose_file = None if poses is None else arguments.outputs.stage_file(out, ".poses.csv")
    if poses is not None and pose_file is not None:
        write_poses(pose_file, poses)
    _print_result(arguments, result, None if pose_file is None else pose_file.name)


def _format(arguments: Namespace) -> TableFormat:
    """Format of the tables of poses and commands. Raises RigError for what are no units."""
    from rig.formats.csv_and_parquet_tables_and_time_origin import TableFormat
    from rig.formats.numbers_and_units import SI, parse_length_and_angle_units

    try:
        units = SI if arguments.units is None else parse_length_and_angle_units(arguments.units)
    except ValueError as error:
        raise RigError(f"--units takes {error}") from None
    return TableFormat(units, arguments.decimal)


def _options(
    arguments: Namespace, wanted: WantedPoses, calibration: Calibration, units: LengthAndAngleUnits
) -> CorrectOptions:
    """How wanted poses are corrected, by the arguments, whose figures are in these units."""
    from calib.api.correct import CorrectOptions
    from rig.model import mechanisms
    from rig.recording.recording_folder import load_sensors

    return CorrectOptions(
        load_sensors(arguments.sensors, wanted.origin) if arguments.sensors else None,
        _start(arguments.start, mechanisms.axis_units(calibration.correction.nominal), units),
        arguments.approach,
        arguments.skip_unreachable,
        arguments.uncorrected,
        arguments.single_step,
        _pose_frames(arguments, units),
        arguments.hand,
    )


def _pose_frames(arguments: Namespace, units: LengthAndAngleUnits) -> PoseFrames | None:
    """Frames of a controller that takes poses, None for lengths. Raises RigError for what is no frame."""
    import numpy as np

    from calib.api.correct import PoseFrames
    from rig.model.pose import pose

    given = {name: getattr(arguments, name) for name in ("work", "tool", "pivot")}
    if arguments.kind == "lengths":
        if any(text is not None for text in given.values()):
            raise RigError("--work, --tool and --pivot apply to --as poses, gcs, hxp and symetrie")
        return None
    system = TURNING_SYSTEMS.get(arguments.kind)
    if system is not None and given["pivot"] is not None:
        raise RigError(f"--pivot: it turns about the origin of its {system} coordinate system; state that as --tool")
    numbers = {}
    for name, text in given.items():
        count = 3 if name == "pivot" else 6
        try:
            numbers[name] = parse_numbers(text.split(",")) if text is not None else [0.0] * count
        except ValueError:
            numbers[name] = []
        if len(numbers[name]) != count:
            raise RigError(f"--{name} takes {count} numbers separated by commas, {units}, not {text!r}")
        numbers[name] = units.si(np.array(numbers[name]), ["m"] * 3 + ["rad"] * (count - 3)).tolist()
    work, tool = (pose(numbers[name][:3], numbers[name][3:]) for name in ("work", "tool"))
    return PoseFrames(work, tool, np.array(numbers["pivot"]), ANGLES_OF_KINDS.get(arguments.kind))


def _start(text: str, axis_units: tuple[str, ...], units: LengthAndAngleUnits) -> Floats | None:
    """(axes,) m or rad, initial axis positions, None for home. Raises RigError for what is no such place"""
    import numpy as np

    if text == "home":
        return None
    try:
        words = text.split(",")
        scales = [units.per_si(unit) for unit in axis_units]
        if len(words) != len(axis_units):
            return np.array(parse_numbers(words))
        return np.array([parse_quantity(*each) for each in zip(words, axis_units, scales)])
    except ValueError:
        raise RigError(
            f"--start must be home or an axis' values each, separated by commas, {units}, got {text!r}"
        ) from None


def _write_read_poses(arguments: Namespace, calibration: Calibration, out: Path) -> None:
    """Write the poses that a measuring machine's readings stand for."""
    from calib.api.measuring_limb_acceptance_and_poses_from_readings import corrected_poses_of_readings
    from rig.formats import csv_and_parquet_tables_and_time_origin

    axes = calibration.correction.nominal.axes
    found = corrected_poses_of_readings(
        calibration, csv_and_parquet_tables_and_time_origin.read_csv_table(arguments.forward, ("frame", *axes))
    )
    found.write(out)
    print(f"{count_text(len(found.poses.frame), 'pose')} written to {arguments.out}: {found}")
    if found.physics:
        print("effects in the calibration are not subtracted from readings: they depend on the preceding motion")


def _print_result(arguments: Namespace, result: CorrectionResult, poses: str | None) -> None:
    """Print how sure the poses are, what is left of them, and how many were written. poses : name of their file"""
    from calib.api.correct import unreachable_poses_error
    from rig.model import mechanisms

    count = len(result.wanted.poses.frame)
    if result.out_of_reach:
        message = unreachable_poses_error(list(result.out_of_reach), count)
        print(f"rig correct: {message}\nexcluded, as requested", file=sys.stderr)
    if result.covariance is not None and not (arguments.uncorrected or arguments.single_step):
        _print_uncertainty(result, result.covariance)
    if result.rest is not None:
        _print_rest(result, result.rest, poses)
    print(f"{len(result.index)} of {count} poses written to {arguments.out}")
    if result.extrapolated:
        print(
            f"{result.extrapolated} of them lie beyond the samples of the correction: there "
            "it is extrapolated, continuously"
        )
    if arguments.single_step:
        print(
            f"the single step misses the fixed point by {result.single_step_miss:.3g} "
            f"{mechanisms.travel_unit(result.calibration.correction.nominal)} at most"
        )


def _print_uncertainty(result: CorrectionResult, covariance: Floats) -> None:
    """Print how sure the poses are, of covariance (n, 6, 6), and what that rests on."""
    from calib.api.correct import rms_and_greatest_uncertainty

    done, physics = result.commanded, result.calibration.physics
    (position, rotation), (far, wide) = rms_and_greatest_uncertainty(covariance)
    if result.direction_uncertainty is not None:
        print(f"stated standard uncertainty of the directions: {result.direction_uncertainty * 1e3:.4f} mrad RMS")
    else:
        print(
            f"stated standard uncertainty of the poses: {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad RMS, "
            f"{far * 1e3:.4f} and {wide * 1e3:.4f} at the most"
        )
    if done.missing:
        print(
            "not logged, so assumed at their central value of the calibration, with their spread: "
            f"{', '.join(done.missing)}"
        )
    for what, count in done.uncovered:
        print(
            f"{count_text(count, 'pose lies', 'poses lie')} beyond what {what} was recorded over: "
            f"over time it is not corrected there, all else is "
            "held at its end; its size is in the uncertainty"
        )
    if done.route.approached.any():
        print(f"{count_text(done.route.approached.sum(), 'pose is', 'poses are')} approached from one side")
    left = [] if physics is None else [f"{e.label()} at {e.place}" for e in physics.scattering()]
    if left:
        print(f"not compensated, as its time is unknown, and in the uncertainty: {', '.join(left)}")


def _print_rest(result: CorrectionResult, rest: Floats, poses: str | None) -> None:
    """Print what an arm of too few joints leaves to the wanted poses (n, 6), m and rad."""
    import numpy as np

    position, rotation = (np.linalg.norm(rest[:, part], axis=1) * 1e3 for part in (slice(0, 3), slice(3, 6)))
    print(
        f"a machine of {len(result.calibration.correction.nominal.axes)} axes cannot compensate every error: what it "
        "leaves at the wanted poses is "
        f"{np.sqrt(np.mean(position**2)):.4f} mm RMS, {position.max():.4f} at most, and "
        f"{np.sqrt(np.mean(rotation**2)):.4f} mrad RMS, "
        f"{rotation.max():.4f} at most (frame {result.frames[int(rotation.argmax())]})"
    )
    if poses is not None:
        print(f"the poses reached instead, with their uncertainty, are in {poses}")


def arguments_of_serve(parser: ArgumentParser) -> None:
    """Add the arguments of `rig correct serve` to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument("--port", type=parse_whole_number, default=0, metavar="PORT", help="0 (the default): any free")
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="an address of the loopback (default 127.0.0.1)"
    )
    input_file_options_and_loading.add_user_effect_files_option(parser)


def run_serve(arguments: Namespace) -> None:
    """Run `rig correct serve`.

    Answer until interrupted or terminated.
    """
    from calib.api.correction_server_and_move_to_pose import CorrectionServer

    calibration = input_file_options_and_loading.calibration_of_arguments(arguments)
    escaped_output_progress_error_table_and_refutations.read_and_print_refutations(arguments.calibration)
    for ending in (signal.SIGINT, signal.SIGTERM):  # a shell's background job ignores the first
        signal.signal(ending, signal.default_int_handler)
    server = CorrectionServer(calibration, arguments.host, arguments.port)
    try:
        print(f"serving {server.address[0]} port {server.address[1]}", flush=True)
        server.serve(lambda: True)
    except KeyboardInterrupt:
        print("ended")
    finally:
        server.close()
