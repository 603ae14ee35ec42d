"""The next experiment of a diagnosis: what is alike, the plan that would best tell it apart, and the chance that it
does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calib.api.experiment_options import ExperimentOptions
from calib.certification.platform_certification import Progress
from calib.experiment.experiment_choice import Experiment, available_plans, choose_experiment
from calib.experiment.experiment_information import camera_information_shares
from calib.experiment.experiment_question import Question
from rig.formats.json_tree import Json
from rig.model.cube_remounting import quarter_turns
from rig.model.design import Design
from rig.planning import plan_construction_and_table
from rig.report.pages.html_elements import result_html

SHOWN = 4  # plans that are compared in words
TELLING = 0.01  # bits; a plan that tells less tells nothing


@dataclass(frozen=True, slots=True, eq=False)
class NextExperiment:
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
            return ["nothing is alike that an experiment could tell apart"]
        none = [
            "no plan that is allowed tells these apart",
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
        plan_construction_and_table.write_plan_table(path, self.experiments[0].plan, self.axes)

    def tree(self) -> Json:
        """What next.json holds."""
        return {
            "schema": "next/1",
            "questions": [
                {
                    "finding": question.named[0].title,
                    "unasked": list(question.not_asked),
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


def next_experiment(
    questions: Sequence[Question[object]], design: Design, options: ExperimentOptions, progress: Progress
) -> NextExperiment:
    """NextExperiment that tells best what a diagnosis leaves alike; progress : called with (label, done, of)."""
    if not questions:
        return NextExperiment((), (), {}, {}, design.mechanism.axes)
    texts = available_plans(options.interventions(design), options.standing, tuple(quarter_turns(design)))
    experiments, refused = choose_experiment(
        questions,
        design,
        texts,
        options.seed,
        options.minutes,
        lambda done, of: progress("foretelling experiments", done, of),
    )
    experiments = [e for e in experiments if e.bits >= TELLING]
    seen = camera_information_shares(questions, experiments[0].plan) if experiments else {}
    return NextExperiment(questions, experiments, dict(refused), seen, design.mechanism.axes)


def _odds_lines(questions: Sequence[Question[object]]) -> list[str]:
    """What is alike, with odds."""
    out = ["alike: " + ", ".join(f"{h.title} {h.odds:.2f}" for h in question.hypotheses) for question in questions]
    return out + [f"cannot be foretold: {text}" for question in questions for text in question.not_asked]


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
