"""Rigs in which one of two effects hides that are easily taken for each other: the right name alone, poses against
random plans, stated chances.

Of four pairs a rig is regenerated until its first recording leaves names alike. The other two are distinguished by any
first recording that shows them: a sag where the load is changed (at constant load most of it is joint geometry, and
nothing is found), a print scale by the cubes' stated places, which are a certified length. They count as they come.
"""

import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.api.next_experiment import (
    Experiment,
    available_experiment_plan_texts,
    evaluate_experiment,
    ranked_experiments_and_excluded_plans,
)
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.experiment.experiment_questions_and_information import NAME
from calib.experiment.platform_diagnosis_questions import open_questions_of_platform_diagnosis as questions
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import effect_with_existing_place, parse_effect
from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Design
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from rig.recording.recording_folder import Recording
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.calib.diagnose_recording import diagnosis_of
from vision.recording_combination_and_moved_cameras import combine_recordings

NOISE, LOOKS, BUDGET = 0.04, 8, 120.0  # px; recordings at the most; min
AT_RANDOM = 4  # recordings at the most that random plans have: what they would have needed is understated
SOON, LATER = "moving:24,sobol:50", "sobol:20,wait:60,sobol:20"  # first plans: at once, and before and after a lunch
ALONG, LOADED = (
    "axes:9",
    "moving:24,sobol:50,payload:6",
)  # along and about each axis, struts together; with a load on and off
SLOW = "sobol:120"  # ten minutes, as the standard plan's own part
HEAVY = 60.0  # kg of a platform, of which a soft strut yields visibly to the load of a plan
# what measures, but for prints
POSES = '\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-5\nrotation_sigma = 2e-5\n'
PAIRS = {  # name: (first plan, the two of it; {axis}, {other}, {a} .. {b} a size drawn between)
    "lag and clock offset": (
        SOON,
        ("servo_lag:rig:time_constant={3e-3|2e-2}", "time_offset:clock:offset={-2e-2|-3e-3}"),
    ),
    "creep and warm-up": (
        SLOW,
        (
            "creep:strut {axis}:fraction={1e-3|2e-3},time_constant={100|400}",
            "warm_up:strut {axis}:amplitude={4e-5|8e-5},time_constant={600|1200}",
        ),
    ),
    "crosstalk and scale": (
        ALONG,
        ("axis_coupling:strut {axis}:scale={1e-3|4e-3},other={other}", "scale_error:strut {axis}:scale={5e-4|1e-3}"),
    ),
    "load sag and joint geometry": (
        LOADED,
        ("compliance:rig:stiffness={1e6|3e6}", "compliance:strut {axis}:stiffness={1e6|3e6}"),
    ),
    "thermal and warm-up": (
        LATER,
        (
            "thermal_expansion:strut {axis}:coefficient={1.8e-5|2.4e-5}",
            "warm_up:strut {axis}:amplitude={1.5e-5|3e-5},time_constant={600|1500}",
        ),
    ),
    "strut scale and print scale": (
        SOON,
        ("scale_error:strut {axis}:scale={5e-4|1e-3}", "print_scale:markers:scale={1e-3|3e-3}"),
    ),
}


def drawn(text, rng) -> str:
    """An effect's text with its {..} drawn."""
    axis, other = rng.permutation(6)[:2] + 1
    out = text.replace("{axis}", str(axis)).replace("{other}", str(other))
    while "{" in out:
        before, _, rest = out.partition("{")
        ends, _, after = rest.partition("}")
        low, high = map(float, ends.split("|"))
        out = f"{before}{np.sign(low) * np.exp(rng.uniform(*sorted(np.log(np.abs([low, high]))))):.4g}{after}"
    return out


class Case:
    """A secret machine in a folder. truth : text of its effect, or None for one that hides nothing"""

    def __init__(self, folder, design, text, truth, seed):
        self.folder, self.design, self.text, self.seed = folder, design, text, seed
        effects = () if truth is None else (effect_with_existing_place(parse_effect(truth), design),)
        self.world, self.truth = (
            random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(seed), 1.0, effects),
            truth,
        )
        self.title = "" if truth is None else f"{effects[0].name.replace('_', ' ')} at {effects[0].place}"

    def recorded(self, name, route) -> Recording:
        rng = np.random.default_rng([self.seed, *name.encode()])
        recording_simulation.write_recording(
            recording_simulation.simulate_world(self.world, route, rng), self.folder / name, self.text, rng, NOISE
        )
        return recording_folder.load_recording(self.folder / name)

    def first(self, text) -> tuple[Recording, Diagnosis]:
        """(Recording, its diagnosis) of a first plan."""
        found = self.recorded("first", plan.build_plan(self.design, text, self.seed))
        return found, diagnosis_of(found)


def settle(case, first, found, pick, looks=LOOKS) -> tuple[Diagnosis, int, float, list[tuple[float, bool]]]:
    """(diagnosis, extra poses, min, [(stated, settled)]) of experiments that pick(questions, number, min left)
    chooses.
    """
    parts, poses, minutes, stated = [first], 0, 0.0, []
    for number in range(1, looks):
        open_questions = questions(found)
        chosen = pick(open_questions, number, BUDGET - minutes) if open_questions else None
        if chosen is None:
            break
        parts.append(case.recorded(f"{pick.__name__}{number}", chosen.plan))
        found = diagnosis_of(combine_recordings(parts).recording)
        poses, minutes = poses + len(chosen.plan.t), minutes + chosen.minutes
        stated.append((chosen.settles, not questions(found)))
    return found, poses, minutes, stated


