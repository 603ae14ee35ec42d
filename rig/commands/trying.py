"""Who carries out the plans of an investigation: a simulated machine, the driver, or somebody by hand."""

from __future__ import annotations

import hashlib
import json
import tomllib
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError

if TYPE_CHECKING:
    from rig.design import Design
    from rig.plan import Plan


class Waiting(Exception):
    """Somebody has to do something before the investigation can go on; the message says what."""


class Rig:
    """A machine that can be told to make a recording. by : "machine", "driver" or "hand"; moving : whether it may be exposed on the way
    digest : of its rig.toml, but for what experiments may do, and of a simulated one of its truth"""

    def __init__(self, arguments: Namespace, design: Design) -> None:
        self.design, self._arguments = design, arguments
        self.by = "machine" if arguments.machine else "hand" if arguments.by_hand else "driver"
        if self.by == "driver" and design.controller is None:
            raise RigError(f"{arguments.design} has no [controller], so there is nothing to drive; --by-hand writes plans for somebody, --machine "
                           "TRUTH tries a simulated machine")
        self.moving = self.by != "driver"
        read = [arguments.design, *([arguments.machine] if arguments.machine else [])]
        for path in read:
            if not path.is_file():
                raise RigError(f"{path}: no such file")
        tree = {name: table for name, table in tomllib.loads(arguments.design.read_text(encoding="utf-8-sig")).items() if name != "experiment"}
        parts = [json.dumps(tree, sort_keys=True).encode(), *(path.read_bytes() for path in read[1:])]
        self.digest = hashlib.sha256(b"".join(parts)).hexdigest()

    def call(self, *words: str) -> None:
        """Carry out another command. Raises RigError where it refuses, which has said why"""
        status = self._arguments.call(list(words))
        if status:
            raise RigError(f"rig {words[0]} ended with {status}, see above; --resume goes on from there")

    def refuse(self, plan: Plan) -> None:
        """Raise RigError for a plan that this machine cannot carry out."""
        from rig.steps import steps

        if self.by == "driver":
            steps(plan)

    def record(self, plan: Path, out: Path, seed: int) -> None:
        """Have a plan carried out and recorded, unless that is done. Raises Waiting where somebody has to do it"""
        if self.by == "machine":
            if not (out / "frames.csv").exists():
                self.call("simulate", str(self._arguments.design), "--plan", f"commands:{plan}", "--machine", str(self._arguments.machine), "--seed",
                          str(seed), "--out", str(out))
        elif self.by == "driver":
            self._drive(plan, out)
        elif not (out / "frames.csv").exists():
            raise Waiting(self._asked(plan, out))

    def _drive(self, plan: Path, out: Path) -> None:
        """Have the driver carry a plan out, from where it was interrupted."""
        begun, a = (out / "journal.jsonl").exists(), self._arguments
        if begun and _done(out / "journal.jsonl"):
            return
        more = [*(["--port", a.port] if a.port else []), *(["--no-home"] if a.no_home else []), *(["--resume"] if begun else [])]
        self.call("run", str(a.design), "--plan", f"commands:{plan}", "--out", str(out), "--settle", a.settle, "--no-measure", *more)

    def _asked(self, plan: Path, out: Path) -> str:
        """What somebody is asked to do, in words."""
        from rig.plan import build

        todo = build(self.design, f"commands:{plan}")
        loads = [f"  at t = {t:.0f} s: " + (f"load {mass:.3g} kg" if mass else "take the load off") for t, mass in todo.payload[1:]]
        return "\n".join([f"to do: carry out {plan} ({len(todo.t)} exposures, where a row has a frame; {todo.commands.t[-1] / 60:.1f} min) and "
                          f"record it as {out}, with its own commands.csv and frames.csv; then the same command with --resume", *loads])


def _done(journal: Path) -> bool:
    """Whether a run's journal says that it came to its end."""
    from rig.journal import Ended, read

    rows, _ = read(journal)
    return bool(rows) and isinstance(rows[-1], Ended) and not rows[-1].reason
