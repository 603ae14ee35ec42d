"""rig simulate blind: simulate blind cases.

They are diagnosed, and the answers are scored.
"""

from __future__ import annotations

import json
import os
import sys
import time
from argparse import ArgumentParser, Namespace
from pathlib import Path
from subprocess import CompletedProcess

from rig.array_and_json_types import Json
from rig.cli.shared import blind_case_process
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_overwrite_option,
    open_worker_pool,
    results_with_progress,
)
from rig.compute.worker_processes import run_child_process
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_whole_number

ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")}
ROOT = Path(__file__).parents[2]  # children run the code that runs here, wherever they stand
KILLED = -9  # exit status of a process that was killed (SIGKILL)
INTERRUPTED = (130, -2, KILLED, -15)  # exit statuses of a process that somebody stopped


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig simulate blind` to a parser."""
    parser.add_argument("--season", type=parse_whole_number, required=True, metavar="N", help="how many cases")
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        required=True,
        help="recordings, hashes, truth, diagnoses and score are stored there; "
        "an interrupted campaign resumes where it stopped",
    )
    parser.add_argument("--seed", type=parse_whole_number, default=0, help="another seed gives another campaign")
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
        "--effects", metavar="NAMES", default="", help="effects to draw from, separated by commas (default all)"
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
        help="covariates to withhold, separated by commas: temperature, payload, reversals, motion",
    )
    parser.add_argument(
        "--images",
        action="store_true",
        help="draw images: three resolutions, two lenses, blur, defocus, noise, vignetting, markers "
        "with printing errors; effects visible in images (needs OpenGL)",
    )
    parser.add_argument("--again", action="store_true", help="repeat diagnoses that are complete")
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig simulate blind`.

    Draw blind cases, diagnose each without its truth, and score the campaign.
    """
    from synthetic.blind_campaign import Campaign, CampaignOptions, parse_case_numbers

    a = arguments
    arm = a.mechanism == "arm"
    options = CampaignOptions(a.season, a.seed, a.frames, a.hide, a.effects, a.withhold, arm, a.images)
    settings, indices = options.settings(), parse_case_numbers(a.cases, a.season)
    out = a.outputs.growing(a.out, own=(a.out / "campaign.json").exists()).resolve()
    campaign = Campaign(out, lambda text: print(text, file=sys.stderr))
    campaign.begin(settings)
    with open_worker_pool() as workers:
        undrawn = [(str(out), i, settings) for i in campaign.undrawn(indices)]
        for _ in results_with_progress(workers, _drawn, undrawn, "drawing"):
            pass
        waiting = [(str(out), i) for i in indices if a.again or campaign.record(i) is None]
        for index, _, error in results_with_progress(workers, _diagnosed, waiting, "diagnosing"):
            if error:
                print(f"case {index} could not be diagnosed: {error.splitlines()[-1]}", file=sys.stderr)
    result = campaign.score(settings)
    result.write(out)
    print("\n".join([result.verdict.line, *result.lines()]))
    print(f"written: {out / 'score.json'} and {out / 'score.html'}")
    arguments.result = {"schema": "campaign/1", **result.tree()}


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
    command: list[str | Path] = [
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
        return index, seconds, "stopped; it will be diagnosed when the campaign is resumed"
    error = None if done.returncode == 0 else done.stderr.strip() or f"exit status {done.returncode}"
    write_text(record, json.dumps({"seconds": round(seconds, 2), "failed": error}) + "\n")
    return index, seconds, error


def _child(command: list[str | Path]) -> CompletedProcess[str]:
    """A process of `blind_case_process` once it has ended; one that is ended from outside, as a system does that is
    short of memory, is begun once more.
    """
    words = [sys.executable, "-P", "-m", blind_case_process.__name__, str(os.getpid()), *map(str, command)]
    done = run_child_process(words, _environment())
    return run_child_process(words, _environment()) if done.returncode == KILLED else done


def _environment() -> dict[str, str]:
    """Of a child: one thread, and this code before any other."""
    return {
        **os.environ,
        **ONE_THREAD,
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]),
    }
