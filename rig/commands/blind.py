"""rig blind --season N --out DIR."""

from __future__ import annotations

import json
import os
import re
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from rig import json_file
from rig.commands.output import add_force
from rig.commands.workers import each, pool
from rig.errors import FileError, RigError
from rig.outside import read_bytes, shown
from rig.processes import cores, finished

if TYPE_CHECKING:
    from types import ModuleType

    import numpy as np

    from synthetic.score import Case

ALONE = "import sys; from rig.processes import end_with; end_with(int(sys.argv[1])); "  # a child does not outlive this process
DIAGNOSE = ALONE + "from rig.commands.sealed import forbid; from rig.cli import main; forbid(sys.argv[2]); sys.exit(main(sys.argv[3:]))"
SEAL = ALONE + "import json; from rig.commands.blind import seal; seal(*json.loads(sys.argv[2]))"
ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")}
ROOT = Path(__file__).parents[2]  # children run the code that runs here, wherever they stand
MOST, MOST_FRAMES = 1_000_000, 10_000  # trials of a season, frames of a trial
INTERRUPTED = (130, -2, -9, -15)  # exit statuses of a process that somebody stopped


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("--season", type=int, required=True, metavar="N", help="how many trials")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="recordings, seals, truth, diagnoses and score are kept there; "
                        "a season that was interrupted goes on where it stopped")
    parser.add_argument("--seed", type=int, default=0, help="another seed is another season")
    parser.add_argument("--trials", metavar="LIST", help="only these of the season, for example 3,7-9")
    parser.add_argument("--frames", type=int, help="of each recording, about (default 380; 40 in images)")
    parser.add_argument("--hide", metavar="KINDS", help="what trials may hide (default all): nothing, one, two effects; of hexapods also "
                        "something foreign to the catalogue (foreign), disturbed noise (noise), not in images")
    parser.add_argument("--effects", metavar="NAMES", default="", help="effects to draw from, joined by commas (default all)")
    parser.add_argument("--mechanism", choices=("hexapod", "arm"), default="hexapod", help="of the rigs (default hexapod): an arm's trials hide "
                        "nothing, one or two effects of its joints, a third of them under real recordings' hardships; no --blindfold")
    parser.add_argument("--blindfold", metavar="WHAT", default="", help="take away, joined by commas: temperature, payload, reversals, motion")
    parser.add_argument("--images", action="store_true", help="draw images: three resolutions, two lenses, blur, defocus, noise, vignetting, markers "
                        "printed as printers print; effects that pictures show (needs OpenGL)")
    parser.add_argument("--again", action="store_true", help="diagnose anew what has been diagnosed")
    parser.add_argument("--jobs", type=int, default=cores(), help="processes at a time (default all cores)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that sees the same folders, instead of this machine's cores")
    add_force(parser)


def run(arguments: Namespace) -> None:
    """Seal the trials, diagnose each in a process that cannot read the truth, unseal and score."""
    from synthetic import blind, blind_arm, score

    settings = _settings(arguments, blind, blind_arm)
    indices = _indices(arguments.trials, arguments.season)
    out = arguments.outputs.growing(arguments.out, own=(arguments.out / "season.json").exists()).resolve()
    _same_season(out / "season.json", settings)
    for name in ("recordings", "seals", "truth", "diagnoses"):
        (out / name).mkdir(exist_ok=True)
    with pool(arguments.scheduler, arguments.jobs) as workers:
        unsealed = [i for i in indices if _digest(out, i) is None]
        for index in unsealed:  # what was diagnosed of another drawing is no answer to this one
            (out / "diagnoses" / f"{index:04d}.json").unlink(missing_ok=True)
        for _ in each(workers, _sealed, [(str(out), i, settings) for i in unsealed], "sealing"):
            pass
        waiting = [i for i in indices if arguments.again or _record(out, i) is None]
        for index, _, error in each(workers, _diagnosed, [(str(out), i) for i in waiting], "diagnosing"):
            if error:
                print(f"trial {index} could not be diagnosed: {error.splitlines()[-1]}", file=sys.stderr)
    sealed = [int(path.stem) for path in (out / "seals").glob("*.sha256") if path.stem.isdigit()]
    known = sorted(i for i in sealed if _digest(out, i) is not None and _record(out, i) is not None)
    cases = [_unsealed(out, i, score) for i in known]
    _report(out, settings, cases, score)


