"""Blind cases of arms, drawn at random, with their truth.

Makes, instruments, protocols, unmodelled physics.

A third is made hard.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import MOTION_STAGES, Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Drawing, draw_log_uniform
from rig.errors import RigError
from rig.formats.output_files import write_text
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.design import Design, Instrument
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.model.pose import exp
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.recording_plan import build_plan, plan_of_configurations
from rig.planning.timed_plan_and_visiting_order import Plan
from rig.recording.recording_folder import Commands, Sensors
from synthetic import random_true_machine_and_truth_file
from synthetic import recording_simulation as simulation
from synthetic.random_blind_platform_cases_with_truth import TRIES, random_case_kind_and_effect_numbers

KINDS = ("nothing", "one", "two")  # of what is hidden
FRAMES = 220  # poses of a recording by default
SIGMA, TURN = (1e-5, 6e-5), (3.0, 8.0)  # m, and rad/m, of an instrument's poses
HARD = 3  # one case in so many is hard
STUDENT, WILD, WILDER, FEWER, UNDERSTATED = 3.0, (0.01, 0.03), 10.0, 0.25, 10.0
HARDSHIPS = {
    "positions": "no rotations are measured",
    "wild": "1 to 3 % of the rows are off by ten sigma",
    "tails": "Student's t noise",
    "understated": "the stated sigma is too small by ten",
    "untimed": "the times are lost, the order is true",
    "missing": "a quarter of the rows is missing",
    "level": "the hand stays level",
}
UR10 = """schema = "rig/1"
[environment]
gravity = [0.0, 0.0, -9.80665]
[mechanism]
kind = "arm"
joints = [[0.0, 0.1273, 0.0, 1.5707963267948966], [0.0, 0.0, -0.612, 0.0], [0.0, 0.0, -0.5723, 0.0],
          [0.0, 0.163941, 0.0, 1.5707963267948966], [0.0, 0.1157, 0.0, -1.5707963267948966], [0.0, 0.0922, 0.0, 0.0]]
