"""rig investigate: plan, record and diagnose in a loop until nothing is ambiguous, then calibrate and certify."""

from __future__ import annotations

import json
import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.cli.shared.command_options import SEED, add_json_result_option
from rig.cli.shared.investigation_execution import InvestigationMachine, Waiting, certify_investigation
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_whole_number

if TYPE_CHECKING:
    from calib.experiment.investigation_folder import Look

FIRST = "moving:24,sobol:60"  # the first plan of a rig that may be exposed on the way
LOADED = (
    "payload:6"  # besides, where a load may be asked for: at constant load most of a sag hides in the joint geometry
)
STANDING = "sobol:60,ladder:1,repeat:12"  # of one whose struts must stand
MOST = 8  # looks
STATE = "investigation.json"


def parse_minutes(text: str) -> float:
    """Parse a duration such as 2h or 90min, in minutes. Raises ArgumentTypeError for anything else"""
    found = re.fullmatch(r"([0-9]{1,4}(?:\.[0-9]{1,3})?)(h|min)", text)
    value = float(found[1]) * (60 if found[2] == "h" else 1) if found else 0.0
    if not 0 < value <= 6000:
        raise ArgumentTypeError(f"{text!r} must be a time of the rig above 0 and up to 100h, as 2h or 90min")
    return value


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        required=True,
        help="recordings, diagnoses, plans, notebook.md and notebook.html, and at "
        "the end calibration.json and certificate; a new folder, or with --resume the one to go on with",
    )
    parser.add_argument(
        "--budget", metavar="2h", type=parse_minutes, default=120.0, help="of the rig's time (default 2h)"
    )
    who = parser.add_mutually_exclusive_group()
    who.add_argument(
        "--machine",
        metavar="TRUTH",
        type=Path,
        help="a simulated machine, as rig simulate --machine takes it, instead of [controller]",
    )
    who.add_argument(
        "--by-hand", action="store_true", help="somebody does the moves: each plan is written and waited for"
    )
    parser.add_argument(
        "--plan",
        help=f"the first one (default {FIRST}, and {LOADED} where rig.toml allows a payload; where the "
        f"struts must stand {STANDING})",
    )
    parser.add_argument(
        "--seed", type=parse_whole_number, default=SEED, help="of plans, and of a simulated machine's noise"
    )
    parser.add_argument(
        "--verify",
        metavar="N",
        type=parse_whole_number,
        default=60,
        help="new poses by which the calibration is verified (default 60, which a certificate takes)",
    )
    parser.add_argument("--port", help="where the controller is, instead of what [controller] says")
    parser.add_argument("--settle", default="time:1", metavar="HOW", help="as for rig run")
    parser.add_argument("--no-home", action="store_true", help="as for rig run")
    parser.add_argument("--resume", action="store_true", help="go on with DIR, whatever it was interrupted by")
    add_json_result_option(parser)


def run(arguments: Namespace) -> int:
    """Plan, record, diagnose, and again, until nothing is alike or the budget ends; then calibrate, verify and
    certify.
    """
    from calib.experiment.investigation_folder import read_looks
    from calib.experiment.investigation_report import investigation_verdict
    from rig.formats.rig_toml import design_file

    design = design_file.load_design(arguments.design)
    if len(design.mechanism.stages) != 1:
        raise RigError(
            "an investigation is of a platform on struts or of an arm, not of a mechanism of kind "
            f"{design.mechanism.kind!r}"
        )
    if design.mechanism.link_rows is not None and design.instrument is None and not (design.cameras and design.targets):
        raise RigError(
            "an investigation of an arm takes an [instrument] that measures its poses, or cameras and "
            "targets that show them"
        )
    if not 12 <= arguments.verify <= 400:
        raise RigError(f"--verify takes 12 to 400 poses, not {arguments.verify}")
    rig = InvestigationMachine(arguments, design)
    _begin(arguments, rig)
    try:
        before = read_looks(arguments.out)
        if (
            before and before[-1].questions and not before[-1].proposed
        ):  # there was no time, or something was not allowed: it is asked again
            _diagnose(arguments, rig, before[-1].number, before[:-1])
        while True:
            so_far = read_looks(arguments.out)
            _tell(arguments, so_far, "")
            ended = _ended(arguments, so_far)
            if ended:
                break
            _look(arguments, rig, len(so_far) + 1, so_far)
        _tell(arguments, so_far, ended)
        after = certify_investigation(arguments, rig, so_far)
    except Waiting as waiting:
        print(waiting)
        arguments.result = _result(read_looks(arguments.out), "", (), str(waiting))
        return 0
    arguments.result = _result(so_far, ended, after)
    _tell(arguments, so_far, ended, after)
    print(investigation_verdict(so_far, ended).line)
    print(f"{ended}; look at {arguments.out / 'notebook.html'}")
    return 0