def _settings(arguments: Namespace, blind: ModuleType, blind_arm: ModuleType) -> dict:
    """What makes a season: all that its recordings depend on."""
    from rig.effects import BY_NAME
    from synthetic import blind_images
    from synthetic.pictures import drawable

    if not 1 <= arguments.season <= MOST or arguments.jobs < 1 or not 0 <= arguments.seed < 1 << 63:
        raise RigError(f"--season takes 1 to {MOST}, --jobs at least 1, --seed at least 0 and below 2^63")
    arm = arguments.mechanism == "arm"
    if arm and arguments.images:
        raise RigError("--images are of hexapods; an arm's trials are poses: leave one of --images and --mechanism out")
    default = blind_arm.FRAMES if arm else blind_images.FRAMES if arguments.images else blind.FRAMES
    frames = default if arguments.frames is None else arguments.frames
    if not 40 <= frames <= MOST_FRAMES:
        raise RigError(f"--frames must be at least 40 and at most {MOST_FRAMES}, not {frames}: a diagnosis takes some poses")
    kinds = blind_arm.KINDS if arm else blind.KINDS
    hide = ",".join(kinds) if arguments.hide is None else arguments.hide
    texts = {"hide": hide, "effects": arguments.effects, "blindfold": arguments.blindfold}
    lists = {name: [part.strip() for part in text.split(",") if part.strip()] for name, text in texts.items()}
    for name, known in (("hide", kinds), ("effects", BY_NAME), ("blindfold", blind.BLINDFOLDS)):
        for part in lists[name]:
            if part not in known:
                raise RigError(f"--{name}: there is no {part!r}; there are {', '.join(known)}")
    able = blind_images.KINDS if arguments.images else kinds
    lists["hide"] = [kind for kind in lists["hide"] if kind in able]
    if not lists["hide"]:
        raise RigError(f"--hide takes some of {', '.join(able)}")
    if arm and lists["blindfold"]:
        raise RigError("--blindfold takes covariates of a hexapod away; with --mechanism arm leave it out")
    unseen = [name for name in lists["effects"] if arguments.images and not drawable(BY_NAME[name])]
    if unseen:
        raise RigError(f"--effects: pictures do not show {', '.join(unseen)}, only corners do; leave --images out")
    more = {"mechanism": "arm"} if arm else {"images": True} if arguments.images else {}
    return {"seed": arguments.seed, "frames": frames, **more, **lists}


def _indices(text: str | None, count: int) -> list[int]:
    """The trials asked for: all of 1..count, or those of a list like 3,7-9."""
    if text is None:
        return list(range(1, count + 1))
    try:
        ranges = [[int(end) for end in part.split("-")] for part in text.split(",")]
    except ValueError:
        raise RigError(f"--trials takes for example 3,7-9, not {shown(text)}") from None
    if any(len(ends) > 2 or not 1 <= ends[0] <= ends[-1] <= count for ends in ranges):
        raise RigError(f"--trials {shown(text)}: the season has trials 1 to {count}, and a range runs from small to large")
    return sorted({i for ends in ranges for i in range(ends[0], ends[-1] + 1)})


def _same_season(path: Path, settings: dict) -> None:
    """Write what makes this season, or raise RigError where the folder holds another."""
    from rig.files import write_text

    if path.exists():
        held = json_file.load(path, "season").tree
        other = [name for name in {**settings, **held} if held.get(name) != settings.get(name)]
        if other:
            told = ", ".join(f"{n} {shown(held.get(n))} (not {settings.get(n)!r})" for n in other)
            raise RigError(f"{path.parent} holds another season, with {told}")
    write_text(path, json.dumps(settings, indent=1) + "\n")


def seal(out: Path, index: int, settings: dict) -> None:
    """Draw a trial and write its recording, its truth, and last the truth's hash: from then on the trial is sealed."""
    from rig.files import Outputs, write_text

    out = Path(out)
    folder, truth = out / "recordings" / f"{index:04d}", out / "truth" / f"{index:04d}.json"
    trial_of = _arm_trial if settings.get("mechanism") == "arm" else _trial
    with Outputs("blind", force=True) as outputs:
        write_truth, strengths = trial_of(index, settings, outputs.folder(folder))
    write_truth(truth, index=index, settings=settings, strengths=strengths.tolist())
    write_text(_seal(out, index), f"{sha256(truth.read_bytes()).hexdigest()}  ../truth/{truth.name}\n")


def _trial(index: int, settings: dict, folder: Path) -> tuple[Callable[..., None], np.ndarray]:
    """(what writes the truth of a hexapod's trial, its effects' strengths), its recording written."""
    from calib.diagnose.problems.platform.strength import strengths
    from rig import recording
    from synthetic import blind

    trial = blind.draw(settings["seed"], index, settings["frames"], settings["blindfold"], settings["hide"], settings["effects"],
                       settings.get("images", False))
    blind.write_recording(trial, folder)
    world, written = trial.simulation.world, recording.load(folder)
    written = written if trial.eyes is None else replace(written, corners=blind.corners_of(trial))
    values = strengths(written, world.true, trial.noise, world.effects, trial.simulation.sensors)[: len(trial.hidden)]
    return partial(blind.write_truth, trial), values


