"""rig correct: corrected commands for wanted poses by a calibration; or corrected poses of readings."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files, poses_from_readings
from rig.cli.shared.command_options import add_json_result_option, add_overwrite_option, file_or_stdout
from rig.errors import RigError, Unreachable
from rig.formats.number_parsing_and_rounding import parse_numbers

if TYPE_CHECKING:
    import numpy as np

    from calib.files.calibration_file import Calibration
    from calib.models.wanted_pose_commands import Commanded
    from rig.recording.recording_folder import Sensors, Wanted


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    asked = parser.add_mutually_exclusive_group(required=True)
    asked.add_argument(
        "--poses",
        metavar="FILE",
        type=Path,
        help="frame,x,y,z,rx,ry,rz of the wanted poses; with a column t (s), when each is to be held, the "
        "commands run in time",
    )
    asked.add_argument(
        "--forward",
        metavar="FILE",
        type=Path,
        help="the other way, for a machine that measures: frame,l1..l6 (an arm: q1..qn) "
        "read off its limbs -> the poses that they stand for, corrected, with covariance",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        required=True,
        help="frame,l1..l6 (an arm: q1..qn) to command; in time frame,t,.. with no frame in rows on the way",
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
        help="where the axes stand at first: home (the default), or their values joined by commas, m or rad",
    )
    parser.add_argument(
        "--approach",
        choices=("auto", "always", "never"),
        default="auto",
        help="come to a pose from one side, past what an axis remembers: auto (the default) does where that makes "
        "it surer",
    )
    parser.add_argument("--skip-unreachable", action="store_true", help="leave out, and list, poses out of reach")
    parser.add_argument(
        "--uncorrected", action="store_true", help="command what the owner's model says, for comparison"
    )
    parser.add_argument(
        "--single-step",
        action="store_true",
        help="command X + KSF(X), the method's first step, not the fixed point that is exact",
    )
    calibration_and_effect_files.add_effects_option(parser)
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Write the commands that give the wanted poses, or the poses that readings stand for."""
    if arguments.forward:
        poses_from_readings.write_poses_of_readings(arguments)
        return
    import numpy as np

    from rig.model import mechanisms
    from rig.recording import recording_folder as recordings
    from rig.recording import recording_tables

    calibration = calibration_and_effect_files.load_calibration(
        arguments.calibration, calibration_and_effect_files.load_effect_files(arguments)
    )
    calibration_and_effect_files.read_refutations(arguments.calibration)
    if arguments.single_step and calibration.physics is not None and not arguments.uncorrected:
        raise RigError(
            "--single-step is of corrections that depend on the configuration alone; this calibration knows "
            "physics besides"
        )
    wanted = recordings.load_wanted_poses(arguments.poses)
    sensors = _sensors(arguments.sensors, wanted)
    start = _start(arguments.start, calibration)
    out = arguments.outputs.file(arguments.out)
    count = len(wanted.poses.frame)
    keep, refused = np.arange(count), []
    while len(keep):  # first what no command reaches, then what lies beyond the limits or comes too soon
        try:
            done = _commanded(arguments, calibration, wanted, keep, (start, sensors))
            break
        except Unreachable as error:
            refused += [
                (int(wanted.poses.frame[keep[i]]), line.split(": ", 1)[1])
                for i, line in zip(error.index, error.violations)
            ]
            keep = np.delete(keep, error.index)
    if refused:
        message = Unreachable(
            f"{len(refused)} of {count} wanted poses cannot be reached:",
            [frame for frame, _ in refused],
            [f"frame {frame}: {line}" for frame, line in sorted(refused)],
        )
        if not arguments.skip_unreachable or not len(keep):
            raise message
        print(f"rig correct: {message}\nleft out, as asked", file=sys.stderr)
    _write(out, calibration, wanted, keep, done)
    arguments.result = {
        "schema": "corrected/1",
        "wanted": count,
        "written": len(keep),
        "out_of_reach": [{"frame": frame, "reason": line} for frame, line in sorted(refused)],
        "commands": [
            {"frame": int(wanted.poses.frame[k]), "values": values} for k, values in zip(keep, done.values.tolist())
        ],
    }
    if done.covariance is not None:
        expected = arguments.outputs.stage_file(out, ".poses.csv")
        if expected is not None:
            recording_tables.write_poses(
                expected, recordings.Poses(wanted.poses.frame[keep], done.T_base_platform, done.covariance)
            )
        if not (arguments.uncorrected or arguments.single_step):
            _say(calibration, done, done.covariance)
    correction = calibration.correction
    _say_rest(arguments, calibration, out, (wanted, keep), done)
    print(f"{len(keep)} of {count} poses written to {arguments.out}")
    field = correction.extension
    if field is not None and not field.inside(done.values).all():
        print(
            f"{(~field.inside(done.values)).sum()} of them lie beyond the samples of the correction: there "
            "it is extrapolated, continuously"
        )
    if arguments.single_step:
        off = correction.missed(wanted.poses.T_base_platform[keep], done.values)
        print(
            f"the single step misses the fixed point by {np.nanmax(np.abs(off)):.3g} "
            f"{mechanisms.travel_unit(correction.nominal)} at most"
        )


