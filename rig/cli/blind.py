"""rig blind: draw blind cases on simulated machines, diagnose each without the truth, and score the campaign."""

from __future__ import annotations

import json
import os
import re
import sys
import time
from argparse import ArgumentParser, Namespace
from hashlib import sha256
from pathlib import Path
from signal import SIGKILL
from subprocess import CompletedProcess
from typing import TYPE_CHECKING, Any

from rig.cli.shared import blind_case_process
from rig.cli.shared.command_options import add_json_result_option, add_overwrite_option
from rig.cli.shared.worker_options import results_with_progress, worker_pool
from rig.compute.worker_processes import run_child_process
from rig.errors import FileError, RigError
from rig.formats import structured_files
from rig.formats.input_files import read_bytes, short_repr
from rig.formats.json_tree import Json
from rig.formats.number_parsing_and_rounding import parse_whole_number

if TYPE_CHECKING:
    from types import ModuleType

    from synthetic.diagnosis_score import Case

ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")}
ROOT = Path(__file__).parents[2]  # children run the code that runs here, wherever they stand
MOST, MOST_FRAMES = 1_000_000, 10_000  # cases of a campaign, frames of a case
INTERRUPTED = (130, -2, -9, -15)  # exit statuses of a process that somebody stopped


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("--season", type=parse_whole_number, required=True, metavar="N", help="how many cases")
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        required=True,
        help="recordings, hashes, truth, diagnoses and score are kept there; "
        "a campaign that was interrupted goes on where it stopped",
    )
    parser.add_argument("--seed", type=parse_whole_number, default=0, help="another seed is another campaign")
    parser.add_argument(
        "--cases", "--trials", dest="cases", metavar="LIST", help="only these of the campaign, for example 3,7-9"
    )
    parser.add_argument(
        "--frames", type=parse_whole_number, help="of each recording, about (default 380; 40 in images)"
    )
    parser.add_argument(
        "--hide",
        metavar="KINDS",
        help="what cases may hide (default all): nothing, one, two effects; of hexapods also "
        "something foreign to the catalogue (foreign), disturbed noise (noise), not in images",
    )
    parser.add_argument(
        "--effects", metavar="NAMES", default="", help="effects to draw from, joined by commas (default all)"
    )
    parser.add_argument(
        "--mechanism",
        choices=("hexapod", "arm"),
        default="hexapod",
        help="of the rigs (default hexapod): an arm's cases hide "
        "nothing, one or two effects of its joints, a third of them under real recordings' hardships; no --withhold",
    )
    parser.add_argument(
        "--withhold",
        "--blindfold",
        dest="withhold",
        metavar="WHAT",
        default="",
        help="covariates to take away, joined by commas: temperature, payload, reversals, motion",
    )
    parser.add_argument(
        "--images",
        action="store_true",
        help="draw images: three resolutions, two lenses, blur, defocus, noise, vignetting, markers "
        "printed as printers print; effects that pictures show (needs OpenGL)",
    )
    parser.add_argument("--again", action="store_true", help="diagnose anew what has been diagnosed")
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Blind the cases, diagnose each in a process that cannot read the truth, unblind and score."""
    from synthetic import blind_arm_cases as blind_arm
    from synthetic import blind_cases as blind
    from synthetic import diagnosis_score as score

    settings = _settings(arguments, blind, blind_arm)
    indices = _indices(arguments.cases, arguments.season)
    out = arguments.outputs.growing(arguments.out, own=(arguments.out / "campaign.json").exists()).resolve()
    _same_campaign(out / "campaign.json", settings)
    for name in ("recordings", "hashes", "truth", "diagnoses"):
        (out / name).mkdir(exist_ok=True)
    with worker_pool() as workers:
        undrawn = [i for i in indices if _digest(out, i) is None]
        for index in undrawn:  # what was diagnosed of another drawing is no answer to this one
            (out / "diagnoses" / f"{index:04d}.json").unlink(missing_ok=True)
        for _ in results_with_progress(workers, _drawn, [(str(out), i, settings) for i in undrawn], "drawing"):
            pass
        waiting = [i for i in indices if arguments.again or _record(out, i) is None]
        for index, _, error in results_with_progress(
            workers, _diagnosed, [(str(out), i) for i in waiting], "diagnosing"
        ):
            if error:
                print(f"case {index} could not be diagnosed: {error.splitlines()[-1]}", file=sys.stderr)
    hashed = [int(path.stem) for path in (out / "hashes").glob("*.sha256") if path.stem.isdigit()]
    known = sorted(i for i in hashed if _digest(out, i) is not None and _record(out, i) is not None)
    cases = [_unblinded(out, i, score) for i in known]
    arguments.result = {"schema": "campaign/1", **_report(out, settings, cases, score)}


def _settings(arguments: Namespace, blind: ModuleType, blind_arm: ModuleType) -> Json:
    """What makes a campaign: all that its recordings depend on."""
    from rig.effects.catalogue.effect_list import BY_NAME
    from synthetic import blind_image_settings
    from synthetic.image_simulation import is_drawable

    if not 1 <= arguments.season <= MOST or not 0 <= arguments.seed < 1 << 63:
        raise RigError(f"--season takes 1 to {MOST}, --seed at least 0 and below 2^63")
    arm = arguments.mechanism == "arm"
    if arm and arguments.images:
        raise RigError("--images are of hexapods; an arm's cases are poses: leave one of --images and --mechanism out")
    default = blind_arm.FRAMES if arm else blind_image_settings.FRAMES if arguments.images else blind.FRAMES
    frames = default if arguments.frames is None else arguments.frames
    if not 40 <= frames <= MOST_FRAMES:
        raise RigError(
            f"--frames must be at least 40 and at most {MOST_FRAMES}, not {frames}: a diagnosis takes some poses"
        )
    kinds = blind_arm.KINDS if arm else blind.KINDS
    hide = ",".join(kinds) if arguments.hide is None else arguments.hide
    texts = {"hide": hide, "effects": arguments.effects, "withhold": arguments.withhold}
    lists = {name: [part.strip() for part in text.split(",") if part.strip()] for name, text in texts.items()}
    for name, known in (("hide", kinds), ("effects", BY_NAME), ("withhold", blind.WITHHELD)):
        for part in lists[name]:
            if part not in known:
                raise RigError(f"--{name}: there is no {part!r}; there are {', '.join(known)}")
    able = blind_image_settings.KINDS if arguments.images else kinds
    lists["hide"] = [kind for kind in lists["hide"] if kind in able]
    if not lists["hide"]:
        raise RigError(f"--hide takes some of {', '.join(able)}")
    if arm and lists["withhold"]:
        raise RigError("--withhold takes covariates of a hexapod away; with --mechanism arm leave it out")
    unseen = [name for name in lists["effects"] if arguments.images and not is_drawable(BY_NAME[name])]
    if unseen:
        raise RigError(f"--effects: pictures do not show {', '.join(unseen)}, only corners do; leave --images out")
    more = {"mechanism": "arm"} if arm else {"images": True} if arguments.images else {}
    return {"seed": arguments.seed, "frames": frames, **more, **lists}


def _indices(text: str | None, count: int) -> list[int]:
    """The cases asked for: all of 1..count, or those of a list like 3,7-9."""
    if text is None:
        return list(range(1, count + 1))
    try:
        ranges = [[parse_whole_number(end) for end in part.split("-")] for part in text.split(",")]
    except ValueError:
        raise RigError(f"--cases takes for example 3,7-9, not {short_repr(text)}") from None
    if any(len(ends) > 2 or not 1 <= ends[0] <= ends[-1] <= count for ends in ranges):
        raise RigError(
            f"--cases {short_repr(text)}: the campaign has cases 1 to {count}, and a range runs from small to large"
        )
    return sorted({i for ends in ranges for i in range(ends[0], ends[-1] + 1)})


def _same_campaign(path: Path, settings: Json) -> None:
    """Write what makes this campaign, or raise RigError where the folder holds another."""
    from rig.formats.output_files import write_text

    if path.exists():
        held = structured_files.load_json(path, "campaign").tree
        other = [name for name in {**settings, **held} if held.get(name) != settings.get(name)]
        if other:
            told = ", ".join(f"{n} {short_repr(held.get(n))} (not {settings.get(n)!r})" for n in other)
            raise RigError(f"{path.parent} holds another campaign, with {told}")
    write_text(path, json.dumps(settings, indent=1) + "\n")


def _drawn(out: Path, index: int, settings: Json) -> None:
    done = _child(["draw", out, str(index), json.dumps(settings)])
    if done.returncode:
        raise RigError(f"case {index} could not be drawn: {done.stderr.strip() or 'stopped'}")


def _diagnosed(out: Path, index: int) -> tuple[int, float, str | None]:
    """(index, seconds, error or None) of the diagnosis of one case, in a process to which the truth is closed."""
    from rig.formats.output_files import write_text

    out = Path(out)
    target, record = out / "diagnoses" / f"{index:04d}", out / "diagnoses" / f"{index:04d}.json"
    (target / "diagnosis.json").unlink(missing_ok=True)
    record.unlink(missing_ok=True)
    start = time.monotonic()
    command = [
        "command",
        out / "truth",
        "diagnose",
        out / "recordings" / f"{index:04d}",
        "--out",
        target,
        "--force",
        "--anyway",
    ]  # what a case hides may be what a check refuses
    done = _child(command)
    seconds = time.monotonic() - start
    if done.returncode in INTERRUPTED:
        return index, seconds, "stopped; it will be diagnosed when the campaign goes on"
    error = None if done.returncode == 0 else done.stderr.strip() or f"exit status {done.returncode}"
    write_text(record, json.dumps({"seconds": round(seconds, 2), "failed": error}) + "\n")
    return index, seconds, error


def _child(command: list[Any]) -> CompletedProcess[str]:
    """A process of `blind_case_process` once it has ended; one that is ended from outside, as a system does that is
    short of memory, is begun once more.
    """
    command = [sys.executable, "-P", "-m", blind_case_process.__name__, str(os.getpid()), *command]
    done = run_child_process(command, _environment())
    return run_child_process(command, _environment()) if done.returncode == -SIGKILL else done


def _environment() -> dict[str, str]:
    """Of a child: one thread, and this code before any other."""
    return {
        **os.environ,
        **ONE_THREAD,
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]),
    }


def _digest(out: Path, index: int) -> str | None:
    """What a case's hash says, or None where there is none or it is torn, which is said: the case is then drawn anew,
    the same by its seed.
    """
    path = blind_case_process.hash_file(out, index)
    if not path.exists():
        return None
    found = re.match(rb"[0-9a-f]{64}\b", read_bytes(path))
    if found is None:
        print(f"case {index}: {path} holds no sha256; it is drawn anew", file=sys.stderr)
    return found and found[0].decode()


def _record(out: Path, index: int) -> tuple[float, str | None] | None:
    """(seconds, error or None) of a case's diagnosis, or None where there is none or it is torn, which is said: it is
    then diagnosed anew.
    """
    path = out / "diagnoses" / f"{index:04d}.json"
    if not path.exists():
        return None
    try:
        table = structured_files.load_json(path, "record of a diagnosis")
        return table.number("seconds", least=0), None if table.get("failed") is None else table.text("failed")
    except FileError as error:
        print(f"case {index}: it is diagnosed anew: {error}", file=sys.stderr)
        return None


def _unblinded(out: Path, index: int, score: ModuleType) -> Case:
    """score.Case of one of a campaign. Raises RigError where the truth is not what was hashed."""
    truth, record = out / "truth" / f"{index:04d}.json", _record(out, index)
    if record is None:
        raise RigError(f"case {index} has not been diagnosed")
    if not truth.exists() or sha256(read_bytes(truth)).hexdigest() != _digest(out, index):
        raise RigError(f"{truth} is not what was hashed before the diagnosis; take the case out of the campaign")
    seconds, failed = record
    diagnosis = None if failed else out / "diagnoses" / f"{index:04d}" / "diagnosis.json"
    return score.score_case(index, truth, diagnosis, seconds, failed)


def _report(out: Path, settings: Json, cases: list[Case], score: ModuleType) -> Json:
    """What is in score.json, which is written and said, and its page."""
    from rig.cli.shared.blind_campaign_page import campaign_dict, campaign_verdict, write_campaign_page
    from rig.formats.output_files import write_text

    told = {"settings": settings, **campaign_dict(cases)}
    print(campaign_verdict(score.campaign_figures(cases)).line)
    write_text(out / "score.json", json.dumps(told, indent=1) + "\n")
    write_campaign_page(out / "score.html", settings, cases)
    for f in score.campaign_figures(cases):
        goal = f", to reach {f.goal:.0%}" if f.goal is not None else ""
        found = (
            f"{f.hits:4} of {f.trials:<4} {f.hits / f.trials:6.1%} ({f.low:.1%} to {f.high:.1%}{goal})"
            if f.trials
            else "   none"
        )
        print(f"{f.name:42}{found}")
    for name, value in score.campaign_medians(cases).items():
        print(f"median {name:35}{value:10.3g}")
    print(f"written: {out / 'score.json'} and {out / 'score.html'}")
    return told
