"""Rigs whose first recording leaves two names alike: the right one alone, poses against random plans, stated chances against what happened."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from calib.diagnose.problems.platform.diagnose import PlatformDiagnosis, diagnose
from calib.experiment.choose import Experiment, choose, evaluate, kinds
from calib.experiment.hypotheses import questions
from rig import design_file, layout, plan, recording
from rig.effects.parse import parse, placed
from rig.errors import RigError
from rig.recording import Recording
from synthetic import simulation, world
from vision.together import together

NOISE, LOOKS, BUDGET = 0.04, 4, 120.0  # px; recordings at the most; min
SOON, LATER = "moving:24,sobol:50", "sobol:20,wait:15,sobol:20"  # first plans: at once, and over a while
POSES = '\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-5\nrotation_sigma = 2e-5\n'  # what measures, but for prints
PAIRS = {  # name: (first plan, the two of it; {axis}, {other}, {a} .. {b} a size drawn between)
    "lag and clock offset": (SOON, ("servo_lag:rig:time_constant={3e-3|2e-2}", "time_offset:clock:offset={-2e-2|-3e-3}")),
    "creep and warm-up": (SOON, ("creep:strut {axis}:fraction={1e-3|2e-3},time_constant={100|400}", "warm_up:strut {axis}:amplitude={4e-5|8e-5},"
                                 "time_constant={600|1200}")),
    "crosstalk and scale": (SOON, ("axis_coupling:strut {axis}:scale={1e-3|4e-3},other={other}", "scale_error:strut {axis}:scale={5e-4|1e-3}")),
    "load sag and joint geometry": (SOON, ("compliance:rig:stiffness={2e6|5e6}", "compliance:strut {axis}:stiffness={1e6|2e6}")),
    "thermal and warm-up": (LATER, ("thermal_expansion:strut {axis}:coefficient={1.8e-5|2.4e-5}", "warm_up:strut {axis}:amplitude={1.5e-5|3e-5},"
                                    "time_constant={600|1500}")),
    "strut scale and print scale": (SOON, ("scale_error:strut {axis}:scale={5e-4|1e-3}", "print_scale:markers:scale={1e-3|3e-3}")),
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
        effects = () if truth is None else (placed(parse(truth), design),)
        self.world, self.truth = world.draw(design, np.random.default_rng(seed), 1.0, effects), truth
        self.title = "" if truth is None else f"{effects[0].name.replace('_', ' ')} at {effects[0].place}"

    def recorded(self, name, route) -> Recording:
        rng = np.random.default_rng([self.seed, *name.encode()])
        simulation.write(simulation.simulate(self.world, route, rng), self.folder / name, self.text, rng, NOISE)
        return recording.load(self.folder / name)

    def first(self, text) -> tuple[Recording, PlatformDiagnosis]:
        """(Recording, its diagnosis) of a first plan."""
        found = self.recorded("first", plan.build(self.design, text, self.seed))
        return found, diagnose(found)


def settle(case, first, found, pick) -> tuple[PlatformDiagnosis, int, float, list[tuple[float, bool]]]:
    """(diagnosis, extra poses, min, [(stated, settled)]) of experiments that pick(questions, number, min left) chooses."""
    parts, poses, minutes, stated = [first], 0, 0.0, []
    for number in range(1, LOOKS):
        asked = questions(found)
        chosen = pick(asked, number, BUDGET - minutes) if asked else None
        if chosen is None:
            break
        parts.append(case.recorded(f"{pick.__name__}{number}", chosen.plan))
        found = diagnose(together(parts).recording)
        poses, minutes = poses + len(chosen.plan.t), minutes + chosen.minutes
        stated.append((chosen.settles, not questions(found)))
    return found, poses, minutes, stated


def best(design) -> Callable[..., Experiment | None]:
    def chosen(asked, number, left):
        found, _ = choose(asked, design, kinds(("payload", "wait"), False), number, left)
        return found[0] if found and found[0].bits > 0.01 else None

    return chosen


def at_random(design, rng) -> Callable[..., Experiment | None]:
    def random(asked, number, left):
        for text in rng.permutation(kinds(("payload", "wait"), False)):
            try:
                found = evaluate(asked, design, str(text), number)
            except RigError:
                continue
            if found.minutes <= left:
                return found
        return None

    return random


def rows(rigs=12, quiet=6, draws=4) -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    start, alike, right, ratios, stated, skipped = time.process_time(), 0, 0, [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        rooms = {by: _rig(base / f"{by}.toml", by) for by in ("poses", "corners")}
        for number in range(rigs):
            name = list(PAIRS)[number % len(PAIRS)]
            route, both = PAIRS[name]
            design, text = rooms["corners" if "print" in name else "poses"]
            for draw in range(draws):
                seed = 1000 * number + draw
                rng = np.random.default_rng(seed)
                case = Case(base / str(seed), design, text, drawn(both[number // len(PAIRS) % 2], rng), seed)
                first, found = case.first(route)
                if questions(found):
                    break
                skipped += 1
                print(f"  {case.truth}: {names(found)}, nothing alike", file=sys.stderr, flush=True)
            else:
                continue
            alike += 1
            done, poses, minutes, told = settle(case, first, found, best(design))
            _, others, _, random = settle(case, first, found, at_random(design, rng))
            alone = names(done) == [case.title] and not questions(done)
            right, ratios, stated = right + alone, [*ratios, poses / max(others, 1)], [*stated, *told, *random]
            print(f"  {case.truth}: {names(done)} {'alone' if alone else 'NOT alone'}, {poses} poses in {minutes:.1f} min, at random {others}; "
                  f"{[(round(s, 2), h) for s, h in told]} random {[(round(s, 2), h) for s, h in random]}", file=sys.stderr, flush=True)
        still = sum(not names(Case(base / f"q{k}", *rooms["poses"], None, 90_000 + k).first(SOON)[1]) for k in range(quiet))
    said, happened = (float(np.mean([one[k] for one in stated])) if stated else np.nan for k in (0, 1))
    yield f"{alike} rigs left alike by the first recording ({skipped} drawn that were not): right name alone", f"{right}", ">= 90 %"
    yield "extra poses over those of random plans of the same kinds, median", f"{np.median(ratios) if ratios else np.nan:.2f}", "<= 0.5"
    yield f"chance to settle, of {len(stated)} experiments: as stated, as it happened", f"{said:.0%}, {happened:.0%}", "within 15 %"
    yield f"{quiet} rigs that hide nothing: nothing found, and no experiment", f"{still}", ">= 95 %"
    yield "processor time", f"{(time.process_time() - start) / 60:.1f} min", ""


def _rig(path, by):
    """(Design, text of rig.toml) of a rig whose poses an instrument measures, or which cameras see."""
    text = layout.layout(0.3) + (POSES if by == "poses" else "")
    path.write_text(text)
    return design_file.load(path), text


def names(found) -> list[str]:
    """Titles of a diagnosis' findings."""
    return [f"{e.name.replace('_', ' ')} at {e.place}" for e in found.effects]
