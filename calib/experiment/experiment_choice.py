"""Choice of the next experiment: the plan that answers open questions best per minute."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calib.experiment.experiment_information import (
    NAME,
    Information,
    discriminating_configurations,
    experiment_information,
)
from calib.experiment.experiment_question import Question
from calib.experiment.investigation_folder import SETTING_UP
from rig.arrays import Floats
from rig.errors import RigError
from rig.model.cube_remounting import quarter_turns, turning_instructions
from rig.model.design import Design, Permission
from rig.planning.plan import build_plan
from rig.planning.plan_construction_and_table import Plan

PARTS = ("sobol:12", "ladder:1", "axes:3", "repeat:12", "sobol:30", "sobol:90")  # at whose exposures the struts stand
CHOSEN = (8, 16, 32, 64)  # configurations where the likeliest names come apart, see `discriminating_configurations`
MOVING = ("moving:16", "zigzag:16", "zigzag:40")
WAITING = ("dwell:20", "sobol:8,wait:20,sobol:8", "sobol:8,wait:60,sobol:8")  # where waiting is allowed
LOADED = ("payload:6", "payload:14")  # where a payload is allowed
TURNED = ("sobol:12", "sobol:30", "sobol:90")  # with a cube put back turned, where that is allowed
TURN = "turn:"  # part of a plan
TURNING = 3.0  # min that an operator takes for it
PAIRED = 3  # of the best that are tried two by two
DAYS = (-1.0, 0.0, 1.0)  # K by which the room may be warmer than it was: nobody heats or cools it for an experiment
HOPELESS = 0.02  # chance to settle; of plans with less than this counts what they tell per minute


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """text : of the plan, in which apart:N stands for configurations chosen for these questions; seed : of it; plan;
    minutes : it takes
    bits : expected over all questions; settles : chance that all of them are settled; asks : what an operator has to do
        besides, in words"""

    text: str
    seed: int
    plan: Plan
    minutes: float
    bits: float
    settles: float
    asks: tuple[str, ...] = ()

    @property
    def rate(self) -> float:
        """Bits per minute."""
        return self.bits / self.minutes


def available_plans(
    allowed_actions: Sequence[str], must_stand_still: bool, turned_cubes: Sequence[str] = ()
) -> list[str]:
    """Texts of the available plans. allowed_actions : what an owner allows besides moving
    allowed_actions : what an owner allows ("payload", "wait", "turn cube NAME"); must_stand_still : whether the struts
        must stand to be
    exposed; turned_cubes : cubes that were turned already
    """
    out = [*PARTS, *(f"{NAME}:{count}" for count in CHOSEN), *(() if must_stand_still else MOVING)]
    if "wait" in allowed_actions:
        out += WAITING[1:] if must_stand_still else WAITING
    out += [
        f"{TURN}{name},{text}"
        for name in Permission(tuple(allowed_actions)).cubes
        if name not in turned_cubes
        for text in TURNED
    ]
    return out + [text for text in LOADED if "payload" in allowed_actions and not must_stand_still]


def choose_experiment(
    open_questions: Sequence[Question[object]],
    design: Design,
    plan_texts: Sequence[str],
    seed: int,
    most_minutes: float = np.inf,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[Experiment], dict[str, str]]:
    """([Experiment], the best first; {plan's text: why it is excluded}).

    plan_texts : plans to choose from, alone and two by two; seed : of them; most_minutes : minutes that one may take;
        progress : called with (done, of)
    """
    out: list[Experiment] = []
    refused: dict[str, str] = {}
    own: dict[str, Floats] = {}
    try:
        own = _plan_configurations(open_questions, design, plan_texts, seed)
    except RigError as error:
        refused = {text: str(error) for text in plan_texts if text.startswith(NAME)}

    def tried(text: str) -> None:
        if progress:
            progress(len(out) + len(refused), len(plan_texts) + PAIRED)
        try:
            found = evaluate_experiment(open_questions, design, text, seed, own)
        except RigError as error:
            refused[text] = str(error)
            return
        if found.minutes > most_minutes:
            refused[text] = f"it takes {found.minutes:.0f} min, of {most_minutes:.0f} that are left"
        else:
            out.append(found)

    for text in plan_texts:
        if text not in refused:
            tried(text)
    leading = sorted(out, key=lambda e: -e.rate)[:PAIRED]
    for a, b in combinations(leading, 2):
        first, then = (b.text, a.text) if TURN in b.text else (a.text, b.text)  # a cube is turned before all else
        if TURN not in then:
            tried(f"{first},{then}")
    return rank_experiments(out), refused


def rank_experiments(experiments: Sequence[Experiment]) -> list[Experiment]:
    """Experiments ranked, the best first: by time to settle all questions, then by information per minute."""
    return sorted(experiments, key=lambda e: (e.minutes / e.settles if e.settles >= HOPELESS else np.inf, -e.rate))


def _plan_configurations(
    open_questions: Sequence[Question[object]], design: Design, texts: Sequence[str], seed: int
) -> dict[str, Floats]:
    """{apart:N: configurations (N, axes)} of those plans' texts that ask for them, the first of one choice. Raises
    RigError where the rig cannot visit what is to be chosen from, and where no question has two names to come apart"""
    counts = sorted(int(text.partition(":")[2]) for text in texts if text.startswith(f"{NAME}:"))
    if not counts:
        return {}
    found = discriminating_configurations(open_questions, design, counts[-1], seed)
    return {f"{NAME}:{count}": found[:count] for count in counts}


def evaluate_experiment(
    open_questions: Sequence[Question[object]],
    design: Design,
    plan_text: str,
    seed: int,
    chosen_configurations: Mapping[str, Floats] | None = None,
) -> Experiment:
    """Experiment of one plan, evaluated. Raises RigError for a plan that the rig cannot follow.
    chosen_configurations : {apart:N: (N, axes)} of `_plan_configurations`. Raises RigError for one that the rig cannot
        follow.
    """
    plan, stands = build_plan(design, plan_text, seed, own_parts=chosen_configurations), quarter_turns(design)
    todo = turning_instructions(dict(plan.turned), stands)
    plan = replace(plan, turned=tuple({**stands, **dict(plan.turned)}.items()))
    found = [_worth(question, plan) for question in open_questions]
    minutes = float(plan.commands.t[-1]) / 60 + SETTING_UP + TURNING * len(todo)
    changes = [(t, mass) for (_, before), (t, mass) in zip(plan.payload[:-1], plan.payload[1:]) if mass != before]
    asks = (
        *(f"before it begins: {text}" for text in todo),
        *(f"at t = {t:.0f} s: {f'load {mass:.3g} kg' if mass else 'take the load off'}" for t, mass in changes),
    )
    settles = float(
        np.prod([0.0 if question.not_asked else one.settles for question, one in zip(open_questions, found)])
    )
    return Experiment(plan_text, seed, plan, minutes, sum(one.bits for one in found), settles, asks)


def _worth(question: Question[object], plan: Plan) -> Information:
    """Information of a plan for one question; where a hypothesis follows a temperature, over days as warm as the first
    recording's and others.
    """
    odds, behind = (np.array([getattr(h, name) for h in question.hypotheses]) for name in ("odds", "data_log_odds"))
    found = [
        experiment_information(odds, question.predict_outcomes(plan, warmer), behind)
        for warmer in (DAYS if question.follows_temperature else (0.0,))
    ]
    return Information(
        *(float(np.mean([getattr(one, name) for one in found])) for name in ("bits", "settles", "right"))
    )