def _arm_trial(index: int, settings: dict, folder: Path) -> tuple[Callable[..., None], np.ndarray]:
    """The same of an arm's trial."""
    from calib.diagnose.problems.arm.strength import strengths
    from synthetic import blind_arm

    trial = blind_arm.draw(settings["seed"], index, settings["frames"], settings["hide"], settings["effects"])
    blind_arm.write_recording(trial, folder)
    done = trial.simulation
    seen = trial.sigma[: 1 if "positions" in trial.hard else 2]
    return partial(blind_arm.write_truth, trial), strengths(done.world.true, done.plan.commands, done.plan.t, seen, done.world.effects, done.sensors)


def _sealed(out: Path, index: int, settings: dict) -> None:
    done = finished([sys.executable, "-P", "-c", SEAL, str(os.getpid()), json.dumps([out, index, settings])], _environment())
    if done.returncode:
        raise RigError(f"trial {index} could not be sealed: {done.stderr.strip() or 'stopped'}")


def _diagnosed(out: Path, index: int) -> tuple[int, float, str | None]:
    """(index, seconds, error or None) of the diagnosis of one trial, in a process to which the truth is closed."""
    from rig.files import write_text

    out = Path(out)
    target, record = out / "diagnoses" / f"{index:04d}", out / "diagnoses" / f"{index:04d}.json"
    (target / "diagnosis.json").unlink(missing_ok=True)
    record.unlink(missing_ok=True)
    start = time.monotonic()
    command = [sys.executable, "-P", "-c", DIAGNOSE, str(os.getpid()), out / "truth", "diagnose", out / "recordings" / f"{index:04d}", "--out",
               target, "--force"]
    done = finished(command, _environment())
    seconds = time.monotonic() - start
    if done.returncode in INTERRUPTED:
        return index, seconds, "stopped; it will be diagnosed when the season goes on"
    error = None if done.returncode == 0 else done.stderr.strip() or f"exit status {done.returncode}"
    write_text(record, json.dumps({"seconds": round(seconds, 2), "failed": error}) + "\n")
    return index, seconds, error


def _environment() -> dict[str, str]:
    """Of a child: one thread, and this code before any other."""
    return {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])}


def _seal(out: Path, index: int) -> Path:
    return out / "seals" / f"{index:04d}.sha256"


def _digest(out: Path, index: int) -> str | None:
    """What a trial's seal says, or None where there is none or it is torn, which is said: the trial is then sealed anew, the same by its seed."""
    path = _seal(out, index)
    if not path.exists():
        return None
    found = re.match(rb"[0-9a-f]{64}\b", read_bytes(path))
    if found is None:
        print(f"trial {index}: {path} holds no sha256; it is sealed anew", file=sys.stderr)
    return found and found[0].decode()


def _record(out: Path, index: int) -> tuple[float, str | None] | None:
    """(seconds, error or None) of a trial's diagnosis, or None where there is none or it is torn, which is said: it is then diagnosed anew."""
    path = out / "diagnoses" / f"{index:04d}.json"
    if not path.exists():
        return None
    try:
        table = json_file.load(path, "record of a diagnosis")
        return table.number("seconds", least=0), None if table.get("failed") is None else table.text("failed")
    except FileError as error:
        print(f"trial {index}: it is diagnosed anew: {error}", file=sys.stderr)
        return None


def _unsealed(out: Path, index: int, score: ModuleType) -> Case:
    """score.Case of a trial. Raises RigError where the truth is not what was sealed."""
    truth, record = out / "truth" / f"{index:04d}.json", _record(out, index)
    if not truth.exists() or sha256(read_bytes(truth)).hexdigest() != _digest(out, index):
        raise RigError(f"{truth} is not what was sealed before the diagnosis; take the trial out of the season")
    seconds, failed = record
    diagnosis = None if failed else out / "diagnoses" / f"{index:04d}" / "diagnosis.json"
    return score.case(index, truth, diagnosis, seconds, failed)


def _report(out: Path, settings: dict, cases: list[Case], score: ModuleType) -> None:
    from rig.commands.blind_page import season_page, tree
    from rig.files import write_text

    write_text(out / "score.json", json.dumps({"settings": settings, **tree(cases)}, indent=1) + "\n")
    season_page(out / "score.html", settings, cases)
    for f in score.figures(cases):
        goal = f", to reach {f.goal:.0%}" if f.goal is not None else ""
        found = f"{f.hits:4} of {f.trials:<4} {f.hits / f.trials:6.1%} ({f.low:.1%} to {f.high:.1%}{goal})" if f.trials else "   none"
        print(f"{f.name:42}{found}")
    for name, value in score.medians(cases).items():
        print(f"median {name:35}{value:10.3g}")
    print(f"written: {out / 'score.json'} and {out / 'score.html'}")
