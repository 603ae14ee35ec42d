"""A platform's diagnosis -> questions: for each finding, the hypotheses that are still alike, each fitted with all that
is free, and their odds.
"""

from calib.diagnosis.problems.platform.platform_problem import PlatformProblem
from calib.diagnosis.problems.platform.simultaneous_refinement import Refined
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.experiment.experiment_question import Rival, data_log_odds, is_ruled_out, rival_hypotheses
from calib.experiment.platform_outcome_prediction import PlatformQuestion
from rig.errors import RigError


def platform_questions(diagnosis: Diagnosis) -> list[PlatformQuestion]:
    """[PlatformQuestion] of what a diagnosis cannot tell apart, none where it can. Raises RigError for a rig of which
    no plan can be foretold.
    """
    d, fit = diagnosis, diagnosis.selection.fit
    size = fit.refined.model.size
    open_ones = [f for f in d.selection.findings if any(not is_ruled_out(f, a, size) for a in f.alternatives)]
    if not open_ones:
        return []
    point = d.selection.before.refined.point
    if not point.axes or point.moving:
        raise RigError("an experiment is foretold for platforms that are commanded, and cameras that stand still")
    problem = PlatformProblem(point, list(fit.terms), given=d.options.given)
    out = []
    for finding in open_ones:
        own = fit.terms[finding.number]
        found: list[Rival[Refined]] = [Rival(own.name, own.place, 0.0, fit.refined, finding.number)]
        bare, unasked = problem.remove_term(fit, finding.number), []
        for a in (a for a in finding.alternatives if not is_ruled_out(finding, a, size)):
            candidate = a.score.candidate
            try:
                refined = problem.add_term(bare, a.score).refined
            except RigError as error:
                unasked.append(f"{candidate.name.replace('_', ' ')} at {candidate.place}: {error}")
                continue
            found.append(
                Rival(
                    candidate.name, candidate.place, a.behind, refined, len(bare.terms), data_log_odds(finding, a, size)
                )
            )
        out.append(PlatformQuestion(rival_hypotheses(found), tuple(unasked)))
    return out
