"""rig run: run a plan on the real machine: move, settle, expose, journal; frames are measured during the run."""

from __future__ import annotations

import hashlib
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from rig.cli.shared import poses_from_readings
from rig.cli.shared.command_options import SEED, add_controller_arguments
from rig.driving.driver_reports_and_advice import TRUST
from rig.errors import PositionLost, RigError
from rig.formats.number_parsing_and_rounding import parse_number, parse_whole_number
from rig.formats.output_files import write_bytes

if TYPE_CHECKING:
    from rig.arrays import Floats
    from rig.driving.cameras.grab_and_settling import Settling
    from rig.driving.clock import Clock
    from rig.driving.run_journal import Began, Journal
    from rig.driving.run_steps_and_progress import Step
    from rig.model.design import Design

KINDS = ("jump", "camera", "covered", "unseen", "drift", "limbs")


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_controller_arguments(parser)
    parser.add_argument(
        "--plan",
        required=True,
        help="as for rig simulate, of parts at whose exposures the struts stand: "
        "sobol:40,ladder,repeat:20, or commands:FILE (frame,l1..l6 as rig correct and rig plan --for write it)",
    )
    parser.add_argument("--seed", type=parse_whole_number, default=SEED, help="of the plan")
    parser.add_argument(
        "--out",
        metavar="REC",
        type=Path,
        required=True,
        help="the recording; a new folder, or with --resume the one to go on with",
    )
    parser.add_argument("--resume", action="store_true", help="go on with REC from where the struts stand")
    parser.add_argument(
        "--dry-run", action="store_true", help="check the plan, say what would be done, and move nothing"
    )
    parser.add_argument("--no-home", action="store_true", help="believe the position that the controller reads")
    parser.add_argument(
        "--settle",
        default="time:1",
        metavar="HOW",
        help="time:SECONDS, images (until they no longer change) or limbs:METRES "
        "(until measuring limbs agree so well); default time:1",
    )
    parser.add_argument(
        "--exposure",
        metavar="SECONDS",
        help='of all cameras; by default so that markers are bright and do not clip; "keep" leaves them as they are',
    )
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="what poses are expected, and held against for drift"
    )
    parser.add_argument(
        "--tolerance", nargs=2, type=parse_number, metavar=("M", "RAD"), help="drift from the calibration that is said"
    )
    parser.add_argument(
        "--stop-on",
        default="",
        metavar="WHAT,..",
        help=f"end the run on {', '.join(KINDS)}; by default they are only said",
    )
    parser.add_argument("--no-measure", action="store_true", help="take images only")
    poses_from_readings.add_limb_options(parser)
    parser.add_argument(
        "--page",
        nargs="?",
        type=parse_whole_number,
        const=0,
        metavar="PORT",
        help="show the run on a page of this computer, with a button to stop it",
    )


def run(arguments: Namespace) -> int:
    """Check, home, and visit every pose of the plan; or go on where another process ended."""
    from rig.cli.shared.controller_session import design_with_controller
    from rig.driving.cameras.grab_and_settling import parse_settling
    from rig.driving.run_steps_and_progress import steps_of_plan
    from rig.model.cube_remounting import quarter_turns, turning_instructions
    from rig.planning.plan import build_plan

    design = design_with_controller(arguments.design, arguments.port)
    plan = build_plan(design, arguments.plan, arguments.seed)
    planned = steps_of_plan(plan)
    todo = turning_instructions(dict(plan.turned), quarter_turns(design))
    if todo:
        raise RigError(
            f"the plan is for a cube put back turned; {'; '.join(todo)}, and say so in {arguments.design} "
            "under [turned]"
        )
    settle, options = parse_settling(arguments.settle), _options(arguments)
    poses_from_readings.vision_check_interval(arguments)
    if arguments.limbs is not None:
        poses_from_readings.accepted_limbs_for_run(arguments, design)
    if arguments.dry_run:
        _dry_run(design, planned)
        return 0
    _place(arguments)
    return _run(arguments, design, planned, settle, options)


