"""rig plan: plan which configurations to visit, for parameters, a promised accuracy, or to separate effects."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rig.cli.shared.command_options import (
    SEED,
    Progress,
    add_json_result_option,
    add_overwrite_option,
    add_page_option,
    file_or_stdout,
    page_links,
    page_path,
    parse_length,
)
from rig.cli.shared.experiment_planning import calibrated_geometry_and_avoidance, visited_configurations
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number, parse_whole_number
from rig.report.verdict import Evidence, Missing, judge_evidence

if TYPE_CHECKING:
    import numpy as np

    from rig.model.design import Arm, Chain, Design, Planar2

SHOWN = 8  # combinations that are listed
LEAST = 3.0  # standard deviations by which effects must differ to be told apart
MOVES = (
    "sobol:40",
    "ladder:12",
    "moving:40",
    "zigzag:40",
    "payload:16",
    "axes:5",
    "repeat:40",
)  # parts of plans that may tell effects apart


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    asked = parser.add_mutually_exclusive_group(required=True)
    asked.add_argument("--for", dest="purpose", choices=tuple(PURPOSES), help="what the plan is to find out")
    asked.add_argument(
        "--separate",
        nargs=2,
        metavar=("EFFECT", "EFFECT"),
        help="which moves tell two effects apart, each written as for "
        "rig simulate --effect, as large as it is expected: OUT gets t,l1..l6 of the best plan",
    )
    asked.add_argument(
        "--promise",
        type=parse_length,
        metavar="20um",
        help="the fewest and best poses after which the corrected machine keeps to so much, "
        "RMS over its workspace; beside those --given the next best ones, in the order in which they help",
    )
    asked.add_argument(
        "--parts",
        metavar="PARTS",
        help="parts of a plan as for rig simulate --plan, at whose exposures the struts stand, written as "
        "configurations: axes:5,combined:4 goes along and about X, Y and Z, and turns while it moves along each",
    )
    parser.add_argument("--count", type=parse_whole_number, default=60, help="configurations to choose (default 60)")
    parser.add_argument(
        "--criterion",
        choices=("determinant", "noise"),
        default="determinant",
        help="smallest volume of uncertainty (default), or smallest amplification of noise",
    )
    parser.add_argument(
        "--given", metavar="PATH", type=Path, help="what is visited already: a recording, or a table frame,l1..l6"
    )
    parser.add_argument(
        "--sigma",
        nargs=2,
        type=parse_number,
        default=(1e-5, 1e-4),
        metavar=("M", "RAD"),
        help="standard deviation of a measured pose, per axis (default 1e-5 1e-4)",
    )
    parser.add_argument(
        "--calibration",
        metavar="FILE",
        type=Path,
        help="take the geometry from here, not from RIG.toml, and "
        "leave out configurations whose poses the corrected machine does not reach",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        required=True,
        help="frame,l1..l6; `rig simulate --plan commands:FILE` runs it",
    )
    add_page_option(parser)
    add_overwrite_option(parser)
    add_json_result_option(parser)


class Made(NamedTuple):
    """A plan that is written. design; values : (n, axes) m or rad; state : good, check or bad; why : in a line;
    said : in lines
    """

    design: Design
    values: np.ndarray
    state: str
    why: str
    said: list[str]


def run(arguments: Namespace) -> None:
    """Choose configurations, write them, and say what they make visible."""
    page = page_path(arguments)
    asked = (
        _promise
        if arguments.promise
        else _separate
        if arguments.separate
        else _parts
        if arguments.parts
        else PURPOSES[arguments.purpose]
    )
    made = asked(arguments)
    from calib.certify.calibration_evidence import confound_sentences
    from calib.samples.confounded_conditions import confounds_of_configurations
    from rig.planning.plan import axis_strokes

    confounds = (
        None
        if arguments.separate or not len(made.values)
        else confounds_of_configurations(made.values, axis_strokes(made.design).mean(axis=1), made.design.mechanism)
    )
    unseen = (Missing("not all that is asked becomes visible"),) if made.state != "good" else ()
    verdict = judge_evidence(Evidence(made.why, missing=unseen, confounds=confound_sentences(confounds)))
    print("\n".join(filter(None, [*made.said, *([] if confounds is None else [confounds.line()])])))
    axes = list(made.design.mechanism.axes)
    arguments.result = {
        "schema": "planned/1",
        "verdict": verdict.tree(),
        "state": made.state,
        "why": made.why,
        "said": [line for line in made.said if line],
        "axes": axes,
        "values": made.values.tolist(),
        "confounds": confounds and confounds.tree(),
    }
    if page is not None:
        from calib.report.recording_and_plan_pages import PlanResult, write_plan_page

        told = PlanResult(made.design, made.values, verdict, made.said)
        write_plan_page(page, str(arguments.out), told, page_links(arguments, arguments.page))
    kept = ", which stays as it was" if arguments.out.is_file() else ""
    written = f"written: {arguments.out}" if len(made.values) else f"nothing is written to {arguments.out}{kept}"
    print(written + (f"; look at {arguments.page}" if page else ""))


def _promise(arguments: Namespace) -> Made:
    """Write the fewest configurations that keep a promise; nothing where it is met without any."""
    from rig.formats.number_parsing_and_rounding import quantity_text
    from rig.formats.rig_toml import design_file
    from rig.model.mechanism_kinds import require_hexapod
    from rig.recording import recording_tables

    design = design_file.load_design(arguments.design)
    mechanism = require_hexapod(
        design.mechanism, "plans for a promise are for hexapods, not for a mechanism of kind {kind!r}"
    )
    out = arguments.outputs.file(arguments.out)

    from calib.models.platform.optimal_configurations import fewest_configurations

    mechanism, avoided = calibrated_geometry_and_avoidance(arguments, mechanism)
    given = visited_configurations(arguments.given, mechanism) if arguments.given else None
    progress = Progress()
    found = fewest_configurations(
        mechanism,
        arguments.promise,
        arguments.sigma,
        given,
        SEED,
        lambda done, of: progress("choosing", done, of),
        avoided,
    )
    progress.close()
    count, visited = len(found.commands), 0 if given is None else len(given)
    if not count:
        met = (
            f"by the {visited} configurations given"
            if visited
            else "by the geometry as it is stated, with no configuration visited"
        )
        said = [
            f"the promise of {quantity_text(arguments.promise, 'm')} is met {met}: "
            f"{quantity_text(found.left[0], 'm')} left; there is nothing to "
            f"visit"
        ]
    else:
        recording_tables.write_configurations(out, mechanism.axes, found.commands)
        said = [
            f"{count} configurations beside {visited} given keep {arguments.promise * 1e6:.4g} um: "
            f"{found.left[0] * 1e6:.4g} -> "
            f"{found.left[-1] * 1e6:.4g} um RMS over the workspace, which 97.5 % of machines keep to; errors "
            "that all poses share come on top",
            "left after each: " + " ".join(f"{value * 1e6:.3g}" for value in found.left[1:]) + " um",
        ]
    return Made(design, found.commands, "good", said[0], said)


def _parts(arguments: Namespace) -> Made:
    """Write the configurations of a plan's parts, in order, and say how far they go."""
    import numpy as np

    from rig.driving.run_steps_and_progress import steps_of_plan
    from rig.formats.rig_toml import design_file
    from rig.model import mechanisms
    from rig.model.pose import pose_difference
    from rig.planning.plan import build_plan
    from rig.recording import recording_tables

    if arguments.calibration or arguments.given:
        raise RigError("--parts are visited as they are; --calibration and --given are for plans that are chosen")
    design = design_file.load_design(arguments.design)
    mechanism, goals = (
        design.mechanism,
        [step.goal for step in steps_of_plan(build_plan(design, arguments.parts, SEED)) for _ in range(step.frames)],
    )
    recording_tables.write_configurations(arguments.outputs.file(arguments.out), mechanism.axes, goals)
    said = [f"{len(goals)} configurations of {arguments.parts}"]
    if mechanism.home_pose is not None:
        moved = (
            pose_difference(
                mechanism.home_pose, mechanisms.kinematics_of(mechanism).forward(np.array(goals), mechanism)
            )
            * 1e3
        )
        low, high = moved.min(axis=0), moved.max(axis=0)
        said.append(
            "from home, in the platform's axes: "
            + ", ".join(
                f"{name} {a:+.1f} .. {b:+.1f} {unit}"
                for name, unit, a, b in zip(("x", "y", "z", "rx", "ry", "rz"), ("mm",) * 3 + ("mrad",) * 3, low, high)
            )
        )
    return Made(design, np.array(goals), "good", said[0], said)


