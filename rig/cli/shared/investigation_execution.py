"""Execution of an investigation: plans recorded by machine, driver or hand; at the end the certificate."""

from __future__ import annotations

import hashlib
import json
import tomllib
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError

if TYPE_CHECKING:
    from rig.model.design import Design
    from rig.planning.plan import Plan


class Waiting(Exception):
    """Somebody has to do something before the investigation can go on; the message says what."""


class InvestigationMachine:
    """A machine that can be told to make a recording. by : "machine", "driver" or "hand"; moving : whether it may be
    exposed on the way
    digest : of its rig.toml, but for what experiments may do and how cubes stand, and of a simulated one of its
        truth"""

    def __init__(self, arguments: Namespace, design: Design) -> None:
        self.design, self._arguments = design, arguments
        self.by = "machine" if arguments.machine else "hand" if arguments.by_hand else "driver"
        if self.by == "driver" and design.controller is None:
            raise RigError(
                f"{arguments.design} has no [controller], so there is nothing to drive; --by-hand writes "
                "plans for somebody, --machine "
                "TRUTH tries a simulated machine"
            )
        self.moving = self.by != "driver"
        read = [arguments.design, *([arguments.machine] if arguments.machine else [])]
        for path in read:
            if not path.is_file():
                raise RigError(f"{path}: no such file")
        stated = tomllib.loads(arguments.design.read_text(encoding="utf-8-sig"))
        tree = {name: table for name, table in stated.items() if name not in ("experiment", "turned")}
        parts = [json.dumps(tree, sort_keys=True).encode(), *(path.read_bytes() for path in read[1:])]
        self.digest = hashlib.sha256(b"".join(parts)).hexdigest()

    def call(self, *words: str) -> None:
        """Carry out another command. Raises RigError where it refuses, which has said why"""
        status = self._arguments.call(list(words))
        if status:
            raise RigError(f"rig {words[0]} ended with {status}, see above; --resume goes on from there")

    def refuse(self, plan: Plan) -> None:
        """Raise RigError for a plan that this machine cannot carry out."""
        from rig.driving.run_steps_and_progress import steps_of_plan

        if self.by == "driver":
            steps_of_plan(plan)

    def record(self, plan: Path, out: Path, seed: int) -> None:
        """Have a plan carried out and recorded, unless that is done. Raises Waiting where somebody has to do it"""
        if self.by == "machine":
            if not (out / "frames.csv").exists():
                self.call(
                    "simulate",
                    str(self._arguments.design),
                    "--plan",
                    f"commands:{plan}",
                    "--machine",
                    str(self._arguments.machine),
                    "--seed",
                    str(seed),
                    "--out",
                    str(out),
                )
        elif self.by == "driver":
            self._drive(plan, out)
        elif not (out / "frames.csv").exists():
            raise Waiting(self._asked(plan, out))
        else:
            self._stood(plan, out)

    def _drive(self, plan: Path, out: Path) -> None:
        """Have the driver carry a plan out, from where it was interrupted."""
        from rig.model.cube_remounting import quarter_turns, turning_instructions
        from rig.planning.plan import build_plan

        begun, a = (out / "journal.jsonl").exists(), self._arguments
        if begun and _is_run_complete(out / "journal.jsonl"):
            return
        cubes = dict(build_plan(self.design, f"commands:{plan}").turned)
        todo = turning_instructions(cubes, quarter_turns(self.design))
        if todo:
            then = f"  then say so in {a.design}, {_turned_table(cubes)}, and give the same command with --resume"
            raise Waiting("\n".join(["to do, before the struts move:", *(f"  {text}" for text in todo), then]))
        more = [
            *(["--port", a.port] if a.port else []),
            *(["--no-home"] if a.no_home else []),
            *(["--resume"] if begun else []),
        ]
        self.call(
            "run",
            str(a.design),
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
        from rig.formats.rig_toml import design_file
        from rig.model.cube_remounting import quarter_turns
        from rig.planning.plan import build_plan

        wanted, told = (
            dict(build_plan(self.design, f"commands:{plan}").turned),
            quarter_turns(design_file.load_design(out / "rig.toml")),
        )
        if told != wanted:
            raise RigError(
                f"{plan} is for cubes that stand as {_turned_table(wanted) if wanted else 'rig.toml states them'}, "
                f"and {out / 'rig.toml'} says "
                f"{_turned_table(told) if told else 'that none was taken off'}; state there how they stood"
            )

    def _asked(self, plan: Path, out: Path) -> str:
        """What somebody is asked to do, in words."""
        from rig.model.cube_remounting import turning_instructions
        from rig.planning.plan import build_plan

        todo = build_plan(self.design, f"commands:{plan}")
        cubes = [f"  before it begins: {text}" for text in turning_instructions(dict(todo.turned), {})]
        cubes += [f"  and say so in its rig.toml: {_turned_table(dict(todo.turned))}"] if cubes else []
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


def _turned_table(cubes: dict[str, int]) -> str:
    """How cubes stand, as rig.toml says it."""
    return "[turned] " + ", ".join(f"{name} = {quarter}" for name, quarter in cubes.items())


def _is_run_complete(journal: Path) -> bool:
    """Whether a run's journal says that it came to its end."""
    from rig.driving.run_journal import Ended, read_journal

    rows, _ = read_journal(journal)
    return bool(rows) and isinstance(rows[-1], Ended) and not rows[-1].reason


if TYPE_CHECKING:
    from calib.experiment.investigation_folder import Look

REACH = 0.7  # of the strokes, over which new poses lie: what is corrected has to be reached as well
VERIFYING = 1000  # added to the seed for the new poses


def certify_investigation(
    arguments: Namespace, machine: InvestigationMachine, looks: Sequence[Look]
) -> tuple[str, ...]:
    """Certify an investigation: calibrate, correct, verify on new poses, certify; lines of a report. Raises Waiting

    Where a command refuses, what follows from it is left out, and that is a line
    """
    from calib.experiment.investigation_folder import diagnosis_path, plan_path, recording_path
    from rig.planning.plan import build_plan
    from rig.planning.plan_construction_and_table import write_plan_table

    out, said = arguments.out, []
    recordings = [str(recording_path(out, look.number)) for look in looks]
    calibration, number = out / "calibration.json", len(looks)
    poses, commands, plan, again = (
        out / f"verify{number}{suffix}" for suffix in ("-poses.csv", "-commands.csv", ".csv", "")
    )
    done = plan.exists()
    try:
        if not done:
            machine.call(
                "calibrate", *recordings, "--diagnosis", str(diagnosis_path(out, number)), "--out", str(calibration)
            )
    except RigError as error:
        return (f"not calibrated: {error}",)
    found = ", ".join(looks[-1].findings) or "no physics"
    said.append(f"{calibration.name}: of {len(recordings)} recording{'s' * (len(recordings) > 1)}, with {found}")
    try:
        if not done:
            _write_verification_poses(poses, machine, arguments, calibration)
            machine.call(
                "correct",
                str(calibration),
                "--poses",
                str(poses),
                "--out",
                str(commands),
                "--skip-unreachable",
                "--force",
            )
            stands = build_plan(
                machine.design, f"commands:{plan_path(out, number)}"
            ).turned  # cubes stay as they were put back
            write_plan_table(
                plan,
                replace(build_plan(machine.design, f"commands:{commands}"), turned=stands),
                machine.design.mechanism.axes,
            )
        machine.record(plan, again, arguments.seed + VERIFYING)
        machine.call("verify", str(calibration), str(again))
        said.append(f"verified on new poses, commanded through the correction: {again.name}")
    except RigError as error:
        return (*said, f"not verified: {error}")
    try:
        machine.call("certify", str(calibration), str(again), "--out", str(out / "certificate"))
        said.append("certificate")
    except RigError as error:
        said.append(f"no certificate: {error}")
    return tuple(said)


def _write_verification_poses(path: Path, rig: InvestigationMachine, arguments: Namespace, calibration: Path) -> None:
    """Write new poses all over what the axes reach; of an arm as its calibration has it, in the instrument's own
    frame.
    """
    import numpy as np

    from rig.model import mechanisms
    from rig.model.mechanism_kinds import require_arm
    from rig.planning.configuration_sets import sobol_configurations
    from rig.planning.plan import axis_strokes
    from rig.recording.recording_folder import Poses
    from rig.recording.recording_tables import write_poses

    m = rig.design.mechanism
    lengths = sobol_configurations(axis_strokes(rig.design), arguments.verify, REACH, arguments.seed + VERIFYING)
    if m.link_rows is not None:
        from calib.files import calibration_file
        from calib.models.arm import error_model

        T = error_model.predicted_target_poses(
            lengths, require_arm(calibration_file.load(calibration).correction.fitted)
        )
    else:
        T = mechanisms.kinematics_of(m).forward(lengths, m)
    write_poses(path, Poses(np.arange(len(lengths)), T, None))