def _commanded(
    arguments: Namespace,
    calibration: Calibration,
    wanted: Wanted,
    keep: np.ndarray,
    given: tuple[np.ndarray, Sensors | None],
) -> Commanded:
    """Commanded for the wanted poses to keep. given : where the axes start, sensors. Raises Unreachable for those that
    cannot be.
    """
    from calib.correct.correction import require_reachable
    from calib.models.wanted_pose_commands import commands_along_route, route_pace

    (start, sensors), T = given, wanted.poses.T_base_platform[keep]
    pace = None if wanted.t is None else route_pace(calibration, wanted.t[keep], sensors)
    correction = calibration.correction
    plain = (
        correction.uncorrected(T)
        if arguments.uncorrected
        else correction.single_step(T)
        if arguments.single_step
        else None
    )
    done = commands_along_route(calibration, T, start, pace, sensors, arguments.approach, plain)
    require_reachable(done.values, calibration.correction.nominal, [f"pose {i}" for i in range(len(keep))])
    return done


def _sensors(path: Path | None, wanted: Wanted) -> Sensors | None:
    """Sensors of a file. Raises RigError for a log in time where the poses have no times, or that does not cover
    them.
    """
    from calib.correct.physics_compensation import require_sensor_coverage
    from rig.recording import recording_folder as recordings

    if path is None:
        return None
    sensors = recordings.load_sensors(path, wanted.origin)
    if wanted.t is None and len(sensors.t) > 1:
        raise RigError(
            f"{path} has {len(sensors.t)} rows, and the wanted poses have no times: say in a column t when "
            "each is to be held, or give "
            "one row that holds for all"
        )
    if wanted.t is not None:
        require_sensor_coverage(sensors, wanted.t, wanted.origin.shown)
    return sensors


def _start(text: str, calibration: Calibration) -> np.ndarray:
    """(axes,) m or rad where the axes stand at first. Raises RigError for what is no such place."""
    import numpy as np

    from calib.correct.correction import require_reachable
    from rig.model import mechanisms

    nominal = calibration.correction.nominal
    if text == "home":
        return mechanisms.kinematics_of(nominal).home(nominal)
    try:
        values = np.array(parse_numbers(text.split(",")))
    except ValueError:
        values = np.zeros(0)
    if values.shape != (len(nominal.axes),) or not np.isfinite(values).all():
        raise RigError(f"--start takes home or {len(nominal.axes)} values joined by commas, m or rad, got {text!r}")
    try:
        require_reachable(values[None], nominal, ["the start"])
    except Unreachable as error:
        raise RigError(f"--start cannot be: {error.violations[0]}") from None
    return values