def _separate(arguments: Namespace) -> Made:
    """Try the parts of plans alone and two by two, and write the one by which the effects differ most."""
    from itertools import combinations

    import numpy as np

    from rig.effects.texts.effect_text import parse_effect, require_existing_place
    from rig.formats.rig_toml import design_file
    from rig.planning.plan import add_payload_channel, build_plan
    from rig.recording import recording_tables
    from synthetic.secret_machine import draw_temperatures

    if arguments.calibration:
        raise RigError(
            "--calibration is for plans of --for and --promise; effects are told apart by RIG.toml's own geometry"
        )
    design = design_file.load_design(arguments.design)
    effects = [require_existing_place(parse_effect(text), design) for text in arguments.separate]
    seen = [effect.name for effect in effects if effect.stage in ("targets", "view")]
    if seen:
        raise RigError(
            f"{', '.join(seen)} changes what is seen, not how the platform moves: no plan of moves tells it; "
            "see its own experiment in "
            "rig diagnose's page"
        )
    if not design.mechanism.axes:
        raise RigError(
            "plans to separate effects are for what is commanded, not for a mechanism of kind "
            f"{design.mechanism.kind!r}"
        )
    if design.mechanism.plates is not None:
        pass
    else:
        from calib.diagnose.problems.arm.effect_separation import arm_effect_separation
    out = arguments.outputs.file(arguments.out)
    trials = []
    moves = [text for text in MOVES if design.mechanism.plates is not None or not text.startswith("axes")]
    for text in (*moves, *(",".join(pair) for pair in combinations(moves, 2))):
        plan = build_plan(design, text, SEED)
        sensors, _ = draw_temperatures(plan.commands.t[-1], np.random.default_rng(SEED))
        trials.append(
            (
                arm_effect_separation(
                    text, design, plan.commands, plan.t, add_payload_channel(plan, sensors), effects, arguments.sigma
                ),
                plan,
            )
        )
    trials.sort(key=lambda trial: -trial[0].misfit / np.sqrt(trial[0].frames))
    said = ["misfit, in standard deviations, of the wrong model at its best (and for 100 exposures):"]
    said += [
        f"  {found.misfit:9.1f} {found.misfit * 10 / np.sqrt(found.frames):9.1f}   cosine "
        f"{found.cosine:6.3f}   {found.plan}"
        for found, _ in trials[:SHOWN]
    ]
    best, plan = trials[0]
    if best.misfit < LEAST:
        said.append("no plan tried tells them apart at that size")
    recording_tables.write_table(
        out,
        ("t", *design.mechanism.axes),
        [
            f"{t:.4f}," + ",".join(f"{v:.7f}" for v in values)
            for t, values in zip(plan.commands.t, plan.commands.values)
        ],
    )
    said.append(f"best: {best.plan} (rig simulate --plan {best.plan} tries it)")
    why = f"{' and '.join(arguments.separate)} are told apart by {best.misfit:.1f} standard deviations with {best.plan}"
    return Made(design, plan.commands.values, "good" if best.misfit >= LEAST else "check", why, said)


