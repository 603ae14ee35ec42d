"""Plan of a recording, built from its text.

Built from named parts.
Configurations to visit, their order, how long, what payload.

A plan is written as parts separated by commas, each NAME or NAME:COUNT: sobol:100,ladder,moving:60 visits a hundred
low-discrepancy configurations, then a ladder of reversals, then exposes sixty times while moving.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import FileError, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.local_and_remote_input_files import short_repr
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.design_contradictions_and_cube_quarter_turns import cube_name_or_problem
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_redundant, require_axes
from rig.model.mechanisms.redundant_strut_best_six_legs_and_loop_closures import nearest_compatible_strut_lengths
from rig.planning.configuration_generators import (
    FILL,
    combined_translation_rotation_commands,
    divided_grid_configurations,
    grid_configurations,
    iso9283_five_test_pose_commands,
    parse_grid_parts_and_stroke_share,
    scale_to_strokes,
    simplex_configurations,
    single_axis_pose_commands,
    sobol_configurations,
)
from rig.planning.timed_plan_and_visiting_order import (
    MOST,
    STEP,
    ApproachSettings,
    Plan,
    PlanWriter,
    plan_of_time_table,
    require_commands_in_range,
)
from rig.recording.recording_folder import PAYLOAD, Sensors

SPEED = 0.5  # of the actuator's top speed
UNSTATED_SPEED = {"m": 0.02, "rad": 0.5}  # m/s or rad/s where the design states none
EXPOSE_EVERY = 0.25  # s while moving
TURNED = (0.004, 0.008, 0.016, 0.032, 0.064)  # s after a reversal
LONG = 600.0  # s of a dwell that is watched
LONGEST = 600  # min that a plan may wait at once
BELOW = 0.05  # of the stroke, from which a one-sided plan comes up to every configuration
STANDARD = "moving:30,sobol:120,ladder,zigzag:30,payload:20,sobol:100,moving:30"


def plan_of_configurations(configurations: Floats, start: Floats, speed: float | Floats) -> Plan:
    """Plan that visits configurations (n, axes) from start (axes,).

    Dwells and exposes once settled.
    speed : of the axes, one or (axes,) m/s or rad/s
    """
    writer = PlanWriter(np.asarray(start, float), speed)
    for goal in configurations:
        writer.settle(goal)
    return writer.plan()


def build_plan(
    design: Design,
    text: str,
    seed: int = 0,
    one_sided: bool = False,
    additional_parts: Mapping[str, Floats] | None = None,
) -> Plan:
    """Build the Plan of a design from its text.

    For example "sobol:100,moving:60".
    "standard" stands for STANDARD.
    one_sided : whether every configuration at which the struts settle is reached from shorter struts
    additional_parts : {part: configurations (n, axes) that it visits in that order}, besides these

    Scattered configurations (sobol, division, grid, simplices, axes, combined, payload, warmup, repeat) are shuffled
    and approached from sides so that neither time nor direction is a function of place (see
    rig.planning.timed_plan_and_visiting_order). A ladder, iso9283 and commands keep their
    order and go straight.
    Parts: sobol:N, division:Q (see rig.planning.configuration_generators.divided_grid_configurations), grid:PER_AXIS,
    simplices:SHELLS, axes:PER_AXIS, combined:PER_PAIR, ladder:STEPS,
    payload:N, moving:N, zigzag:N, warmup:N, repeat:N, dwell:N, wait:MINUTES, iso9283:CYCLES, turn:CUBE (before all
    others: the cube is taken off and put back turned by a quarter turn from where its pose is stated)
    and commands:FILE (a table frame,l1..l6 as `rig correct` and `rig plan` write it, whose rows without a frame are
    passed without an exposure; one with a column t is a plan by itself, in its own time)
    Raises RigError for a part that is not known.
    """
    if not design.mechanism.axes:
        raise RigError(
            f"a mechanism of kind {design.mechanism.kind!r} cannot be planned for: there is nothing to command"
        )
    if text.startswith("commands:") and "," not in text:
        found = plan_of_time_table(design, text.removeprefix("commands:"))
        if found is not None:
            return found
    strokes = axis_strokes(design)
    below = BELOW * np.ptp(strokes, axis=1) if one_sided else None
    approach = ApproachSettings(
        strokes, below, np.random.default_rng((seed, 1))
    )  # apart from rng: which configurations a part visits stays the same
    start = nearest_compatible_commands(strokes.mean(axis=1)[None], design)[0]
    writer = PlanWriter(start, planned_axis_speeds(design), approach)
    rng = np.random.default_rng(seed)
    for part in (STANDARD if text == "standard" else text).split(","):
        name, _, count = part.strip().partition(":")
        if additional_parts and part.strip() in additional_parts:
            writer.follow(np.asarray(additional_parts[part.strip()]))
            continue
        if name not in PARTS:
            raise RigError(
                f"plan {short_repr(text)}: there is no part {short_repr(name)}; there are {', '.join(PARTS)}"
            )
        if name not in TEXTS and count and not (count.isascii() and count.isdigit() and count.strip("0")):
            raise RigError(
                f"plan {short_repr(text)}: {name} takes a whole number of at least 1, not {short_repr(count)}"
            )
        if name not in TEXTS:
            _refuse_endless(name, int(count.lstrip("0")[:12] or 0), len(strokes), len(writer.exposures), text)
        if is_redundant(design.mechanism) and name in INDEPENDENT:
            raise RigError(
                f"plan {short_repr(text)}: {name} moves all axes independently, and the lengths of {len(strokes)} "
                "struts depend on each other; sobol:N spreads poses evenly"
            )
        written = len(writer.values)
        PARTS[name](writer, design, count if name in TEXTS else int(count or 0), rng)
        if name != "commands":  # whose lengths agree as `rig correct` wrote them
            writer.values[written:] = nearest_compatible_commands(np.array(writer.values[written:]), design)
    if not writer.exposures:
        raise RigError(f"plan {short_repr(text)} exposes nothing")
    return writer.plan()


def nearest_compatible_commands(values: Floats, design: Design) -> Floats:
    """Commands (n, axes) nearest to values (n, axes) that are compatible.

    Of more than six struts they close on a pose.
    Joints that follow others are commanded as their leaders have them.
    """
    m = require_axes(design.mechanism)
    return nearest_compatible_strut_lengths(values, m) if is_redundant(m) else mechanisms.with_followers(values, m)


def _refuse_endless(name: str, count: int, axes: int, before: int, text: str) -> None:
    """Raise RigError for a part that would make a plan of more than MOST exposures."""
    each = {
        "grid": float(count) ** axes,
        "simplices": count * (2.0 * axes + 2.0 ** (axes - 1)),
        "axes": 6.0 * count,
        "combined": 18.0 * count,
        "ladder": 4.0 * axes * count,
        "payload": 3.0 * count,
        "iso9283": 5.0 * count,
    }.get(name, count)
    _refuse_beyond(name, str(count), each, before, text)


def _refuse_beyond(name: str, count: str, each: float, before: int, text: str) -> None:
    if before + each > MOST:
        raise RigError(
            f"plan {short_repr(text)}: with {name}:{count} it exposes {before + each:.3g} times; a plan may "
            f"{MOST} times"
        )


def _visit(
    configurations: Callable[[Design, int, np.random.Generator], Floats],
) -> Callable[[PlanWriter, Design, int, np.random.Generator], None]:
    def part(writer: PlanWriter, design: Design, count: int, rng: np.random.Generator) -> None:
        writer.visit(configurations(design, count, rng))

    return part


def _ladder(writer: PlanWriter, design: Design, steps: int, rng: np.random.Generator) -> None:
    """Every strut alone, out and back in growing amplitudes: each rung is approached from both sides."""
    strokes = axis_strokes(design)
    middle, half = strokes.mean(axis=1), FILL * np.ptp(strokes, axis=1) / 2
    reaches = np.geomspace(1 / 64, 1, steps or 4)
    for axis in range(len(strokes)):
        step = np.zeros(len(strokes))
        step[axis] = half[axis]
        for reach in reaches:
            for goal in (middle + reach * step, middle, middle - reach * step, middle):
                writer.settle(goal)


def _payload(writer: PlanWriter, design: Design, count: int, rng: np.random.Generator) -> None:
    """The same configurations without and with a load of 0.6 of the platform's mass, from other sides."""
    goals = writer.shuffled(sobol_configurations(axis_strokes(design), count or 12, seed=int(rng.integers(1 << 30))))
    masses = (0.0, 0.6 * (design.platform.mass or 1.0), 0.0)
    moves = writer.approaches(np.tile(goals, (3, 1)), [np.repeat(masses, len(goals))]).reshape(3, *goals.shape)
    for mass, lasts in zip(masses, moves):
        writer.dwell(20.0)
        writer.payload.append((writer.t[-1], mass))
        writer.dwell(1.0)
        for goal, last in zip(goals, lasts):
            writer.settle(goal, last)


