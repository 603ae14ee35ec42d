"""Experiment planning: inputs of `rig plan`, and the plan of the next experiment after `rig diagnose --next`."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import SEED, Progress
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number

if TYPE_CHECKING:
    import numpy as np

    from calib.models.platform.optimal_configurations import Avoided
    from rig.model.design import Arm, Free, Hexapod, Planar2


def calibrated_geometry_and_avoidance(arguments: Namespace, mechanism: Hexapod) -> tuple[Hexapod, Avoided | None]:
    """Calibrated geometry, and the configurations to avoid by that calibration; the nominal one where none is named.

    Raises RigError for a calibration of another kind of mechanism
    """
    if not arguments.calibration:
        return mechanism, None
    from functools import partial

    from calib.files import calibration_file
    from calib.workspace.reachable_poses import is_pose_lost

    correction = calibration_file.load(arguments.calibration).correction
    if correction.fitted.plates is None:
        raise RigError(
            f"{arguments.calibration} is a calibration of a mechanism of kind {correction.fitted.kind!r}, "
            "not of a hexapod"
        )
    return correction.fitted, partial(is_pose_lost, correction)


def visited_configurations(path: Path, mechanism: Hexapod | Planar2 | Arm | Free) -> np.ndarray:
    """Visited configurations (k, 6) m of a recording or a table. Raises RigError for another kind of mechanism"""
    from rig.formats import csv_table
    from rig.recording import recording_folder

    if path.is_dir():
        read = recording_folder.load_recording(path)
        if read.design.mechanism.plates is None:
            raise RigError(f"{path} is a recording of a mechanism of kind {read.design.mechanism.kind!r}")
        return read.commanded()[2]
    return csv_table.read(path, ("frame", *mechanism.axes)).matrix(mechanism.axes)


if TYPE_CHECKING:
    from calib.experiment.experiment_choice import Experiment
    from calib.experiment.experiment_question import Question
    from rig.model.design import Design

SHOWN = 4  # plans that are compared in words
LONGEST = 6000.0  # min
TELLING = 0.01  # bits; a plan that tells less tells nothing


def add_next_experiment_options(parser: ArgumentParser) -> None:
    """Add the options of the next experiment: --next, --minutes, --may, --standing."""
    parser.add_argument(
        "--next",
        metavar="FILE",
        type=Path,
        help="write the plan of the experiment that would best tell apart what is "
        "still alike (frame,t,payload_mass_kg,l1..l6; `rig simulate --plan commands:FILE` tries it); "
        "next.json says its chance",
    )
    parser.add_argument(
        "--minutes",
        metavar="MIN",
        type=parse_number,
        default=60.0,
        help="for --next: that the experiment may take (default 60)",
    )
    parser.add_argument(
        "--may",
        action="append",
        metavar="payload|wait|'turn cube NAME'",
        help="for --next: what may be asked of an operator, in "
        "place of what rig.toml says under [experiment]; may be given again",
    )
    parser.add_argument(
        "--standing",
        action="store_true",
        help="for --next: only plans at whose exposures the struts stand, as rig run takes them",
    )


def refuse_invalid_experiment_options(arguments: Namespace) -> None:
    """Refuse invalid options of the next experiment, before anything is read.

    Raises RigError where one is given
    """
    if not 0 < arguments.minutes <= LONGEST:
        raise RigError(f"--minutes takes a time above 0 and up to {LONGEST:g} min, not {arguments.minutes:g}")
    if arguments.next is None and (arguments.standing or arguments.may):
        raise RigError("--standing and --may are for --next FILE")
    from rig.model.design import PERMITTED, TURN

    for word in arguments.may or ():
        if word not in PERMITTED and not word.startswith(TURN):
            raise RigError(f"--may takes {', '.join(PERMITTED)} or '{TURN}NAME', not {word!r}")


def _allowed_interventions(arguments: Namespace, design: Design) -> tuple[str, ...]:
    """What an experiment may ask of an operator, cubes by their names. Raises RigError for a cube that the design does
    not have
    """
    from rig.model.cube_remounting import parse_cube_turn_permission

    out = []
    for word in arguments.may or design.experiment.may:
        may, problem = parse_cube_turn_permission(word, design.targets)
        if problem:
            raise RigError(f"--may {word!r}: {problem}")
        out.append(may)
    return tuple(out)


def write_next_experiment_plan(
    arguments: Namespace, questions: Sequence[Question], design: Design, out: Path, progress: Progress
) -> None:
    """Write the plan of the next experiment, which best separates ambiguous findings, and print its probability."""
    from calib.experiment.experiment_choice import available_plans, choose_experiment
    from calib.experiment.experiment_information import camera_information_shares
    from rig.model.cube_remounting import quarter_turns
    from rig.planning import plan_construction_and_table

    experiments: list[Experiment] = []
    seen: dict[str, float] = {}
    if questions:
        seed = SEED + 1 + len(arguments.further)
        texts = available_plans(
            _allowed_interventions(arguments, design), arguments.standing, tuple(quarter_turns(design))
        )
        experiments, refused = choose_experiment(
            questions,
            design,
            texts,
            seed,
            arguments.minutes,
            lambda done, of: progress("foretelling experiments", done, of),
        )
        progress.close()
        experiments = [e for e in experiments if e.bits >= TELLING]
        seen = camera_information_shares(questions, experiments[0].plan) if experiments else {}
        print("\n".join(_odds_lines(questions)))
        print(
            "\n".join(
                _experiment_lines(experiments, seen)
                if experiments
                else [
                    "no plan that is allowed tells these apart",
                    *(f"  {text}: {why}" for text, why in refused.items()),
                ]
            )
        )
    else:
        print("nothing is alike that an experiment could tell apart")
    (out / "next.json").write_text(
        json.dumps(_next_json(questions, experiments, seen), indent=1) + "\n", encoding="utf-8"
    )
    if experiments:
        plan_construction_and_table.write_plan_table(
            arguments.outputs.file(arguments.next), experiments[0].plan, design.mechanism.axes
        )
        print(f"written: {arguments.next}")


def _next_json(
    asked: Sequence[Question], experiments: Sequence[Experiment], seen: dict[str, float]
) -> dict[str, object]:
    """What next.json holds. seen : {camera: share of what the first experiment shows in images}"""
    return {
        "schema": "next/1",
        "questions": [
            {
                "finding": question.named[0].title,
                "unasked": list(question.not_asked),
                "hypotheses": [{"title": h.title, "odds": h.odds} for h in question.hypotheses],
            }
            for question in asked
        ],
        "experiments": [
            {
                "plan": e.text,
                "seed": e.seed,
                "exposures": len(e.plan.t),
                "minutes": e.minutes,
                "bits": e.bits,
                "settles": e.settles,
                "asks": list(e.asks),
            }
            for e in experiments
        ],
        "cameras": seen,
    }


def _odds_lines(asked: Sequence[Question]) -> list[str]:
    """What is alike, with odds."""
    out = ["alike: " + ", ".join(f"{h.title} {h.odds:.2f}" for h in question.hypotheses) for question in asked]
    return out + [f"cannot be foretold: {text}" for question in asked for text in question.not_asked]


def _experiment_lines(experiments: Sequence[Experiment], seen: dict[str, float]) -> list[str]:
    """The best plan, its chance, what it asks of an operator, and the plans that it was preferred to. seen : {camera:
    share of what it shows}
    """
    best = experiments[0]
    out = [
        f"next: {best.text} (seed {best.seed}), {len(best.plan.t)} exposures, {best.minutes:.1f} min; it "
        "settles this with a chance of "
        f"{best.settles:.0%} and tells {best.bits:.2f} bits"
    ]
    out += [f"  operator, {text}" for text in best.asks]
    out += ["  seen by " + ", ".join(f"{name} {share:.0%}" for name, share in seen.items())] if seen else []
    return out + [
        f"  rather than {e.text}: {e.settles:.0%}, {e.bits:.2f} bits in {e.minutes:.1f} min"
        for e in experiments[1:SHOWN]
    ]