def _options(arguments: Namespace) -> tuple[float | str | None, frozenset[str]]:
    """(exposure s, None or "keep"; kinds of alarms that stop). Raises RigError for what cannot be meant, before
    anything moves.
    """
    wanted = frozenset(filter(None, arguments.stop_on.split(",")))
    if wanted - set(KINDS):
        raise RigError(f"--stop-on takes {', '.join(KINDS)}, not {', '.join(sorted(wanted - set(KINDS)))}")
    if arguments.tolerance and (min(arguments.tolerance) <= 0 or not arguments.calibration):
        raise RigError("--tolerance takes two positive numbers, and a --calibration to hold the poses against")
    if "drift" in wanted and not arguments.tolerance:
        raise RigError("--stop-on drift takes a --calibration and a --tolerance")
    exposure = arguments.exposure
    if exposure not in (None, "keep"):
        try:
            exposure = parse_number(exposure)
        except ValueError:
            exposure = 0.0
        if not 0 < exposure <= 10:
            raise RigError(f"--exposure takes seconds or keep, not {arguments.exposure!r}")
    return exposure, wanted


def _dry_run(design: Design, planned: tuple[Step, ...]) -> None:
    """Check the whole plan from home and say what it would do."""
    import numpy as np

    from rig.cli.shared.controller_session import lengths_text
    from rig.driving.emulators.emulator_opening import home_lengths
    from rig.driving.run_steps_and_progress import check_steps, step_distances
    from rig.model.mechanism_kinds import require_struts

    c = design.driver()
    start = c.home if c.home is not None else home_lengths(require_struts(design.mechanism))
    check_steps(planned, start, move_checker(design))
    way = step_distances(planned, start)
    for k, step in enumerate(planned):
        exposed = f"{step.frames} frame{'s' * (step.frames != 1)}" if step.frames else "passed on the way"
        print(f"step {k + 1}: {lengths_text(step.goal)}, {way[k] * 1e3:.1f} mm to go, {exposed}")
    frames, pixels = (
        sum(step.frames for step in planned),
        sum(camera.width * camera.height for camera in design.cameras),
    )
    print(
        f"{len(planned)} steps, {frames} frames of {len(design.cameras)} cameras, {way.sum():.2f} m of the "
        "busiest strut, "
        f"{(way / np.min(c.max_speed)).sum() / 60:.1f} min of moving; at most {frames * pixels / 1e9:.2f} GB "
        "of images; nothing was moved"
    )


def move_checker(design: Design) -> Callable[[Floats, Floats], None]:
    """Checker of moves: (start, goal (axes,) m) -> None, raises Unreachable where the driver would refuse the move."""
    from rig.driving import straight_move_profile
    from rig.model.mechanism_kinds import require_struts

    c, m = design.driver(), require_struts(design.mechanism)

    def check(start: Floats, goal: Floats) -> None:
        straight_move_profile.require_safe_path(
            start, straight_move_profile.require_lengths_in_range(goal, m), m, c.margin, c.max_step
        )

    return check


