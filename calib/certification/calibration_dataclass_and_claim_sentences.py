"""Calibration dataclass, and sentences on its claim.

A Calibration holds correction, covariance, claim and provenance of a machine.
"""

import math
from dataclasses import dataclass, replace

from calib.certification.claim_verification import Verification
from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.certification.held_out_pose_error_statistics import HeldOut
from calib.certification.held_out_pose_errors_and_distinct_configurations import LEAST
from calib.correction.machine_correction import AnyCorrection
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples
from calib.samples.position_confounds_and_poses_on_one_clock import (
    Confounds,
    estimate_clocks_from_samples,
    recording_and_poses_on_commands_clock,
)
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import Workspace
from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.formats.numbers_and_units import number_text
from rig.model.arm_hands_effect_places_and_tolerances import hand_names, selected_hand_name
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, has_struts
from rig.model.mechanisms.redundant_strut_best_six_legs_and_loop_closures import with_follower_struts_of
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html

WHERE = {"base": "base, or the instrument,", "platform": "target on the platform"}


def claim_lines(claim: Claim) -> list[str]:
    """Lines on a claim.

    The first is its summary.
    """
    configurations = f"{claim.distinct} distinct configuration{'' if claim.distinct == 1 else 's'}"
    rest = claim.unknowns - claim.determined
    determined = (
        (
            f"{claim.determined} of {claim.unknowns} combinations of the parameters are determined by these poses"
            + (
                f", {claim.better} of them better than the stated figures are"
                if claim.better < claim.determined
                else ""
            )
            + (f"; {rest} rest on the stated figures" if rest else "")
            + f" ({claim.tolerance})"
        )
        if claim.unknowns
        else claim.tolerance
    )
    if claim.ratio is None or claim.before is None or claim.after is None or claim.measured is None:
        few = [
            "no held-out figure either: residuals at the recorded configurations would only show how well "
            "these are known"
        ]
        return [f"no factor is claimed: {claim.reason}", determined, *(few if claim.distinct < LEAST else [])]
    before, after = claim.before[0], claim.after[0]
    turned = (
        f", rotation {claim.before[1][0] * 1e3:.3f} -> {claim.after[1][0] * 1e3:.4f} mrad"
        if any(claim.before[1])
        else ""
    )
    return [
        f"{ratio_interval_text(claim.ratio)} over the whole workspace: position error {before[0] * 1e3:.3f} -> "
        f"{after[0] * 1e3:.4f} mm RMS ("
        f"{after[1] * 1e3:.4f} to {after[2] * 1e3:.4f}){turned}; "
        f"from {configurations}",
        determined,
        f"the workspace is {claim.workspace}; measured there by a similar instrument, its own errors "
        f"included: {ratio_interval_text(claim.measured)}",
    ]


def ratio_interval_text(ratio_interval: tuple[float, ...]) -> str:
    """Text of a ratio (median, low, high) and its interval.

    Low and high are NaN where there is none.
    """
    interval = (
        "too few configurations for an interval"
        if math.isnan(ratio_interval[1])
        else f"95 % interval {ratio_interval[1]:.3g} to {ratio_interval[2]:.3g}"
    )
    return f"{ratio_interval[0]:.3g} times better ({interval})"


def verification_line(held_out: HeldOut, claim: Claim | None, verification: Verification | None) -> str:
    """Line on the verification of a calibration's claim by a recording's held-out poses.
    verification : Verification of the claim, None where no factor is claimed
    """
    where = (
        "this 1 configuration" if held_out.configurations == 1 else f"these {held_out.configurations} configurations"
    )
    placed = math.isfinite(held_out.after.position[0])
    before, after, unit = (
        (held_out.before.position, held_out.after.position, "mm")
        if placed
        else (held_out.before.rotation, held_out.after.rotation, "mrad")
    )
    here = (
        f"{ratio_interval_text(held_out.ratio)} on {where}: {before[0] * 1e3:.3f} -> {after[0] * 1e3:.4f} {unit} "
        "RMS as measured"
    )
    if claim is None or verification is None:
        return f"{here}; no factor was claimed" + (f": {claim.reason}" if claim else "")
    if not verification.parts:
        return f"{here}; nothing that was measured is claimed"
    return (
        f"{here}; the claim is {claim_check_result_text(verification)} ({_claim_comparison_text(verification)})"
        + (f"; {verification.far}" if verification.far is not None else "")
        + explaining_rigid_motion_text(verification)
    )