limits = [[-3.0, 3.0], [-3.0, 0.0], [-2.5, 2.5], [-3.0, 3.0], [-2.5, 2.5], [-3.0, 3.0]]
"""  # the maker's nominal figures; limits of a cell


@dataclass(frozen=True, slots=True, eq=False)
class DrawnArmCase:
    """kind : of KINDS; make; simulation : Simulation with its noise-free poses; text : the owner's rig.toml;
    sigma : (2,) m, rad as it truly is
    hard : of HARDSHIPS; plan : in words; rng : what draws the noise"""

    kind: str
    make: str
    simulation: simulation.Simulation
    text: str
    sigma: Floats
    hard: tuple[str, ...]
    plan: str
    rng: np.random.Generator


def _arm_makes() -> dict[str, str]:
    """{make: the text of its rig.toml}: offset wrist, spherical wrist, seven joints."""
    shipped = files("rig") / "arms"
    return {
        "ur10": UR10,
        **{name: (shipped / f"{name}.toml").read_text(encoding="utf-8") for name in ("puma560", "panda")},
    }


def draw_arm_case(
    seed: int, index: int, frames: int = FRAMES, kinds: Sequence[str] = KINDS, effects: Sequence[str] = ()
) -> DrawnArmCase:
    """Arm case `index` of a blind campaign, drawn at random.

    effects : names of the catalogue's to use
    Raises RigError where nothing comes up in TRIES draws, or no effect of the catalogue is left
    """
    at_joints = [e for e in ALL if "axis" in e.places and e.stage in MOTION_STAGES and not e.moving]
    # what bends links takes a load that these arms' owners do not state
    catalogue = [e for e in at_joints if not e.of_links and (not effects or e.name in effects)]
    if not catalogue:
        raise RigError(f"--effects: none of {', '.join(effects)} is observable in poses of an arm at rest")
    kind, numbers, rng = random_case_kind_and_effect_numbers(seed, index, kinds, len(catalogue))
    for attempt in range(TRIES):
        try:
            return _drawn(kind, [catalogue[(n + attempt) % len(catalogue)] for n in numbers], rng, frames, index)
        except RigError:  # an arm lacks what this effect needs: the next in the catalogue
            if attempt == TRIES - 1:
                raise
    raise AssertionError


def _drawn(kind: str, hidden: list[type[Effect]], rng: np.random.Generator, frames: int, index: int) -> DrawnArmCase:
    make = str(rng.choice(list(_arm_makes())))
    hard = _hardships(make, rng) if index % HARD == 0 else ()
    sigma = draw_log_uniform(rng, *SIGMA) * np.array([1.0, rng.uniform(*TURN)])
    stated = sigma / (UNDERSTATED if "understated" in hard else 1.0)
    turn = "" if "positions" in hard else f"rotation_sigma = {stated[1]:.3g}\n"
    text = f'{_arm_makes()[make]}\n[instrument]\nbase = "free"\ntool = "free"\nposition_sigma = {stated[0]:.3g}\n{turn}'
    with tempfile.TemporaryDirectory() as folder:
        write_text(Path(folder) / "rig.toml", text)
        design = design_from_rig_toml.load_design(Path(folder) / "rig.toml")
    if "level" in hard:
        plan, route = (
            "level",
            plan_of_configurations(
                _level(design, frames, rng),
                mechanisms.kinematics_of(design.mechanism).home_values(design.mechanism),
                0.5,
            ),
        )
    else:
        ladder = 4 * len(require_arm(design.mechanism).joints)
        plan = f"sobol:{max(frames - ladder - 20, 20)},ladder:1,repeat:20"
        route = build_plan(design, plan, int(rng.integers(1 << 30)))
    effects = [_effect(e, design, route, rng) for e in hidden]
    if len({(e.name, e.place) for e in effects}) < len(effects):
        raise RigError("the same effect twice at one place")
    done = simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng, float(rng.uniform(0.5, 1.5)), effects),
        route,
        rng,
    )
    return DrawnArmCase(kind, make, done, text, sigma, hard, plan, rng)


def _hardships(make: str, rng: np.random.Generator) -> tuple[str, ...]:
    """One or two of HARDSHIPS, those that a make can have."""
    able = [name for name in HARDSHIPS if name != "level" or make == "ur10"]
    return tuple(sorted(str(name) for name in rng.choice(able, int(rng.integers(1, 3)), replace=False)))


def _level(design: Design, count: int, rng: np.random.Generator) -> Floats:
    """(count, 6) rad of an arm with three parallel axes whose hand points down all the time and turns about the
    vertical alone.
    """
    q = sobol_configurations(require_arm(design.mechanism).limits, count, 0.8, seed=int(rng.integers(1 << 30)))
    q[:, 3], q[:, 4] = -np.pi / 2 - q[:, 1] - q[:, 2], -np.pi / 2
    return q[rng.permutation(count)]


def _effect(kind: type[Effect], design: Design, route: Plan, rng: np.random.Generator) -> Effect:
    """An effect at a random joint, its parameters over their usual ranges. Raises RigError where the arm lacks what it
    needs.
    """
    sensors, _ = random_true_machine_and_truth_file.random_true_and_logged_temperatures(
        float(route.t[-1]), np.random.default_rng(0), 0
    )
    motion = motion_simulation.motion_of_commands(design, route.commands, route.t, (), sensors)
    motion = replace(motion, T=mechanisms.kinematics_of(design.mechanism).forward(motion.lengths, design.mechanism))
    place = str(rng.choice(mechanisms.axis_place_texts(design.mechanism)))
    effect = kind.drawn(place, Drawing(design, route.t, motion, lambda effect, camera: 0.0), rng)
    reason = effect.needs(motion)
    if reason:
        raise RigError(f"{kind.name} {reason}")
    return effect


def write_recording(case: DrawnArmCase, folder: Path) -> None:
    """Write the recording of an arm case into a folder.

    It has noise and difficulties.
    """
    rng, done, n = case.rng, case.simulation, len(case.simulation.plan.t)
    noise = rng.standard_t(STUDENT, (n, 6)) if "tails" in case.hard else rng.normal(size=(n, 6))
    if "wild" in case.hard:
        wild = rng.choice(n, max(round(n * rng.uniform(*WILD)), 1), replace=False)
        noise[wild] += WILDER * rng.choice([-1.0, 1.0], (len(wild), 6))
    T = done.run.T_base_platform * exp(np.repeat(case.sigma, 3) * noise)
    seen = rng.random(n) >= FEWER if "missing" in case.hard else np.ones(n, bool)
    plan, log = done.plan, done.log
    if "untimed" in case.hard:
        plan, log = _untimed(plan), Sensors(done.log.t, {})
    stated = replace(done.world.stated, instrument=_exact(done.world.stated))
    shown = replace(
        done,
        plan=replace(plan, t=plan.t[seen]),
        log=log,
        run=replace(done.run, T_base_platform=T[seen]),
        world=replace(done.world, stated=stated),
    )
    simulation.write_recording(shown, folder, case.text, rng)


def _exact(design: Design) -> Instrument:
    """The design's instrument without noise: poses are written as they are."""
    instrument = design.instrument
    assert instrument is not None
    return replace(instrument, position_sigma=0.0, rotation_sigma=None if instrument.rotation_sigma is None else 0.0)


def _untimed(plan: Plan) -> Plan:
    """The plan with a second from each row or exposure to the next."""
    t = np.union1d(plan.commands.t, plan.t)
    return replace(
        plan,
        commands=Commands(np.searchsorted(t, plan.commands.t).astype(float), plan.commands.values),
        t=np.searchsorted(t, plan.t).astype(float),
        payload=np.array([(0.0, 0.0)]),
    )


def write_truth(case: DrawnArmCase, path: Path, **more: object) -> None:
    """Write the truth of an arm case, with further entries, into a file."""
    random_true_machine_and_truth_file.write_truth(
        path,
        case.simulation.world,
        case.simulation.run.T_base_platform,
        kind=case.kind,
        make=case.make,
        disturbance=" and ".join(case.hard) or None,
        sigma=case.sigma.tolist(),
        plan=case.plan,
        **more,
    )