def best(design) -> Callable[..., Experiment | None]:
    def chosen(open_questions, number, left):
        found, _ = ranked_experiments_and_excluded_plans(
            open_questions, design, available_experiment_plan_texts(("payload", "wait"), False), number, left
        )
        return found[0] if found and found[0].bits > 0.01 else None

    return chosen


def at_random(design, rng) -> Callable[..., Experiment | None]:
    def random(open_questions, number, left):
        for text in rng.permutation(
            [text for text in available_experiment_plan_texts(("payload", "wait"), False) if not text.startswith(NAME)]
        ):
            try:
                found = evaluate_experiment(open_questions, design, str(text), number)
            except RigError:
                continue
            if found.minutes <= left:
                return found
        return None

    return random


def rows(rigs=40, quiet=20, draws=4) -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    start, done = time.process_time(), []
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        rooms = {kind: _rig(base / f"{kind}.toml", kind) for kind in ("poses", "corners", "heavy")}
        for number in range(rigs):
            done.append(one := tried(base, rooms, number, draws))
            print(f"  {number + 1}. {one.text}", file=sys.stderr, flush=True)
        still = 0
        for k in range(quiet):
            found = Case(base / f"q{k}", *rooms["poses"], None, 90_000 + k).first(SOON)[1]
            still += not names(found)
            print(f"  nothing hidden {k + 1}: {names(found) or 'nothing'}", file=sys.stderr, flush=True)
    alike = [one for one in done if one.alike]
    yield f"{rigs} rigs: right name alone", f"{sum(one.right for one in done)}", ">= 90 %"
    yield (
        f"of them {len(alike)} left alike by the first recording ({sum(one.skipped for one in done)} more "
        "drawn that were not): right name alone",
        (f"{sum(one.right for one in alike)}"),
        ">= 90 %",
    )
    yield (
        "extra poses over those of random plans of the same kinds, median",
        f"{np.median([one.ratio for one in alike]):.2f}",
        "<= 0.5",
    )
    for who, predictions in (
        ("chosen", [t for one in alike for t in one.chosen]),
        ("random", [t for one in alike for t in one.random]),
    ):
        predicted, happened = np.mean(predictions, axis=0) if predictions else (np.nan, np.nan)
        yield (
            f"chance to settle, of {len(predictions)} {who} experiments: as stated, as it happened",
            f"{predicted:.0%}, {happened:.0%}",
            "within 15 %",
        )
    yield f"{quiet} rigs that hide nothing: nothing found, and no experiment", f"{still}", ">= 95 %"
    yield "processor time", f"{(time.process_time() - start) / 60:.1f} min", ""


@dataclass(frozen=True, slots=True)
class Tried:
    """text : what happened, in words; alike : whether the first recording left names alike; right : whether the right
    one was left alone
    skipped : rigs drawn before that left nothing alike; ratio : extra poses over those at random; chosen,
        random : [(stated, settled)]"""

    text: str
    alike: bool
    right: bool
    skipped: int = 0
    ratio: float = np.nan
    chosen: tuple[tuple[float, bool], ...] = ()
    random: tuple[tuple[float, bool], ...] = ()


def tried(base, rooms, number, draws) -> Tried:
    """Tried of one rig: of the pairs in turn."""
    name = list(PAIRS)[number % len(PAIRS)]
    route, both = PAIRS[name]
    design, text = rooms["corners" if "print" in name else "heavy" if "load" in name else "poses"]
    for draw in range(1 if "print" in name or "load" in name else draws):
        seed = 1000 * number + draw
        rng = np.random.default_rng(seed)
        case = Case(base / str(seed), design, text, drawn(both[number // len(PAIRS) % 2], rng), seed)
        first, found = case.first(route)
        if questions(found):
            break
    else:
        right = names(found) == [case.title]
        return Tried(f"{case.truth}: {names(found)} {'alone' if right else 'NOT right'} at once", False, right, draw)
    done, poses, minutes, predictions = settle(case, first, found, best(design))
    _, others, _, random = settle(case, first, found, at_random(design, rng), AT_RANDOM)
    alone = names(done) == [case.title] and not questions(done)
    both_texts = f"{[(round(s, 2), h) for s, h in predictions]} random {[(round(s, 2), h) for s, h in random]}"
    return Tried(
        f"{case.truth}: {names(done)} {'alone' if alone else 'NOT alone'}, {poses} poses in {minutes:.1f} "
        f"min, at random {others}; {both_texts}",
        True,
        alone,
        draw,
        poses / max(others, 1),
        tuple(predictions),
        tuple(random),
    )


def _rig(path, kind) -> tuple[Design, str]:
    """(Design, text of rig.toml) of a rig whose poses an instrument measures, or which cameras see, or with a heavy
    platform.
    """
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3) + ("" if kind == "corners" else POSES)
    if kind == "heavy":
        text = re.sub(r"mass = [\d.]+", f"mass = {HEAVY}", text, count=1)
    path.write_text(text)
    return design_from_rig_toml.load_design(path), text


def names(found) -> list[str]:
    """Titles of a diagnosis' findings."""
    return [f"{e.name.replace('_', ' ')} at {e.place}" for e in found.effects]