def claim_check_result_text(verification: Verification) -> str:
    """Text of the result of a claim's check.

    The claim is kept, NOT kept, or exceeded by what its unexplained part permits.
    """
    if verification.kept:
        return "kept"
    within = (
        verification.unexplained
        and not verification.refutes
        and (verification.offset is None or not verification.offset.kept)
        and (verification.far is None or not verification.far.kept)
    )
    return "exceeded by no more than its stated unexplained part permits" if within else "NOT kept"


def _claim_comparison_text(verification: Verification) -> str:
    """Each part of a claim against what was measured, in words."""
    lines = []
    for name, part in verification.parts.items():
        unit = "mm" if name == "position" else "mrad"
        lines.append(
            f"{name} {part.rms * 1e3:.4f} {unit} where up to {part.claimed * 1e3:.4f} is claimed, "
            f"{part.of_allowed:.2f} times what claim and "
            f"noise allow, chance up to {part.limit:.2f}"
        )
    return "; ".join(lines)


def refutation_sentence(verification: Verification) -> str:
    """Sentence on the errors that refute a claim, measured and claimed; "" where none does.

    As in: 45 um where 3.4 um is claimed.
    """
    wrong = [(name, part) for name, part in verification.parts.items() if not part.kept]
    return " and ".join(
        f"{name} error {_size(part.rms, name)} RMS where up to {_size(part.claimed, name)} is claimed"
        for name, part in wrong
    )


def explaining_rigid_motion_text(verification: Verification) -> str:
    """Text of the rigid motion that explains a refuted claim.

    Empty where none does.
    """
    if verification.offset is None:
        return ""
    o = verification.offset
    if o.machine and o.zeros is not None:
        return (
            f"; the zeros of the struts have changed since it was calibrated: by up to {o.zeros * 1e3:.4f} mm, which "
            "explains it better than a motion of the base, the instrument or the target"
        )
    zeros = "" if o.zeros is None else f"; zeros of struts that changed by up to {o.zeros * 1e3:.4f} mm "
    if zeros:
        zeros += (
            "explain it as well: these poses do not separate the two"
            if o.kept
            else "keep it, and do not fit clearly better than that motion"
        )
    return (
        f"; the {WHERE[o.of]} {'may have' if zeros else 'has'} moved since it was calibrated: "
        f"by {o.position * 1e3:.4f} mm, {o.rotation * 1e3:.4f} mrad; without that motion "
        f"the claim is {'kept' if o.kept else 'NOT kept either'}{zeros}"
    )