def _write(out: Path, calibration: Calibration, wanted: Wanted, keep: np.ndarray, done: Commanded) -> None:
    """Write the commands, in time with the rows on the way."""
    from calib.correct.pose_route import HOLDING
    from rig.recording import recording_tables

    axes, frames = calibration.correction.nominal.axes, wanted.poses.frame[keep]
    if wanted.t is None:
        rows = [
            ",".join([str(frame), *(f"{length:.10f}" for length in lengths)])
            for frame, lengths in zip(frames, done.values)
        ]
        recording_tables.write_table(out, ("frame", *axes), rows)
        return
    route, rows = done.route, []
    for t, pose, doing, lengths in zip(route.t.tolist(), route.pose, route.doing, route.values(done.values)):
        held = doing == HOLDING
        rows.append(
            ",".join(
                [
                    str(frames[pose]) if held else "",
                    wanted.origin.text(t if held else round(t, 6)),
                    *(f"{x:.10f}" for x in lengths),
                ]
            )
        )
    recording_tables.write_table(out, ("frame", "t", *axes), rows)


def _say_rest(
    arguments: Namespace, calibration: Calibration, out: Path, asked: tuple[Wanted, np.ndarray], done: Commanded
) -> None:
    """Of an arm of fewer than six joints, say what it leaves to the wanted poses, and write beside the commands the
    poses that it takes instead.

    asked : (Wanted, (n,) which of its poses are commanded)
    """
    import numpy as np

    from calib.models.arm import certification
    from calib.models.arm.correction import ArmCorrection
    from rig.model.pose import pose_difference
    from rig.recording import recording_folder as recordings
    from rig.recording import recording_tables

    correction, (wanted, keep) = calibration.correction, asked
    if not isinstance(correction, ArmCorrection) or not correction.deficient:
        return
    frames, rest = wanted.poses.frame[keep], pose_difference(done.T_base_platform, wanted.poses.T_base_platform[keep])
    place, turn = (np.linalg.norm(rest[:, part], axis=1) * 1e3 for part in (slice(0, 3), slice(3, 6)))
    print(
        f"an arm of {len(correction.nominal.joints)} joints cannot make up for every error: what it leaves "
        "to the wanted poses is "
        f"{np.sqrt(np.mean(place**2)):.4f} mm RMS, {place.max():.4f} at the most, and "
        f"{np.sqrt(np.mean(turn**2)):.4f} mrad RMS, "
        f"{turn.max():.4f} at the most (frame {frames[int(turn.argmax())]})"
    )
    beside = arguments.outputs.stage_file(out, ".poses.csv")
    if beside is not None:
        if done.covariance is None:
            covariance = certification.arm_pose_covariance(calibration, done.values)
            recording_tables.write_poses(beside, recordings.Poses(frames, done.T_base_platform, covariance))
        print(f"the poses that it takes instead, with their uncertainty, are in {beside.name}")


def _say(calibration: Calibration, done: Commanded, covariance: np.ndarray) -> None:
    """Say how sure the poses are, of covariance (n, 6, 6), and what that rests on."""
    import numpy as np

    lengths = [np.sqrt(np.trace(covariance[:, part, part], axis1=1, axis2=2)) for part in (slice(0, 3), slice(3, 6))]
    (position, rotation), (far, wide) = (
        [float(f(x)) * 1e3 for x in lengths] for f in (lambda x: np.sqrt(np.mean(x**2)), np.max)
    )
    print(
        f"stated standard uncertainty of the poses: {position:.4f} mm and {rotation:.4f} mrad RMS, {far:.4f} "
        f"and {wide:.4f} at the most"
    )
    if done.missing:
        print(
            "not logged, so taken as they were in the middle when calibrated, with their spread: "
            f"{', '.join(done.missing)}"
        )
    if done.route.approached.any():
        print(f"{done.route.approached.sum()} poses are come to from one side")
    physics = calibration.physics
    if physics is not None:
        left = [f"{e.label()} at {e.place}" for e in physics.scattering()]
        if left:
            print(f"not undone, as nobody knows its moment, and in the uncertainty: {', '.join(left)}")
