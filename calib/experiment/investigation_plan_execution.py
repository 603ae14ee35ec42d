"""Execution of an investigation's plans.

By a simulated machine, the driver, or somebody by hand.
"""

import hashlib
import json
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.driving.run_journal import Ended, read_journal_rows_and_valid_length
from rig.driving.run_steps_from_plan_and_progress_from_journal import steps_of_plan
from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Design, quarter_turns_of_cubes
from rig.model.design_contradictions_and_cube_quarter_turns import turning_instructions
from rig.planning.recording_plan import build_plan
from rig.planning.timed_plan_and_visiting_order import Plan

Command = Callable[[Sequence[str]], int]  # words of a command of rig -> its exit status


class Waiting(Exception):
    """Somebody has to do something before the investigation can go on; the message says what."""


@dataclass(frozen=True, slots=True)
class InvestigateOptions:
    """budget : min of the rig's time; machine : truth file of a simulated machine, or by_hand : whether somebody does
    the moves; else the rig's [controller] is driven
    plan : the first one, None for one that suits the rig; seed : of plans, and of a simulated machine's noise; verify :
    new poses by which the calibration is verified
    port, settle, no_home : as for `rig run`; resume : whether to go on with a folder that is there
    """

    budget: float = 120.0
    machine: Path | None = None
    by_hand: bool = False
    plan: str | None = None
    seed: int = 0
    verify: int = 60
    port: str | None = None
    settle: str = "time:1"
    no_home: bool = False
    resume: bool = False

    def __post_init__(self) -> None:
        if not 12 <= self.verify <= 400:
            raise RigError(f"--verify must be 12 to 400 poses, not {self.verify}")


class InvestigatedRig:
    """A machine that can be told to make a recording. by : "machine", "driver" or "hand"; moving : whether it may be
    exposed on the way
    digest : of its rig.toml, but for what experiments may do and how cubes stand, and of a simulated one of its
        truth"""

    def __init__(self, rig_toml: Path, design: Design, options: InvestigateOptions, command: Command) -> None:
        self.path, self.design, self.options, self._command = rig_toml, design, options, command
        self.by = "machine" if options.machine else "hand" if options.by_hand else "driver"
        if self.by == "driver" and design.controller is None:
            raise RigError(
                f"{rig_toml} has no [controller], so no machine can be driven; --by-hand writes "
                "plans to be carried out by hand, --machine "
                "TRUTH uses a simulated machine"
            )
        self.moving = self.by != "driver"
        read = [rig_toml, *([options.machine] if options.machine else [])]
        for path in read:
            if not path.is_file():
                raise RigError(f"{path}: no such file")
        stated = tomllib.loads(rig_toml.read_text(encoding="utf-8-sig"))
        tree = {name: table for name, table in stated.items() if name not in ("experiment", "turned")}
        parts = [json.dumps(tree, sort_keys=True).encode(), *(path.read_bytes() for path in read[1:])]
        self.digest = hashlib.sha256(b"".join(parts)).hexdigest()

    def call(self, *words: str) -> None:
        """Carry out a command of rig. Raises RigError where it refuses, which has said why"""
        status = self._command(list(words))
        if status:
            raise RigError(f"rig {words[0]} ended with {status}, see above; --resume continues from there")

    def refuse(self, plan: Plan) -> None:
        """Raise RigError for a plan that this machine cannot carry out."""
        if self.by == "driver":
            steps_of_plan(plan)

    def record(self, plan: Path, out: Path, seed: int) -> None:
        """Have a plan carried out and recorded, unless that is done. Raises Waiting where somebody has to do it"""
        if self.by == "machine":
            if not (out / "frames.csv").exists():
                self.call(
                    "simulate",
                    str(self.path),
                    "--plan",
                    f"commands:{plan}",
                    "--machine",
                    str(self.options.machine),
                    "--seed",
                    str(seed),
                    "--out",
                    str(out),
                )
        elif self.by == "driver":
            self._drive(plan, out)
        elif not (out / "frames.csv").exists():
            raise Waiting(self._request_text(plan, out))
        else:
            self._stood(plan, out)

    def _drive(self, plan: Path, out: Path) -> None:
        """Have the driver carry a plan out, from where it was interrupted."""
        begun, a = (out / "journal.jsonl").exists(), self.options
        if begun and _done(out / "journal.jsonl"):
            return
        cubes = dict(build_plan(self.design, f"commands:{plan}").turned)
        todo = turning_instructions(cubes, quarter_turns_of_cubes(self.design))
        if todo:
            then = f"  then state this in {self.path}, {_cube_text(cubes)}, and give the same command with --resume"
            raise Waiting("\n".join(["to do, before the struts move:", *(f"  {text}" for text in todo), then]))
        more = [
            *(["--port", a.port] if a.port else []),
            *(["--no-home"] if a.no_home else []),
            *(["--resume"] if begun else []),
        ]
        self.call(
            "run",
            str(self.path),
            "--plan",
            f"commands:{plan}",
            "--out",
            str(out),
            "--settle",
            a.settle,
            "--no-measure",
            *more,
        )

    def _stood(self, plan: Path, out: Path) -> None:
        """Raise RigError where a recording by hand does not say that cubes stood as its plan has them."""
        wanted, stated = (
            dict(build_plan(self.design, f"commands:{plan}").turned),
            quarter_turns_of_cubes(design_from_rig_toml.load_design(out / "rig.toml")),
        )
        if stated != wanted:
            raise RigError(
                f"{plan} is for cubes mounted as {_cube_text(wanted) if wanted else 'rig.toml states them'}, "
                f"and {out / 'rig.toml'} says "
                f"{_cube_text(stated) if stated else 'that none was removed'}; state there how they were mounted"
            )

    def _request_text(self, plan: Path, out: Path) -> str:
        """What somebody is asked to do, in words."""
        todo = build_plan(self.design, f"commands:{plan}")
        cubes = [f"  before it begins: {text}" for text in turning_instructions(dict(todo.turned), {})]
        cubes += [f"  and state this in its rig.toml: {_cube_text(dict(todo.turned))}"] if cubes else []
        loads = [
            f"  at t = {t:.0f} s: " + (f"load {mass:.3g} kg" if mass else "take the load off")
            for t, mass in todo.payload[1:]
        ]
        return "\n".join(
            [
                f"to do: carry out {plan} ({len(todo.t)} exposures, where a row has a frame; "
                f"{todo.commands.t[-1] / 60:.1f} min) and "
                f"record it as {out}, with its own commands.csv and frames.csv; then the same command with --resume",
                *cubes,
                *loads,
            ]
        )


def _cube_text(cubes: dict[str, int]) -> str:
    """How cubes stand, as rig.toml says it."""
    return "[turned] " + ", ".join(f"{name} = {quarter}" for name, quarter in cubes.items())


def _done(journal: Path) -> bool:
    """Whether a run's journal says that it came to its end."""
    rows, _ = read_journal_rows_and_valid_length(journal)
    return bool(rows) and isinstance(rows[-1], Ended) and not rows[-1].reason