def _size(value: float, name: str) -> str:
    return f"{number_text(value * 1e6)} {'um' if name == 'position' else 'urad'}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration(OneLineRepr):
    """correction : Correction, of an arm an ArmCorrection; covariance : (42, 42) m^2 of the fitted parameters, of an
    arm (12 + 5 n, 12 + 5 n) in the order of calib.models.arm.arm_error_model_and_instrument_observations; scatter :
    (6,) m of each strut beyond the
    poses' noise, of an arm (6,) m and rad of the pose; frames : numbers of the frames fitted; left_out : of those that
    did not agree
    held_out : HeldOut, or None where too few configurations were recorded to hold any out
    provenance : what went in, by which versions and arguments; claim : Claim, or None in files of before there was one
    physics : Physics that was found beyond the geometry and is undone with it, or None
    workspace : Workspace, what the correction does to it, or None in files of before it was worked out
    confounds : Confounds of the recording that was fitted, or None where no recording states them
    strut_covariance : (axes, axes) m^2 of what struts do beyond the geometry, where they may do it together, with
    scatter^2 on its diagonal; None where each is by itself, and in files of before it was worked out"""

    correction: AnyCorrection
    covariance: Floats
    scatter: Floats
    frames: tuple[int, ...]
    left_out: tuple[int, ...]
    held_out: HeldOut | None
    provenance: Json
    claim: Claim | None = None
    physics: Physics | None = None
    workspace: Workspace | None = None
    confounds: Confounds | None = None
    strut_covariance: Floats | None = None

    def __post_init__(self) -> None:
        if self.physics is not None and self.physics.compensable_effects():
            names = tuple(f"{effect.label()} at {effect.place}" for effect in self.physics.compensable_effects())
            object.__setattr__(self, "correction", replace(self.correction, physics=names))

    def __str__(self) -> str:
        return claim_lines(self.claim)[0] if self.claim is not None else "a calibration from before claims existed"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        held = self.held_out
        rows = (
            []
            if held is None
            else [
                ("held-out poses", "position RMS, mm", "95 %, mm", "max, mm", "rotation RMS, mrad"),
                *(
                    (name, *(f"{x * 1e3:.4f}" for x in figures.position), f"{figures.rotation[0] * 1e3:.4f}")
                    for name, figures in (("nominal model", held.before), ("corrected", held.after))
                ),
            ]
        )
        return result_html(str(self), [] if self.claim is None else claim_lines(self.claim)[1:], rows)

    def of_hand(self, hand: str) -> "Calibration":
        """The calibration of one hand, by name, of an arm with several; other joints stand at home where it commands.

        Raises RigError for a hand that the arm does not have
        """
        return replace(self, correction=self.correction.of_hand(hand))

    def of_recorded_hand(self, mechanism: object) -> "Calibration":
        """The calibration of the hand at which a recording's mechanism is seen; itself for machines without several.

        Raises RigError for a hand that the calibrated arm does not have
        """
        name = selected_hand_name(mechanism)
        return self if name is None and not hand_names(self.correction.nominal) else self.of_hand(name or "")

    def with_physics(self, recording: Recording, samples: Samples) -> Samples:
        """The samples of a recording with what physics says of their commands, under the recording's own sensors and
        history.
        """
        if self.physics is None or recording.commands is None:
            return samples
        fitted = with_follower_struts_of(self.correction.fitted, recording.design.mechanism)
        return self.physics.with_effects(fitted, samples, recording.commands, recording.sensors)

    def on_one_clock(self, recording: Recording, sampled: Sampled) -> tuple[Recording, Sampled, tuple[str, ...]]:
        """(Recording, its Sampled, sentences): exposures shifted by the difference of the cameras' and the commands'
        clocks, as far as exposures in motion determine it.

        Effects of this calibration state clocks themselves: then nothing is shifted. A lag is the machine's own error.
        """
        if self.physics is not None:
            return recording, sampled, ()
        clocks = tuple(replace(one, lag=0.0) for one in estimate_clocks_from_samples(recording, sampled.samples))
        return *recording_and_poses_on_commands_clock(recording, sampled, clocks), tuple(
            f"taken into account: {one}" for one in clocks
        )

    def refuse_other_machine(self, mechanism: Mechanism, named: str) -> None:
        """Raise RigError for a mechanism of another kind or number of struts. named : of what, in words"""
        own = self.correction.nominal
        if mechanism.kind != own.kind:
            raise RigError(
                f"{named} is of a mechanism of kind {mechanism.kind!r}, the calibration of one of kind {own.kind!r}"
            )
        if has_struts(own) and len(mechanism.axes) != len(own.axes):
            raise RigError(
                f"{named} is of a mechanism with {len(mechanism.axes)} struts, the calibration of one with "
                f"{len(own.axes)}"
            )

    def refuse_physics(self, what: str) -> None:
        """Raise RigError where this holds physics: commands then mean something else at another time, which `what` (a
        sentence's beginning) does not follow."""
        if self.physics is not None and self.physics.compensable_effects():
            raise RigError(
                f"{what} requires unmodified commands, and this calibration includes physics that changes them "
                f"({', '.join(self.correction.physics)}); use one made without --diagnosis and --find"
            )
