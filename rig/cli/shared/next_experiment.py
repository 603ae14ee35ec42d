"""The next experiment on the command line: what is alike in words, the plan that tells it apart, and the chance that it
does.
"""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.output_options import SEED, Progress
from rig.errors import RigError
from rig.formats.number_parsing import parse_number

if TYPE_CHECKING:
    from calib.experiment.experiment_choice import Experiment
    from calib.experiment.experiment_question import Question
    from rig.model.design import Design

SHOWN = 4  # plans that are compared in words
LONGEST = 6000.0  # min
TELLING = 0.01  # bits; a plan that tells less tells nothing


def arguments(parser: ArgumentParser) -> None:
    """Add --next, how long it may take and what it may do."""
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


def refuse_invalid_options(arguments: Namespace) -> None:
    """Raise RigError for options that cannot be meant, before anything is read."""
    if not 0 < arguments.minutes <= LONGEST:
        raise RigError(f"--minutes takes a time above 0 and up to {LONGEST:g} min, not {arguments.minutes:g}")
    if arguments.next is None and (arguments.standing or arguments.may):
        raise RigError("--standing and --may are for --next FILE")
    from rig.model.design import PERMITTED, TURN

    for word in arguments.may or ():
        if word not in PERMITTED and not word.startswith(TURN):
            raise RigError(f"--may takes {', '.join(PERMITTED)} or '{TURN}NAME', not {word!r}")


def allowed_interventions(arguments: Namespace, design: Design) -> tuple[str, ...]:
    """What an experiment may ask of an operator, cubes by their names. Raises RigError for a cube that the design does
    not have
    """
    from rig.model.cube_remounting import parse_permission

    out = []
    for word in arguments.may or design.experiment.may:
        may, problem = parse_permission(word, design.targets)
        if problem:
            raise RigError(f"--may {word!r}: {problem}")
        out.append(may)
    return tuple(out)


def write_next_plan(
    arguments: Namespace, asked: Sequence[Question], design: Design, out: Path, progress: Progress
) -> None:
    """Write the plan that would tell best what a diagnosis leaves alike, and say its chance; say so where nothing is,
    or no plan would.
    """
    from calib.experiment.discriminating_configurations import camera_shares
    from calib.experiment.experiment_choice import available_plans, choose_experiment
    from rig.model.cube_remounting import quarter_turns
    from rig.planning import plan_table

    experiments: list[Experiment] = []
    seen: dict[str, float] = {}
    if asked:
        seed = SEED + 1 + len(arguments.further)
        texts = available_plans(
            allowed_interventions(arguments, design), arguments.standing, tuple(quarter_turns(design))
        )
        experiments, refused = choose_experiment(
            asked,
            design,
            texts,
            seed,
            arguments.minutes,
            lambda done, of: progress("foretelling experiments", done, of),
        )
        progress.close()
        experiments = [e for e in experiments if e.bits >= TELLING]
        seen = camera_shares(asked, experiments[0].plan) if experiments else {}
        print("\n".join(odds_lines(asked)))
        print(
            "\n".join(
                experiment_lines(experiments, seen)
                if experiments
                else [
                    "no plan that is allowed tells these apart",
                    *(f"  {text}: {why}" for text, why in refused.items()),
                ]
            )
        )
    else:
        print("nothing is alike that an experiment could tell apart")
    (out / "next.json").write_text(json.dumps(_tree(asked, experiments, seen), indent=1) + "\n", encoding="utf-8")
    if experiments:
        plan_table.write_plan(arguments.outputs.file(arguments.next), experiments[0].plan, design.mechanism.axes)
        print(f"written: {arguments.next}")


def _tree(asked: Sequence[Question], experiments: Sequence[Experiment], seen: dict[str, float]) -> dict[str, object]:
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


def odds_lines(asked: Sequence[Question]) -> list[str]:
    """What is alike, with odds."""
    out = ["alike: " + ", ".join(f"{h.title} {h.odds:.2f}" for h in question.hypotheses) for question in asked]
    return out + [f"cannot be foretold: {text}" for question in asked for text in question.not_asked]


def experiment_lines(experiments: Sequence[Experiment], seen: dict[str, float]) -> list[str]:
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
