"""Choice of the next experiment after a diagnosis.

The choice of the plan that answers open questions best.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from calib.certification.platform_certification import Progress
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.experiment.experiment_questions_and_information import (
    NAME,
    Information,
    Question,
    camera_information_shares,
    discriminating_configurations,
    experiment_information,
)
from calib.experiment.investigation_folder_and_report import SETTING_UP
from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.model.design import PERMITTED, TURN, Design, Permission, quarter_turns_of_cubes
from rig.model.design_contradictions_and_cube_quarter_turns import cube_turn_permission_or_problem, turning_instructions
from rig.planning import timed_plan_and_visiting_order
from rig.planning.recording_plan import build_plan
from rig.planning.timed_plan_and_visiting_order import Plan
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html

PARTS = ("sobol:12", "ladder:1", "axes:3", "repeat:12", "sobol:30", "sobol:90")  # at whose exposures the struts rest
CHOSEN = (8, 16, 32, 64)  # configurations where the likeliest names come apart, see `discriminating_configurations`
MOVING = ("moving:16", "zigzag:16", "zigzag:40")
WAITING = ("dwell:20", "sobol:8,wait:20,sobol:8", "sobol:8,wait:60,sobol:8")  # where waiting is allowed
LOADED = ("payload:6", "payload:14")  # where a payload is allowed
TURNED = ("sobol:12", "sobol:30", "sobol:90")  # with a cube put back turned, where that is allowed
PLAN_TURN = "turn:"  # part of a plan
TURNING = 3.0  # min that an operator takes for it
PAIRED = 3  # of the best that are tried two by two
DAYS = (-1.0, 0.0, 1.0)  # K by which the room may be warmer than it was: nobody heats or cools it for an experiment
TELLING = 0.01  # bits; a plan that tells less tells nothing
LONGEST = 6000.0  # min that an experiment may take
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


def available_experiment_plan_texts(
    allowed_actions: Sequence[str], must_stand_still: bool, turned_cubes: Sequence[str] = ()
) -> list[str]:
    """Texts of the plans available under what an owner allows.

    allowed_actions : what an owner allows besides moving ("payload", "wait", "turn cube NAME")
    must_stand_still : whether the struts must stand to be exposed; turned_cubes : cubes that were turned already
    """
    out = [*PARTS, *(f"{NAME}:{count}" for count in CHOSEN), *(() if must_stand_still else MOVING)]
    if "wait" in allowed_actions:
        out += WAITING[1:] if must_stand_still else WAITING
    out += [
        f"{PLAN_TURN}{name},{text}"
        for name in Permission(tuple(allowed_actions)).cubes
        if name not in turned_cubes
        for text in TURNED
    ]
    return out + [text for text in LOADED if "payload" in allowed_actions and not must_stand_still]


def ranked_experiments_and_excluded_plans(
    open_questions: Sequence[Question[object]],
    design: Design,
    plan_texts: Sequence[str],
    seed: int,
    minutes_limit: float = np.inf,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[Experiment], dict[str, str]]:
    """Experiments on open questions, the best first, with the plans excluded.

    plan_texts : plans to choose from, alone and two by two; seed : of them; minutes_limit : minutes that one may take;
        progress : called with (done, of)
    Returns ([Experiment], {plan text: reason})
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
        if found.minutes > minutes_limit:
            refused[text] = f"it takes {found.minutes:.0f} min, of {minutes_limit:.0f} that are left"
        else:
            out.append(found)

    for text in plan_texts:
        if text not in refused:
            tried(text)
    leading = sorted(out, key=lambda e: -e.rate)[:PAIRED]
    for a, b in combinations(leading, 2):
        first, then = (b.text, a.text) if PLAN_TURN in b.text else (a.text, b.text)  # a cube is turned before all else
        if PLAN_TURN not in then:
            tried(f"{first},{then}")
    return rank_experiments(out), refused