def _place(arguments: Namespace) -> None:
    """Make the recording's folder, or see that there is one to go on with. Raises RigError otherwise."""
    out, journal = arguments.out, arguments.out / "journal.jsonl"
    if arguments.resume:
        if not journal.exists():
            raise RigError(f"{out} has no journal.jsonl, so there is no run to resume")
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RigError(
            f"{out} is there already" + ("; --resume goes on with it" if journal.exists() else "; name a new folder")
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{out} cannot be made: {error.strerror}") from None


def _run(
    arguments: Namespace, design: Design, planned: tuple[Step, ...], settle: Settling, options: tuple[Any, ...]
) -> int:
    from rig.cli.shared.controller_session import open_driver, settled_status
    from rig.cli.shared.run_observation import Stopping
    from rig.cli.shared.run_preparation import (
        open_bench,
        open_cameras,
        run_displays,
        run_observer_of_arguments,
        set_exposures,
        warm_up,
    )
    from rig.driving.clock import SystemClock
    from rig.driving.move_and_record_loop import Operator
    from rig.driving.run_journal import Began, Journal
    from rig.driving.run_steps_and_progress import check_steps

    clock, (exposure, stop_on) = SystemClock(), options
    with ExitStack() as stack:
        journal = stack.enter_context(Journal(arguments.out / "journal.jsonl"))
        if journal.torn:
            print(
                f"the journal's last line was cut off ({journal.torn} bytes) and is taken away: nothing of "
                "it was reported"
            )
        fresh = not journal.rows
        if not fresh:
            _same(_began(journal), planned, arguments)
        shutter = open_cameras(design, clock)
        stack.callback(shutter.close)
        told: list[Callable[[str], None]] = [
            print
        ]  # who takes what the driver says: the terminal, then the journal too
        if not arguments.no_measure:
            Thread(target=warm_up, args=(design,), daemon=True).start()
        driver = stack.enter_context(open_driver(design, arguments.trace, lambda text: _tell(told, text), clock))
        status = settled_status(driver, clock)
        if arguments.no_home and not status.known:
            driver.trust()
        believed = status.known or arguments.no_home
        homes = design.driver().homing and not (arguments.no_home if fresh else believed)
        if not homes and not believed:
            raise PositionLost(f"where the struts stand is not known; {TRUST}")
        if homes:
            print("homing")
            status = driver.home()
        check_steps(planned, status.lengths, move_checker(design))
        bench = open_bench(design, driver, shutter, settle, clock)
        for line in set_exposures(shutter, design, exposure) if exposure != "keep" else ():
            print(line)
        if fresh:
            write_bytes(arguments.out / "rig.toml", arguments.design.read_bytes())
            journal.append(Began(0.0, clock.now(), len(planned), _hash(planned), tuple(map(float, status.lengths))))
        origin = _origin(journal, clock)
        looking = run_observer_of_arguments(
            arguments, design, planned, status.lengths, clock, Stopping(stop_on, driver.stop)
        )
        looking.displays += stack.enter_context(run_displays(arguments, looking))
        operator = Operator(bench, planned, journal, design.mechanism.axes, origin, looking)
        looking.note, told[:] = operator.remark, [operator.remark, lambda text: looking.update(phase=text)]
        try:
            if not fresh:
                print(f"going on: {operator.go_on(homed=homes)}")
            operator.run()
        finally:
            looking.finish()
    frames = looking.view.frames
    print(f"{frames} frames in {arguments.out}; rig measure {arguments.out} --out DIR measures them all together")
    return 0


def _tell(told: list[Callable[[str], None]], text: str) -> None:
    for tell in told:
        tell(text)


def _began(journal: Journal) -> Began:
    """A journal's first row. Raises RigError where that is not how a run begins."""
    from rig.driving.run_journal import Began

    first = journal.rows[0]
    if not isinstance(first, Began):
        raise RigError(f"{journal.path} does not begin with the beginning of a run")
    return first


def _origin(journal: Journal, clock: Clock) -> float:
    """s, the clock's time at t = 0 of the recording; where the computer's clock was set back since, so that time still
    goes on.
    """
    origin, last = _began(journal).wall, journal.rows[-1].t
    if clock.now() - origin > last:
        return origin
    print(
        f"the computer's clock has been set back by {last - (clock.now() - origin):.1f} s or more since; the "
        "recording's goes on"
    )
    return clock.now() - last - 1.0


def _hash(planned: tuple[Step, ...]) -> str:
    """sha256 of the places and exposures of a plan."""
    import numpy as np

    digest = hashlib.sha256()
    for step in planned:
        digest.update(np.round(step.goal, 9).tobytes() + step.frames.to_bytes(4, "little"))
    return digest.hexdigest()


def _same(began: Began, planned: tuple[Step, ...], arguments: Namespace) -> None:
    """Raise RigError where a journal is not of this plan."""
    if began.sha256 != _hash(planned):
        raise RigError(
            f"{arguments.out} is of another plan than --plan {arguments.plan} --seed {arguments.seed} on "
            f"{arguments.design}"
        )
