"""Questions and what an owner allows -> the plan that answers them best per minute, and the chance that it does."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.experiment.foretold import foretold
from calib.experiment.hypotheses import Question
from calib.experiment.record import SETTING_UP
from calib.experiment.worth import Worth, worth
from rig.design import Design
from rig.errors import RigError
from rig.plan import Plan, build

PARTS = ("sobol:12", "ladder:1", "axes:3", "repeat:12", "sobol:30")  # at whose exposures the struts stand
MOVING = ("moving:16", "zigzag:16", "zigzag:40")
WAITING = ("dwell:20", "sobol:8,wait:20,sobol:8", "sobol:8,wait:60,sobol:8")  # where waiting is allowed
LOADED = ("payload:6", "payload:14")  # where a payload is allowed
PAIRED = 3  # of the best that are tried two by two
ENOUGH = 0.8  # of the best chance to settle: among those with so much, the one that takes least counts


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """text : of the plan, as rig simulate --plan takes it; seed : of it; plan; minutes : it takes; bits : expected over all questions
    settles : chance that all of them are settled; asks : what an operator has to do besides, in words"""

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


def kinds(may: Sequence[str], standing: bool) -> list[str]:
    """Plans' texts to choose from. may : what an owner allows ("payload", "wait"); standing : whether the struts must stand to be exposed"""
    out = [*PARTS, *(() if standing else MOVING)]
    if "wait" in may:
        out += WAITING[1:] if standing else WAITING
    return out + [text for text in LOADED if "payload" in may and not standing]


def choose(asked: Sequence[Question], design: Design, texts: Sequence[str], seed: int, most: float = np.inf,
           progress: Callable[[int, int], None] | None = None) -> tuple[list[Experiment], dict[str, str]]:
    """([Experiment], the best first; {plan's text: why it is out of the question}).

    texts : plans to choose from, alone and two by two; seed : of them; most : minutes that one may take; progress : called with (done, of)
    """
    out: list[Experiment] = []
    refused: dict[str, str] = {}

    def tried(text: str) -> None:
        if progress:
            progress(len(out) + len(refused), len(texts) + PAIRED)
        try:
            found = evaluate(asked, design, text, seed)
        except RigError as error:
            refused[text] = str(error)
            return
        if found.minutes > most:
            refused[text] = f"it takes {found.minutes:.0f} min, of {most:.0f} that are left"
        else:
            out.append(found)

    for text in texts:
        tried(text)
    leading = sorted(out, key=lambda e: -e.rate)[:PAIRED]
    for a, b in combinations(leading, 2):
        tried(f"{a.text},{b.text}")
    return ranked(out), refused


def ranked(experiments: Sequence[Experiment]) -> list[Experiment]:
    """The best first: those of nearly the greatest chance to settle by what they tell per minute, then the others likewise."""
    best = max((e.settles for e in experiments), default=0.0)
    return sorted(experiments, key=lambda e: (e.settles < ENOUGH * best, -e.rate))


def evaluate(asked: Sequence[Question], design: Design, text: str, seed: int) -> Experiment:
    """Experiment of one plan. Raises RigError for one that the rig cannot follow."""
    plan = build(design, text, seed)
    found = [_worth(question, plan) for question in asked]
    minutes = float(plan.commands.t[-1]) / 60 + SETTING_UP
    changes = [(t, mass) for (_, before), (t, mass) in zip(plan.payload[:-1], plan.payload[1:]) if mass != before]
    asks = tuple(f"at t = {t:.0f} s: {f'load {mass:.3g} kg' if mass else 'take the load off'}" for t, mass in changes)
    settles = float(np.prod([0.0 if question.unasked else one.settles for question, one in zip(asked, found)]))
    return Experiment(text, seed, plan, minutes, sum(one.bits for one in found), settles, asks)


def _worth(question: Question, plan: Plan) -> Worth:
    return worth(np.array([h.odds for h in question.hypotheses]), foretold(question, plan))
