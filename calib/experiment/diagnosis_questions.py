"""A diagnosis -> the questions that an experiment could settle, by what was measured: only what that takes is
imported.

Poses of an instrument are as sure as its others; of cameras, as their images will tell, with what cameras and lenses
add to all alike.

Geometry and the sizes of all that is admitted are as sure as the recordings so far leave them; a lag's or a
friction's own shape is taken as found.
"""

from collections.abc import Sequence

from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.experiment.experiment_question import Question


def diagnosis_questions(d: Diagnosis) -> Sequence[Question[object]]:
    """Questions of what a Diagnosis cannot tell apart, none where it can. Raises RigError for a machine of which no
    plan can be foretold.
    """
    if d.evidence.family == "joints":
        from calib.experiment.arm_questions import arm_questions

        return arm_questions(d)
    from calib.experiment.platform_questions import platform_questions

    return platform_questions(d)