def rank_experiments(experiments: Sequence[Experiment]) -> list[Experiment]:
    """Experiments ranked, the best first.

    By time to settle all questions, then by information per minute.
    """
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
    """Experiment of one plan, evaluated.

    chosen_configurations : {apart:N: (N, axes)} of `_plan_configurations`
    Raises RigError for a plan that the rig cannot follow.
    """
    plan, stands = (
        build_plan(design, plan_text, seed, additional_parts=chosen_configurations),
        quarter_turns_of_cubes(design),
    )
    todo = turning_instructions(dict(plan.turned), stands)
    plan = replace(plan, turned=tuple({**stands, **dict(plan.turned)}.items()))
    found = [_plan_information(question, plan) for question in open_questions]
    minutes = float(plan.commands.t[-1]) / 60 + SETTING_UP + TURNING * len(todo)
    changes = [(t, mass) for (_, before), (t, mass) in zip(plan.payload[:-1], plan.payload[1:]) if mass != before]
    asks = (
        *(f"before it begins: {text}" for text in todo),
        *(f"at t = {t:.0f} s: {f'load {mass:.3g} kg' if mass else 'take the load off'}" for t, mass in changes),
    )
    settles = float(
        np.prod([0.0 if question.not_tested else one.settles for question, one in zip(open_questions, found)])
    )
    return Experiment(plan_text, seed, plan, minutes, sum(one.bits for one in found), settles, asks)


def _plan_information(question: Question[object], plan: Plan) -> Information:
    """Information of a plan for one question; where a hypothesis follows a temperature, over days as warm as the first
    recording's and others.
    """
    odds, behind = (np.array([getattr(h, name) for h in question.hypotheses]) for name in ("odds", "deviance"))
    found = [
        experiment_information(odds, question.predict_outcomes(plan, warmer), behind)
        for warmer in (DAYS if question.follows_temperature else (0.0,))
    ]
    return Information(
        *(float(np.mean([getattr(one, name) for one in found])) for name in ("bits", "settles", "right"))
    )


SHOWN = 4  # plans that are compared in words


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class NextExperiment(OneLineRepr):
    """questions : what is alike; experiments : that would tell it apart, the best first; refused : {plan: why it is
    none}; cameras : {camera: share of what the first experiment shows in images}; axes : of the machine
    """

    questions: Sequence[Question[object]]
    experiments: Sequence[Experiment]
    refused: dict[str, str]
    cameras: dict[str, float]
    axes: tuple[str, ...]

    def __str__(self) -> str:
        return self.lines()[-1 if not self.experiments else len(_odds_lines(self.questions))]

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.lines())

    def lines(self) -> list[str]:
        """What is alike with odds, and the best plan with its chance."""
        if not self.questions:
            return ["nothing is ambiguous that an experiment could resolve"]
        none = [
            "no plan that is allowed distinguishes these",
            *(f"  {text}: {why}" for text, why in self.refused.items()),
        ]
        return [
            *_odds_lines(self.questions),
            *(_experiment_lines(self.experiments, self.cameras) if self.experiments else none),
        ]

    def write_plan(self, path: Path) -> None:
        """Write the best plan, as `rig simulate --plan commands:FILE` takes it. Raises ValueError where there is
        none
        """
        if not self.experiments:
            raise ValueError("there is no experiment to write")
        timed_plan_and_visiting_order.write_plan_table(path, self.experiments[0].plan, self.axes)

    def tree(self) -> Json:
        """What next.json holds."""
        return {
            "schema": "next/1",
            "questions": [
                {
                    "finding": question.named[0].title,
                    "unasked": list(question.not_tested),
                    "hypotheses": [{"title": h.title, "odds": h.odds} for h in question.hypotheses],
                }
                for question in self.questions
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
                for e in self.experiments
            ],
            "cameras": self.cameras,
        }