def _result(so_far: list[Look], ended: str, after: tuple[str, ...], waiting: str | None = None) -> dict[str, Any]:
    """What --json prints. ended : why, "" while it goes on; after : what was made at the end, in lines; waiting : for
    whom and what, or None
    """
    from dataclasses import asdict

    from calib.experiment.investigation_report import investigation_verdict

    verdict = investigation_verdict(so_far, ended).tree() if so_far else None
    return {
        "schema": "investigated/1",
        "verdict": verdict,
        "ended": ended,
        "waiting": waiting,
        "looks": [asdict(look) for look in so_far],
        "after": list(after),
    }


def _begin(arguments: Namespace, rig: InvestigationMachine) -> None:
    """Make the folder, or see that it is of this rig. Raises RigError otherwise."""
    from calib.experiment.investigation_folder import plan_path
    from rig.formats import json_file
    from rig.formats.output_files import write_bytes, write_text
    from rig.planning.plan import build_plan
    from rig.planning.plan_construction_and_table import write_plan_table

    out, own = arguments.out, {"schema": "investigation/1", "rig": rig.digest, "by": rig.by, "seed": arguments.seed}
    if arguments.resume:
        kept = json_file.load(out / STATE, "investigation", "investigation/1")
        for name, value in own.items():
            if kept.tree.get(name) != value:
                kept.fail(f"is of another {name}: {kept.tree.get(name)!r}, not {value!r}", name)
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RigError(
            f"{out} is there already"
            + ("; --resume goes on with it" if (out / STATE).exists() else "; name a new folder")
        )
    plan = build_plan(rig.design, arguments.plan or _first(rig), arguments.seed)
    rig.refuse(plan)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{out} cannot be made: {error.strerror}") from None
    write_bytes(out / "rig.toml", arguments.design.read_bytes())
    write_plan_table(plan_path(out, 1), plan, rig.design.mechanism.axes)
    write_text(out / STATE, json.dumps(own, indent=1) + "\n")


def _first(rig: InvestigationMachine) -> str:
    """The text of the first plan, where nobody states one."""
    if not rig.moving:
        return STANDING
    return f"{FIRST},{LOADED}" if "payload" in rig.design.experiment.may else FIRST


def _look(arguments: Namespace, rig: InvestigationMachine, number: int, so_far: list[Look]) -> None:
    """Record the plan of a look, and diagnose all recordings together."""
    from calib.experiment.investigation_folder import plan_path, recording_path

    rig.record(plan_path(arguments.out, number), recording_path(arguments.out, number), arguments.seed + number)
    _diagnose(arguments, rig, number, so_far)


def _diagnose(arguments: Namespace, rig: InvestigationMachine, number: int, so_far: list[Look]) -> None:
    """Diagnose the recordings up to a number together; the next plan is written with it. so_far : the looks before"""
    from calib.experiment.investigation_folder import diagnosis_path, plan_minutes, plan_path, recording_path
    from calib.experiment.investigation_report import minutes_spent

    out = arguments.out
    taken = minutes_spent(so_far) + plan_minutes(plan_path(out, number))
    left = max(arguments.budget - taken, 0.1)
    words = [
        "diagnose",
        *(str(recording_path(out, k + 1)) for k in range(number)),
        "--out",
        str(diagnosis_path(out, number)),
        "--next",
        str(plan_path(out, number + 1)),
        "--minutes",
        f"{left:.3f}",
        *([] if rig.moving else ["--standing"]),
        *(word for may in rig.design.experiment.may for word in ("--may", may)),
    ]
    rig.call(*words)


def _ended(arguments: Namespace, so_far: list[Look]) -> str:
    """Why the investigation ends, "" while it goes on."""
    from calib.experiment.investigation_report import minutes_spent

    if not so_far:
        return ""
    last = so_far[-1]
    if not last.questions:
        return (
            "nothing is alike any more"
            if last.findings
            else ("what is there has no name" if last.unknown else "nothing is left out")
        )
    if not last.proposed:
        late = minutes_spent(so_far) > arguments.budget / 2
        return (
            f"the budget of {arguments.budget:.0f} min leaves no time for an experiment that would tell more"
            if late
            else "no plan that is allowed tells what is left apart"
        )
    return f"{MOST} recordings did not tell it apart" if last.number >= MOST else ""


def _tell(arguments: Namespace, so_far: list[Look], ended: str, after: tuple[str, ...] = ()) -> None:
    """Write the notebook and its page as they are now."""
    from calib.experiment.investigation_report import notebook_text, write_investigation_page
    from rig.formats.output_files import write_text

    if so_far:
        name = arguments.design.resolve().parent.name if arguments.design.name == "rig.toml" else arguments.design.stem
        write_text(arguments.out / "notebook.md", notebook_text(name, so_far, arguments.budget, ended, after))
        write_investigation_page(arguments.out / "notebook.html", name, so_far, arguments.budget, ended, after)