def _moving(writer: PlanWriter, design: Design, count: int, rng: np.random.Generator) -> None:
    """Exposures on the way: two waves per strut, slow enough for its top speed, command rows every STEP seconds."""
    strokes = axis_strokes(design)
    middle, half = strokes.mean(axis=1), 0.5 * FILL * np.ptp(strokes, axis=1) / 2
    seconds = (count or 60) * EXPOSE_EVERY + 2.0
    rates = rng.uniform(0.2, 0.6, (2, len(strokes)))
    rates *= np.minimum(1, 2 / (half * rates.sum(axis=0) / writer.speed).max())
    phases = rng.uniform(0, 2 * np.pi, (2, len(strokes)))

    def at(t: float) -> Floats:
        return middle + half / 2 * np.sin(rates * t + phases).sum(axis=0)

    writer.go(at(0.0))
    writer.dwell(1.0)
    start = writer.t[-1]
    for k in range(1, int(seconds / STEP) + 1):
        writer.t.append(start + k * STEP)
        writer.values.append(at(k * STEP))
    writer.exposures += [start + 1.0 + k * EXPOSE_EVERY for k in range(count or 60)]


def _zigzag(writer: PlanWriter, design: Design, count: int, rng: np.random.Generator) -> None:
    """Exposures soon after all struts have turned round at full speed: what lags shows there, what only reads the clock
    wrong does not.
    """
    strokes = axis_strokes(design)
    leg = EXPOSE_EVERY * writer.speed * rng.choice([-1, 1], len(strokes))
    writer.go(strokes.mean(axis=1) - leg / 2)
    writer.dwell(1.0)
    start, turns = writer.t[-1], np.arange(1, (count or 60) + 2)
    writer.t += (start + turns * EXPOSE_EVERY).tolist()
    writer.values += [writer.values[-1] + leg * (k % 2) for k in turns]
    writer.exposures += [start + k * EXPOSE_EVERY + TURNED[(k - 1) // 2 % len(TURNED)] for k in turns[:-1]]


def _warmup(writer: PlanWriter, design: Design, count: int, rng: np.random.Generator) -> None:
    """One configuration in twelve comes back all along, minutes apart: four hours in all."""
    goals = sobol_configurations(axis_strokes(design), 11, seed=int(rng.integers(1 << 30)))
    route = np.array(
        [axis_strokes(design).mean(axis=1) if k % 2 else goals[k // 2 % len(goals)] for k in range(count or 48)]
    )
    for goal, last in zip(route, writer.approaches(route)):
        writer.settle(goal, last)
        writer.dwell(4 * 3600 / (count or 48))


def _dwell(writer: PlanWriter, design: Design, count: int, rng: np.random.Generator) -> None:
    """From one end to the other at once, and exposures during ten minutes there, often at first: what arrives late, and
    what only goes with time.
    """
    strokes = axis_strokes(design)
    middle, half = strokes.mean(axis=1), FILL * np.ptp(strokes, axis=1) / 2
    sides = rng.choice([-1, 1], len(strokes))
    writer.go(middle - half * sides)
    writer.dwell(LONG / 4)
    writer.go(middle + half * sides)
    writer.watch(count or 20, LONG)


def _wait(writer: PlanWriter, design: Design, minutes: int, rng: np.random.Generator) -> None:
    """Nothing for so long, while temperatures change. Raises RigError for more than LONGEST minutes."""
    if minutes > LONGEST:
        raise RigError(f"a plan waits for {LONGEST} minutes at the most, not for {minutes}")
    writer.dwell(60.0 * (minutes or 20))


def _repeat(writer: PlanWriter, design: Design, count: int, rng: np.random.Generator) -> None:
    """Three configurations approached repeatedly from all directions, by every axis as often from below as from above:
    what repeatability is.
    """
    strokes = axis_strokes(design)
    goals = sobol_configurations(strokes, 3, seed=1)
    route = goals[np.arange(count or 30) % 3]
    for goal, last in zip(route, writer.approaches(route)):
        writer.go(scale_to_strokes(strokes, rng.uniform(-1, 1, len(strokes)), FILL))
        writer.settle(goal, last)


def _turn(writer: PlanWriter, design: Design, cube: str, rng: np.random.Generator) -> None:
    """A cube put back turned by a quarter turn before the plan begins. Raises RigError for a cube that there is not, or
    a plan that has begun.
    """
    name, problem = cube_name_or_problem(cube, design.targets)
    if problem:
        raise RigError(f"a plan cannot turn it: {problem}")
    if writer.exposures:
        raise RigError(f"cube {name} is turned before a plan begins: turn:{name} stands before what is exposed")
    writer.turned[name] = 1


def _iso9283(writer: PlanWriter, design: Design, cycles: int, rng: np.random.Generator) -> None:
    """ISO 9283's five poses, one after the other and that thirty times: accuracy and repeatability of poses."""
    poses = iso9283_five_test_pose_commands(design)
    for _ in range(cycles or 30):
        for goal in poses[::-1]:
            writer.settle(goal)


def _commands(writer: PlanWriter, design: Design, file: str, rng: np.random.Generator) -> None:
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(Path(file), ("frame", *design.mechanism.axes))
    if "t" in rows.columns:
        raise FileError(file, "is in time (it has a column t), so it is a complete plan, not part of one")
    for goal, frame in zip(require_commands_in_range(rows, design), rows.text("frame")):
        if frame:
            writer.settle(goal)
        else:
            writer.go(goal)


def _division(writer: PlanWriter, design: Design, text: str, rng: np.random.Generator) -> None:
    strokes = axis_strokes(design)
    if not text.endswith(".csv"):
        each = float(
            np.prod([count + 1.0 for count in parse_grid_parts_and_stroke_share(len(strokes), text or "2")[0]])
        )
        _refuse_beyond("division", text, each, len(writer.exposures), f"division:{text}")
    writer.visit(divided_grid_configurations(strokes, text or "2"))


PARTS: dict[str, Callable[..., None]] = {
    "sobol": _visit(
        lambda design, count, rng: sobol_configurations(
            axis_strokes(design), count or 100, seed=int(rng.integers(1 << 30))
        )
    ),
    "grid": _visit(lambda design, count, rng: grid_configurations(axis_strokes(design), count or 2)),
    "simplices": _visit(lambda design, count, rng: simplex_configurations(axis_strokes(design), count or 2)),
    "axes": _visit(lambda design, count, rng: single_axis_pose_commands(design, count or 9)),
    "combined": _visit(lambda design, count, rng: combined_translation_rotation_commands(design, count or 6)),
    "ladder": _ladder,
    "payload": _payload,
    "moving": _moving,
    "zigzag": _zigzag,
    "warmup": _warmup,
    "repeat": _repeat,
    "dwell": _dwell,
    "wait": _wait,
    "turn": _turn,
    "commands": _commands,
    "division": _division,
    "iso9283": _iso9283,
}
TEXTS = ("commands", "division", "turn")  # parts that take more than a number
INDEPENDENT = ("division", "grid", "simplices")  # parts that move every axis whatever the others do


def axis_strokes(design: Design) -> Floats:
    """Strokes (axes, 2) m or rad of the axes.

    The lowest and highest command of each.
    """
    return mechanisms.kinematics_of(design.mechanism).travel_ranges(design.mechanism)


def planned_axis_speeds(design: Design) -> Floats:
    """Speed (axes,) m/s or rad/s at which a plan moves each axis.
    The top speed that a rig.toml states is that of struts and slides.
    """
    top = design.actuator.max_speed
    return np.array(
        [
            SPEED * top if top and unit == "m" else UNSTATED_SPEED[unit]
            for unit in mechanisms.axis_units(design.mechanism)
        ]
    )


def sensors_with_payload(plan: Plan, sensors: Sensors) -> Sensors:
    """Sensors with the plan's payload added as a channel."""
    if not (plan.payload[:, 1] > 0).any():
        return replace(sensors, channels={**sensors.channels, PAYLOAD: np.zeros(len(sensors.t))})
    steps = plan.payload[1:, 0]
    t = np.union1d(sensors.t, np.concatenate([steps - 1e-3, steps]))
    mass = plan.payload[np.searchsorted(plan.payload[:, 0], t, side="right") - 1, 1]
    channels = {name: np.interp(t, sensors.t, values) for name, values in sensors.channels.items()}
    return replace(sensors, t=t, channels={**channels, PAYLOAD: mass})
