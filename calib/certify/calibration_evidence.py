"""What speaks for and against a calibration, as evidence for the one judgement of it that every page and command
shows.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.certify.calibration import Calibration
from calib.certify.calibration_verdict import WHERE, claim_lines, refutation_sentence
from calib.certify.claim_verification import Verification, verify_claim
from calib.certify.distinct_configurations import axis_ranges, configuration_numbers
from calib.certify.held_out_errors import HeldOut
from calib.certify.workspace_claim import Claim
from calib.samples.confounded_conditions import Confounds
from calib.samples.pose_samples import Samples
from rig.report.refutations import Refutation
from rig.report.verdict import LOOK, Evidence, Missing, State, Verdict, judge_evidence

MORE = (
    "Record more distinct configurations: `rig plan RIG.toml --for parameters --out plan.csv` chooses those that "
    "tell most"
)
ONWARD = (
    "Take another recording and hold the calibration against it: `rig certify calibration.json OTHER-REC "
    "--out certificate.html`",
    "Compute commands that bring the poses you want: `rig correct calibration.json --poses wanted.csv --out "
    "commands.csv`",
)
TAKE_IN = (
    "Determine what is left out: `rig diagnose REC --out found`; take it in: `rig calibrate REC --diagnosis "
    "found --out calibration.json`"
)


class OfCalibrations(NamedTuple):
    """What is known of calibrations made from a recording, which holds for all else that is learnt from it.
    refuted : which are, and by what, and
    unexplained : what they leave so, a sentence each"""

    refuted: tuple[str, ...] = ()
    unexplained: tuple[str, ...] = ()


ALONE = OfCalibrations()  # of a recording from which none was made


def calibration_verdict(calibration: Calibration, refutations: Sequence[Refutation] = ()) -> Verdict:
    """The Verdict on a calibration. refutations : of its file, by later recordings"""
    return judge_evidence(calibration_evidence(calibration, refutations))


def calibration_evidence(
    calibration: Calibration,
    refutations: Sequence[Refutation] = (),
    statement: str | None = None,
    steps: Sequence[str] = ONWARD,
) -> Evidence:
    """Evidence for a calibration. refutations : of its file, by later recordings; statement : in place of its own;
    steps : where it is good
    """
    claim = calibration.claim
    said = "this calibration claims nothing" if claim is None else claim_lines(claim)[0]
    missing, refuted = list(_missing(calibration)), [one.line for one in refutations if one.state == State.BAD]
    if claim is not None and claim.ratio is not None:
        if claim.ratio[2] < 1:
            refuted.append("the owner's own model does better")
        elif claim.ratio[1] <= 1:
            missing.append(Missing("it is not shown to be better than the owner's own model", MORE))
    unexplained = () if claim is None else claim.unexplained
    if calibration.physics is not None:
        nameless = [u.place for u in calibration.physics.unknown if not u.corrected]
        unexplained = (*unexplained, *(f"nothing in the catalogue explains what is at {place}" for place in nameless))
    doubted = tuple(one.line for one in refutations if one.state != State.BAD)
    return Evidence(
        said if statement is None else statement,
        tuple(steps),
        error_to_claim_ratio(calibration.held_out, claim),
        (*unexplained, *doubted),
        confound_sentences(calibration.confounds),
        tuple(missing),
        tuple(refuted),
        LOOK if calibration.correction.nominal.kind == "chain" else TAKE_IN,
    )


def evidence_with_verification(
    known: Evidence, found: Verification | None, by: str = "", look: str | None = None
) -> Evidence:
    """Evidence with what a held-out recording says of the claim. found : Verification, None where no factor is claimed

    by : the recording, where the sentence names it; look : the step where the claim is refuted, that of known by
        default
    """
    if found is None:
        return known
    if found.offset is not None and found.offset.kept:
        moved = Missing(
            f"the {WHERE[found.offset.of]} stands elsewhere",
            "Seat targets and instrument anew, or state where they stand in rig.toml",
        )
        return replace(known, missing=(*known.missing, moved))
    if found.refutes:
        said = f"the claim is NOT kept{by and f' by {by}'}: {refutation_sentence(found)}"
        return replace(known, refuted=(said, *known.refuted), look=known.look if look is None else look)
    ratios = [part.of_allowed for part in found.parts.values()] + ([] if known.held_out is None else [known.held_out])
    return replace(known, held_out=max(ratios, default=None))


def of_samples(calibration: Calibration, samples: Samples, rng: np.random.Generator) -> Verification | None:
    """Verification of a Calibration's claim by samples as `Calibration.told` gives them, None where no factor is
    claimed.
    """
    if calibration.claim is None or calibration.claim.after is None:
        return None
    label = configuration_numbers(samples.commanded, axis_ranges(calibration.correction.nominal))
    return verify_claim(calibration.correction.predict(samples.effective), samples, label, calibration.claim, rng)


def with_design(
    known: Evidence, calibration: Calibration, confounds: Sequence[Confounds | None], which: str
) -> Evidence:
    """Evidence for a calibration with what the designs of held-out recordings confound, where its own recording's is
    not known.

    Only what that does not separate can have gone into the correction. which : the recordings, in words
    """
    if calibration.confounds is not None:
        return known
    return replace(
        known,
        confounds=tuple(
            dict.fromkeys(
                [*known.confounds, *(f"{which}: {said}" for one in confounds for said in confound_sentences(one))]
            )
        ),
    )


def error_to_claim_ratio(held: HeldOut | None, claim: Claim | None) -> float | None:
    """Held-out RMS error over what claim and noise allow, the greater of position's and rotation's; None where nothing
    was held out or claimed.
    """
    if held is None or claim is None or claim.after is None:
        return None
    found = []
    for size, three, floor in zip((held.after.position[0], held.after.rotation[0]), claim.after, held.floor):
        allowed = math.hypot(three[2], floor)
        if math.isfinite(size) and math.isfinite(allowed) and three[2] > 0:
            found.append(size / allowed)
    return max(found, default=None)


def confound_sentences(confounds: Confounds | None) -> tuple[str, ...]:
    """What a recording's design cannot separate, a sentence; nothing where it can, or states no conditions."""
    return (confounds.line().split("; record the same")[0],) if confounds is not None and confounds.serious else ()


def _missing(calibration: Calibration) -> list[Missing]:
    claim = calibration.claim
    if claim is None:
        return [Missing("nothing is claimed", MORE)]
    if claim.ratio is None:
        return [Missing("it is not known how the correction does at other configurations", MORE)]
    return []