def _parameters(arguments: Namespace) -> Made:
    from rig.formats.rig_toml import design_file
    from rig.model.mechanism_kinds import has_plates, require_axes
    from rig.recording import recording_tables

    design = design_file.load_design(arguments.design)
    mechanism = require_axes(
        design.mechanism, "plans for parameters are for what is commanded, not for a mechanism of kind {kind!r}"
    )
    if arguments.count < 1 or min(arguments.sigma) <= 0:
        raise RigError(
            f"--count and --sigma take positive numbers, got {arguments.count} and {arguments.sigma[0]:g} "
            f"{arguments.sigma[1]:g}"
        )
    out = arguments.outputs.file(arguments.out)
    if not has_plates(mechanism):
        return _of_any(arguments, design, mechanism, out)

    from calib.models.platform.optimal_configurations import choose_d_optimal_configurations as choose
    from calib.models.platform.parameter_accuracy import PLAUSIBLE, standard_error_along
    from calib.models.platform.parameter_accuracy import parameter_combinations as combinations

    mechanism, avoided = calibrated_geometry_and_avoidance(arguments, mechanism)
    given = visited_configurations(arguments.given, mechanism) if arguments.given else None
    progress = Progress()
    chosen = choose(
        mechanism,
        arguments.count,
        arguments.sigma,
        arguments.criterion,
        given,
        SEED,
        lambda done, of: progress("choosing", done, of),
        avoided,
    )
    recording_tables.write_configurations(out, mechanism.axes, chosen.commands)
    (before, _), (after, seen), (_, even) = (
        combinations(root, mechanism) for root in (chosen.before, chosen.root, chosen.even)
    )
    visited = 0 if given is None else len(given)
    said = [
        f"{arguments.count} configurations beside {visited} given: condition number of the 42 parameters "
        f"{seen.condition:.0f}, "
        f"with as many evenly spread {even.condition:.0f}",
        f"worst determined combination {after[0].sigma * 1e6:.2f} um, evenly spread "
        f"{PLAUSIBLE / even.singular[-1] * 1e6:.2f} um; "
        f"all 42 together {(seen.singular.prod() / even.singular.prod()) ** (1 / 42):.2f} times as precise "
        "as evenly spread",
    ]
    hidden = [part for part in before if not part.determined]
    if visited and not hidden:
        said.append("what was given determines all 42 already; the worst, before and after:")
    elif visited:
        said.append(
            f"{len(hidden)} combinations that what was given does not tell from {PLAUSIBLE * 1e3:g} mm "
            "become visible; the worst:"
        )
    else:
        said.append("the worst determined combinations:")
    said += [
        f"  {_sigma(part.sigma)} -> {_sigma(standard_error_along(chosen.root, part.direction))}  {part.name}"
        if visited
        else f"  {_sigma(part.sigma)}  {part.name}"
        for part in (before if visited else after)[:SHOWN]
    ]
    unseen = sum(not part.determined for part in after)
    return Made(
        design,
        chosen.commands,
        "check" if unseen else "good",
        said[0] + (f"; {unseen} combinations stay unseen" if unseen else ""),
        said,
    )


