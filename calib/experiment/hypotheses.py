"""A diagnosis -> questions: for each finding, the hypotheses that are still alike, each fitted with all that is free, and their odds."""

from dataclasses import dataclass

import numpy as np

from calib.diagnose.engine.policy import PLATFORM
from calib.diagnose.engine.score import Alternative
from calib.diagnose.engine.select import Finding
from calib.diagnose.problems.platform.diagnose import PlatformDiagnosis
from calib.diagnose.problems.platform.problem import PlatformProblem
from calib.diagnose.problems.platform.refine import Refined
from calib.diagnose.report.schema import UNKNOWN
from rig.effects.base import Effect
from rig.effects.coordinate import Coordinate
from rig.errors import RigError

FOREIGN = 0.05  # of all odds, for what is in no catalogue


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One explanation of a finding. name, place; odds : share of all, 0..1; refined : Refined with it in the finding's place, or None where it
    cannot be fitted (a temperature that nobody logs); number : of it among the effects of `refined`
    by_data : how much less likely than the finding the data so far make it, as minus twice a logarithm, whatever either costs in simplicity"""

    name: str
    place: str
    odds: float
    refined: Refined | None
    number: int
    by_data: float = 0.0

    @property
    def title(self) -> str:
        """As "creep at strut 3"."""
        return f"{self.name.replace('_', ' ')} at {self.place}" if self.name != UNKNOWN else "something in no catalogue"

    @property
    def fitted(self) -> Refined:
        """Refined with it. Raises ValueError where there is none."""
        if self.refined is None:
            raise ValueError(f"{self.title} cannot be fitted")
        return self.refined


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """Hypotheses of one finding, its own first, something in no catalogue last; what cannot be fitted is left out and named in `unasked`."""

    hypotheses: tuple[Hypothesis, ...]
    unasked: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[Hypothesis, ...]:
        """Those with a name."""
        return tuple(h for h in self.hypotheses if h.name != UNKNOWN)


def questions(diagnosis: PlatformDiagnosis) -> list[Question]:
    """[Question] of what a diagnosis cannot tell apart, none where it can. Raises RigError for a rig of which no plan can be foretold."""
    d, fit = diagnosis, diagnosis.selection.fit
    size = fit.refined.model.size
    open_ones = [f for f in d.selection.findings if any(not told_apart(f, a, size) for a in f.alternatives)]
    if not open_ones:
        return []
    point = d.selection.before.refined.point
    if not point.axes or point.moving:
        raise RigError("an experiment is foretold for platforms that are commanded, and cameras that stand still")
    problem = PlatformProblem(point, list(fit.terms), given=d.given)
    out = []
    for finding in open_ones:
        own = fit.terms[finding.number]
        found: list[tuple[str, str, float, Refined | None, int, float]] = [(own.name, own.place, 0.0, fit.refined, finding.number, 0.0)]
        bare, unasked = problem.remove_term(fit, finding.number), []
        for a in (a for a in finding.alternatives if not told_apart(finding, a, size)):
            candidate = a.score.candidate
            try:
                refined = problem.add_term(bare, a.score).refined
            except RigError as error:
                unasked.append(f"{candidate.name.replace('_', ' ')} at {candidate.place}: {error}")
                continue
            found.append((candidate.name, candidate.place, a.behind, refined, len(bare.terms), by_data(finding, a, size)))
        weights = np.exp(-np.array([behind for _, _, behind, *_ in found]) / 2)
        shares = (1 - FOREIGN) * weights / weights.sum()
        hypotheses = [Hypothesis(name, place, float(share), refined, number, data)
                      for (name, place, _, refined, number, data), share in zip(found, shares)]
        out.append(Question((*hypotheses, Hypothesis(UNKNOWN, own.place, FOREIGN, fit.refined, finding.number)), tuple(unasked)))
    return out


def told_apart(finding: Finding, alternative: Alternative, size: int) -> bool:
    """Whether an alternative is out of the question: too unlikely, and where it does nearly the same, by the data alone, not by what it costs."""
    same = abs(alternative.cosine) > PLATFORM.cosine
    return alternative.behind >= PLATFORM.alike and (not same or by_data(finding, alternative, size) >= PLATFORM.alike)


def by_data(finding: Finding, alternative: Alternative, size: int) -> float:
    """How much less likely the data make an alternative than its finding, as minus twice a logarithm, whatever either costs in simplicity."""
    return float(alternative.behind - alternative.score.complexity(size) + finding.score.complexity(size))


def beforehand(coordinates: list[Coordinate], effects: tuple[Effect, ...]) -> np.ndarray:
    """(c,) standard deviations of coordinates by what rigs show, so that what no data hold stays within reason."""
    out = []
    for c in coordinates:
        parameter = next(p for p in effects[c.effect].parameters_at(effects[c.effect].place) if p.name == c.name)
        low, high = parameter.usual
        wide = {"log": np.log(high / low) if low > 0 else 1.0, "phase": np.pi, "inverse": 1 / low if low > 0 else 1.0}
        out.append(wide.get(c.role, 3 * max(abs(low), abs(high))))
    return np.array(out)