def _odds_lines(questions: Sequence[Question[object]]) -> list[str]:
    """What is alike, with odds."""
    out = ["ambiguous: " + ", ".join(f"{h.title} {h.odds:.2f}" for h in question.hypotheses) for question in questions]
    return out + [f"cannot be predicted: {text}" for question in questions for text in question.not_tested]


def _experiment_lines(experiments: Sequence[Experiment], seen: dict[str, float]) -> list[str]:
    """The best plan, its chance, what it asks of an operator, and the plans that it was preferred to. seen : {camera:
    share of what it shows}
    """
    best = experiments[0]
    out = [
        f"next: {best.text} (seed {best.seed}), {len(best.plan.t)} exposures, {best.minutes:.1f} min; it "
        "settles this with a chance of "
        f"{best.settles:.0%} and yields {best.bits:.2f} bits"
    ]
    out += [f"  operator, {text}" for text in best.asks]
    out += ["  seen by " + ", ".join(f"{name} {share:.0%}" for name, share in seen.items())] if seen else []
    return out + [
        f"  rather than {e.text}: {e.settles:.0%}, {e.bits:.2f} bits in {e.minutes:.1f} min"
        for e in experiments[1:SHOWN]
    ]


@dataclass(frozen=True, slots=True)
class ExperimentOptions:
    """minutes : that the experiment may take; may : what may be asked of an operator ("payload", "wait", "turn cube
    NAME"), None for what rig.toml says; standing : whether the struts must stand to be exposed; seed : of the plan
    """

    minutes: float = 60.0
    may: tuple[str, ...] | None = None
    standing: bool = False
    seed: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.minutes <= LONGEST:
            raise RigError(f"--minutes takes a time above 0 and up to {LONGEST:g} min, not {self.minutes:g}")
        for word in self.may or ():
            if word not in PERMITTED and not word.startswith(TURN):
                raise RigError(f"--may takes {', '.join(PERMITTED)} or '{TURN}NAME', not {word!r}")

    def interventions(self, design: Design) -> tuple[str, ...]:
        """What an experiment may ask of an operator, cubes by their names. Raises RigError for a cube that the design
        does not have
        """
        out = []
        for word in self.may or design.experiment.may:
            may, problem = cube_turn_permission_or_problem(word, design.targets)
            if problem:
                raise RigError(f"--may {word!r}: {problem}")
            out.append(may)
        return tuple(out)


def next_experiment(
    questions: Sequence[Question[object]], design: Design, options: ExperimentOptions, progress: Progress
) -> NextExperiment:
    """NextExperiment that best resolves what a diagnosis leaves ambiguous.

    progress : called with (label, done, of)
    """
    if not questions:
        return NextExperiment((), (), {}, {}, design.mechanism.axes)
    texts = available_experiment_plan_texts(
        options.interventions(design), options.standing, tuple(quarter_turns_of_cubes(design))
    )
    experiments, refused = ranked_experiments_and_excluded_plans(
        questions,
        design,
        texts,
        options.seed,
        options.minutes,
        lambda done, of: progress("predicting experiments", done, of),
    )
    experiments = [e for e in experiments if e.bits >= TELLING]
    seen = camera_information_shares(questions, experiments[0].plan) if experiments else {}
    return NextExperiment(questions, experiments, dict(refused), seen, design.mechanism.axes)


def diagnosis_questions(diagnosis: Diagnosis) -> Sequence[Question[object]]:
    """Questions of a Diagnosis.

    They are of what it cannot tell apart, none where it can.
    Raises RigError for a machine of which no plan can be foretold.
    """
    if diagnosis.evidence.family == "joints":
        from calib.experiment.arm_diagnosis_questions_and_predicted_recording import open_questions_of_arm_diagnosis

        return open_questions_of_arm_diagnosis(diagnosis)
    from calib.experiment.platform_diagnosis_questions import open_questions_of_platform_diagnosis

    return open_questions_of_platform_diagnosis(diagnosis)
