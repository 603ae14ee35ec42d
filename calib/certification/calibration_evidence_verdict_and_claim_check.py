"""Evidence, verdict and claim check of a calibration.

Evidence is for and against it; the check of its claim is on a held-out recording.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import (
    WHERE,
    Calibration,
    claim_lines,
    refutation_sentence,
)
from calib.certification.claim_verification import Part, Verification, verify_claim
from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.certification.held_out_pose_error_statistics import HeldOut, pose_errors, predicted_poses
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    axis_travel_limits,
    configuration_numbers,
)
from calib.models.platform.platform_identification import inverse_strut_length_jacobian
from calib.samples.commanded_and_measured_pose_samples import Samples
from calib.samples.position_confounds_and_poses_on_one_clock import Confounds, confound_sentences
from rig.effects.framework.unmodelled_curve_and_formula_quantities import TIME
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_struts
from rig.report.verdict_refutations_and_result_display import (
    LOOK,
    Evidence,
    MissingEvidence,
    Refutation,
    State,
    Verdict,
    judge_evidence,
)

MORE = (
    "Record more distinct configurations: `rig plan RIG.toml --for parameters --out plan.csv` chooses those that "
    "determine most"
)
BOTH_SIDES = (
    "Approach every pose from the side as recorded, or record poses in a balanced order, as --plan sobol:N of "
    "`rig run` visits them"
)
EVERYWHERE = (
    "Record poses all over the workspace, as --plan sobol:N of `rig run` spreads them, or use the machine where it was "
    "recorded"
)
ONWARD = (
    "Take another recording and certify the calibration with it: `rig certify calibration.json OTHER-REC "
    "--out certificate.html`",
    "Compute commands for the wanted poses: `rig correct calibration.json --poses wanted.csv --out commands.csv`",
)
TAKE_IN = (
    "Determine the unmodelled effects: `rig diagnose REC --out found`; include: `rig calibrate REC --diagnosis "
    "found --out calibration.json`"
)


class OfCalibrations(NamedTuple):
    """What is known of calibrations made from a recording, which holds for all else that is learnt from it.
    refuted : which are, and by what, and
    unexplained : what they leave so, a sentence each"""

    refuted: tuple[str, ...] = ()
    unexplained: tuple[str, ...] = ()


ALONE = OfCalibrations()  # of a recording from which none was made


def calibration_verdict(calibration: Calibration) -> Verdict:
    """The Verdict on a calibration."""
    return judge_evidence(calibration_evidence(calibration))


def calibration_evidence(
    calibration: Calibration,
    refutations: Sequence[Refutation] = (),
    statement: str | None = None,
    steps: Sequence[str] = ONWARD,
) -> Evidence:
    """Evidence for and against a calibration.

    refutations : of its file, by later recordings; statement : in place of its own; steps : where it is good
    """
    claim = calibration.claim
    message = "this calibration makes no claim" if claim is None else claim_lines(claim)[0]
    missing, refuted = list(_missing(calibration)), [one.line for one in refutations if one.state == State.BAD]
    if claim is not None and claim.ratio is not None:
        if claim.ratio[2] < 1:
            refuted.append("the nominal model does better")
        elif claim.ratio[1] <= 1:
            missing.append(MissingEvidence("it is not shown to be better than the nominal model", MORE))
    if calibration.confounds is not None and calibration.confounds.one_sided:
        axes = calibration.confounds.one_sided
        missing.append(
            MissingEvidence(f"it holds for poses approached as recorded, from one side on {axes}", BOTH_SIDES)
        )
    missing += [MissingEvidence(text, EVERYWHERE) for text in (() if claim is None else claim.unrecorded)]
    unexplained = () if claim is None else claim.unexplained
    if calibration.physics is not None:
        left = calibration.physics.unknown
        nameless = [f"no catalogued effect explains the residual at {u.place}" for u in left if not u.undone]
        passing = [u.sentence() for u in left if u.undone and TIME in u.by]  # the same time does not come again
        unexplained = (*unexplained, *nameless, *passing)
    doubted = tuple(one.line for one in refutations if one.state != State.BAD)
    return Evidence(
        message if statement is None else statement,
        tuple(steps),
        _error_to_claim_ratio(calibration.held_out, claim),
        (*unexplained, *doubted),
        confound_sentences(calibration.confounds),
        tuple(missing),
        tuple(refuted),
        LOOK if calibration.correction.nominal.bodies else TAKE_IN,
    )


def evidence_with_displaced_base_or_tool(
    evidence: Evidence, names: Sequence[str], recording_name: str = ""
) -> Evidence:
    """Evidence with a displaced base or tool added.

    With what stands elsewhere in a recording though its place is stated ("base", "tool").
    recording_name : the recording, where the sentence names it
    """
    step = 'Put it back, calibrate anew, or state in rig.toml that its place is unknown: [instrument] {} = "free"'
    where = recording_name and f" in {recording_name}"
    moved = [MissingEvidence(f"the {name} stands elsewhere{where}", step.format(name)) for name in names]
    return replace(evidence, missing=(*evidence.missing, *moved))


MEASURE_POSES_ANEW = (
    "Measure these again: if they come out as before, the machine is off there; a displaced target or reflector shows "
    "once, and --mask excludes it"
)


def evidence_with_verification(
    evidence: Evidence, verification: Verification | None, recording_name: str = "", next_step: str | None = None
) -> Evidence:
    """Evidence with the verification of the claim on a held-out recording added.
    verification : Verification, None where no factor is claimed

    recording_name : the recording, where the sentence names it; next_step : the step where the claim is refuted, that
        of known by default
    """
    if verification is None:
        return evidence
    if verification.offset is not None and verification.offset.kept:
        elsewhere = f"the {WHERE[verification.offset.of]} stands elsewhere"
        reseat = "Reseat the targets and instrument, or state their poses in rig.toml"
        moved = (
            MissingEvidence(elsewhere, reseat)
            if verification.offset.zeros is None
            else MissingEvidence(f"{elsewhere}, or the zeros of the struts have changed", f"Home the struts. {reseat}")
        )
        return replace(evidence, missing=(*evidence.missing, moved))
    if verification.far is not None and verification.far.kept:
        count = len(verification.far.frames)
        doubt = f"{count} pose{'s lie' if count > 1 else ' lies'} far off all others"
        return replace(evidence, missing=(*evidence.missing, MissingEvidence(doubt, MEASURE_POSES_ANEW)))
    if verification.refutes:
        message = (
            f"the claim is NOT kept{recording_name and f' by {recording_name}'}: {refutation_sentence(verification)}"
        )
        return replace(
            evidence, refuted=(message, *evidence.refuted), look=evidence.look if next_step is None else next_step
        )
    ratios = [part.of_allowed for part in verification.parts.values()] + (
        [] if evidence.held_out is None else [evidence.held_out]
    )
    return replace(evidence, held_out=max(ratios, default=None))


def verify_claim_on_samples(
    calibration: Calibration, samples: Samples, rng: np.random.Generator
) -> Verification | None:
    """Verification of a calibration's claim on samples.

    None where no factor is claimed.
    """
    if calibration.claim is None or calibration.claim.after is None:
        return None
    label = configuration_numbers(samples.commanded, axis_travel_limits(calibration.correction.nominal))
    fitted, predicted = calibration.correction.fitted, predicted_poses(calibration.correction, samples)
    by_lengths = (
        inverse_strut_length_jacobian(predicted, fitted) if has_struts(fitted) and samples.measured == "pose" else None
    )
    return verify_claim(predicted, samples, label, calibration.claim, rng, by_lengths)


def evidence_with_confounds(
    evidence: Evidence, calibration: Calibration, confounds: Sequence[Confounds | None], recording_names: str
) -> Evidence:
    """Evidence with confounds of held-out recordings added.

    They are what the designs of these confound, where the calibration's own recording's is not known.
    Only what that does not separate can have gone into the correction. recording_names : the recordings, in words
    """
    if calibration.confounds is not None:
        return evidence
    return replace(
        evidence,
        confounds=tuple(
            dict.fromkeys(
                [
                    *evidence.confounds,
                    *(f"{recording_names}: {sentence}" for one in confounds for sentence in confound_sentences(one)),
                ]
            )
        ),
    )


def _error_to_claim_ratio(held: HeldOut | None, claim: Claim | None) -> float | None:
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


def _missing(calibration: Calibration) -> list[MissingEvidence]:
    claim = calibration.claim
    if claim is None:
        return [MissingEvidence("nothing is claimed", MORE)]
    if claim.ratio is None:
        return [MissingEvidence("the accuracy of the correction at other configurations is not known", MORE)]
    return []


@dataclass(frozen=True, slots=True)
class AgainstClaim:
    """Of a recording's n poses. found : Verification; beyond : (m, rad), RMS errors beyond what measuring adds, 0 where
    that explains all, None where not judged
    claimed : ((median, low, high), ..) m and rad, the claim's 95 % intervals of them"""

    recording: str
    found: Verification
    beyond: tuple[float | None, float | None]
    claimed: tuple[tuple[float, ...], ...]

    @property
    def parts(self) -> dict[str, tuple[Part, float, tuple[float, ...]]]:
        """{"position" | "rotation": (Part, RMS beyond noise, (median, low, high) claimed)} of what was judged; m and
        rad.
        """
        rows = zip(("position", "rotation"), (self.found.position, self.found.rotation), self.beyond, self.claimed)
        return {
            name: (part, beyond, claimed)
            for name, part, beyond, claimed in rows
            if part is not None and beyond is not None
        }


def claim_verification_and_excess_errors_of_recording(
    calibration: Calibration, recording_name: str, samples: Samples, rng: np.random.Generator
) -> AgainstClaim | None:
    """Verification of a claim on a recording's samples, and errors in excess of noise (AgainstClaim).

    None where no factor is claimed. The errors are RMS, m and rad.
    recording_name : its name
    """
    found = verify_claim_on_samples(calibration, samples, rng)
    if found is None or calibration.claim is None or calibration.claim.after is None:
        return None
    errors, covariance = (
        pose_errors(predicted_poses(calibration.correction, samples), samples),
        samples.total_covariance(),
    )

    def beyond(part: slice) -> float:
        square = (errors[:, part] ** 2).sum(axis=1) - np.trace(covariance[:, part, part], axis1=1, axis2=2)
        return float(np.sqrt(max(square.mean(), 0.0)))

    sizes = [
        None if judged is None else beyond(part)
        for judged, part in ((found.position, slice(0, 3)), (found.rotation, slice(3, 6)))
    ]
    return AgainstClaim(recording_name, found, (sizes[0], sizes[1]), calibration.claim.after)