def _of_any(arguments: Namespace, design: Design, mechanism: Arm | Chain | Planar2, out: Any) -> Made:
    """Write the configurations that tell most of a machine's parameters, of those in which cameras see it."""
    from functools import partial

    from calib.experiment.informative_configurations import FEWEST
    from calib.experiment.informative_configurations import informative_configurations as choose
    from rig.recording import recording_tables
    from vision.predict import visible_marker_counts
    from vision.targets import marker_map

    if arguments.calibration or arguments.given or arguments.criterion != "determinant":
        raise RigError("--calibration, --given and --criterion noise are for hexapods")
    looked = (
        partial(visible_marker_counts, design.cameras, markers=marker_map(design.without_stages()))
        if design.cameras and design.targets
        else None
    )
    progress = Progress()
    found = choose(
        mechanism, arguments.count, arguments.sigma, looked, SEED, lambda done, of: progress("choosing", done, of)
    )
    progress.close()
    recording_tables.write_configurations(out, mechanism.axes, found.values)
    said = []
    if looked is not None:
        said.append(
            f"{FEWEST} markers or more are seen in {found.seen:.0%} of the configurations all over the "
            "limits; chosen among these"
        )
    if found.undetermined:
        said.append(
            f"{found.undetermined} combinations of them no pose tells: they stay as stated, and are left aside here"
        )
    said.append(
        f"{arguments.count} configurations for {len(found.names)} parameters; standard errors, and by as "
        "many spread evenly, the least "
        "gain first:"
    )
    worst = (found.sigma / found.even).argsort()[::-1]
    said += [
        f"  {found.sigma[k] * 1e6:9.2f} {found.even[k] * 1e6:9.2f} u{found.units[k]}  {found.names[k]}"
        for k in worst[:SHOWN]
    ]
    return Made(
        design, found.values, "good", f"{arguments.count} configurations for {len(found.names)} parameters", ["", *said]
    )


def _sigma(value: float) -> str:
    return f"{value * 1e6:9.2f} um" if value < 1e-2 else "   unseen   "


PURPOSES = {"parameters": _parameters}
