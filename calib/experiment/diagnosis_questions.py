"""A diagnosis -> the questions that an experiment could settle, by what was measured: only what that takes is
imported.
"""

from collections.abc import Sequence

from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.experiment.experiment_question import Question


def diagnosis_questions(d: Diagnosis) -> Sequence[Question]:
    """Questions of what a Diagnosis cannot tell apart, none where it can. Raises RigError for a machine of which no
    plan can be foretold.
    """
    if d.evidence.family == "joints":
        from calib.experiment.arm_questions import arm_questions

        return arm_questions(d)
    from calib.experiment.platform_questions import platform_questions

    return platform_questions(d)
