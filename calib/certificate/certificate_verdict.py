"""The verdict on a certificate: the evidence of its calibration, what was promised, and the tolerances it was held
against.
"""

from dataclasses import replace

from calib.certificate import certificate_sentences
from calib.certificate.certificate import Certificate
from calib.certify.calibration_evidence import confound_sentences
from calib.certify.tolerance_conformity import CONFORMS, FAILS
from rig.report.verdict import Evidence, Missing, Verdict, judge_evidence

SCALE = Missing(
    "nobody certified the scale of the lengths",
    "Have the base targets' scale certified and state it: `--scale-uncertainty 20e-6 --scale-source TEXT`",
)
TWICE = "Visit some configurations twice, `--plan sobol:40,repeat:20`: then the floor, repeatability, is known"
AGAIN = "Determine now and then whether it still holds: `rig watch calibration.json VISIT`"


def certificate_verdict(c: Certificate) -> Verdict:
    """The verdict of a certificate: against its tolerances, where it was asked for any; what it promises, where not."""
    said = certificate_sentences.conformity_lines(c) if c.conformity else [certificate_sentences.promise_line(c)]
    known = Evidence("") if c.known is None else c.known
    verdicts = {k.verdict for k in c.conformity}
    failed = tuple(f"{k.quantity} does not conform to its tolerance" for k in c.conformity if k.verdict == FAILS)
    missing = [*known.missing, *([SCALE] if c.asked.scale is None else [])]
    if verdicts - {CONFORMS, FAILS}:
        missing.append(Missing("whether all tolerances are kept cannot be said from these poses"))
    confounds = (
        [f"these recordings: {text}" for text in confound_sentences(c.confounds)]
        if c.known is None
        else known.confounds
    )
    steps = (*([TWICE] if c.repeatability.position is None else []), AGAIN)
    return judge_evidence(
        replace(
            known,
            statement="; ".join(line.removesuffix(".") for line in said),
            steps=steps,
            confounds=tuple(confounds),
            missing=tuple(missing),
            refuted=(*failed, *known.refuted),
        )
    )
