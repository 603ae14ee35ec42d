"""A calibration held against a recording that it was not made from: errors before and after, and whether its claim
holds.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from calib.certification.calibration import Calibration, refutation_sentence
from calib.certification.calibration_evidence import verify_claim_on_samples
from calib.certification.distinct_configurations import axis_ranges, configuration_numbers
from calib.certification.held_out_errors import (
    Figures,
    compare_errors,
    error_statistics,
    errors_before_and_after_correction,
    pose_errors,
)
from calib.certification.platform_certification import Progress
from calib.files import calibration_from_recording
from calib.files.calibration_from_recording import SEED
from calib.models.corrected_pose_covariance import corrected_pose_covariance
from calib.report.verification_and_visit_pages import (
    Verified,
    refutes_claim,
    verification_verdict,
    write_verification_page,
)
from calib.samples.confounded_conditions import confounds_of_recordings
from calib.samples.pose_samples import Samples
from calib.samples.recording_samples import Sampled, sample_recording
from rig.arrays import Floats
from rig.errors import RigError
from rig.formats.json_tree import Json
from rig.model.pose import rms_uncertainty
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Poses
from rig.report.pages.html_elements import result_html
from rig.report.pages.page_and_svg_templates import Link
from rig.report.refutations import Refutation
from rig.report.verdict import Verdict


@dataclass(frozen=True, slots=True, eq=False)
class VerificationResult:
    """A verification. recording; sampled : its poses; figures : Verified, all that was found."""

    recording: Recording
    sampled: Sampled
    figures: Verified

    @property
    def verdict(self) -> Verdict:
        """The verdict on the calibration, or where poses were wanted on these."""
        return verification_verdict(self.figures)

    @property
    def refutation(self) -> str | None:
        """What refutes the calibration's claim, a sentence without its full stop; None where nothing does."""
        found = self.figures.found
        return refutation_sentence(found) if found is not None and refutes_claim(self.figures) else None

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        held = self.figures.held
        rows = [
            (name, *(f"{x * 1e3:.4f}" for x in figures.position), f"{figures.rotation[0] * 1e3:.4f}")
            for name, figures in (("owner's model", held.before), ("corrected", held.after))
        ]
        head = (f"{held.after.n} poses", "position RMS, mm", "95 %, mm", "max, mm", "rotation RMS, mrad")
        return result_html(str(self), self.verdict.rests_on, [head, *rows])

    def write_page(self, path: Path, links: Sequence[Link] = ()) -> None:
        """Write the page of it."""
        write_verification_page(path, self.recording.name, self.figures, links)

    def tree(self) -> Json:
        """What `rig verify --json` prints."""
        shown = self.figures
        held, same, claim = shown.held, shown.same, shown.calibration.claim
        tree: Json = {
            "schema": "verification/1",
            "verdict": self.verdict.tree(),
            "unit": {"position": "m", "rotation": "rad"},
            "held_out": not same,
            "frames_used_in_fitting": same,
            "n": held.after.n,
            "before": _side(held.before),
            "after": _side(held.after),
            "measurement_uncertainty": {"position": held.floor[0], "rotation": held.floor[1]},
            "ratio": {"position": held.ratio[0], "ci95": held.ratio[1:]},
            "configurations": held.configurations,
            "unsolved": [{"frame": frame, "reason": reason} for frame, reason in sorted(shown.unsolved.items())],
            "refuted_before": [asdict(one) for one in shown.refutations],
        }
        if claim is not None and claim.after is not None and shown.found is not None:
            parts = {name: {**asdict(part), "kept": part.kept} for name, part in shown.found.parts.items()}
            tree["claim"] = {
                "after": claim.after[0],
                "ratio": claim.ratio,
                "kept": shown.found.kept,
                **parts,
                "offset": shown.found.offset and asdict(shown.found.offset),
            }
        if shown.driven is not None:
            tree["wanted"] = {
                **_side(shown.driven[0]),
                "stated_uncertainty": {"position": shown.driven[1][0], "rotation": shown.driven[1][1]},
            }
        return tree | {"confounds": shown.confounds and shown.confounds.tree()}


def verify(
    calibration: Calibration,
    recording: Recording,
    wanted: Poses | None = None,
    refutations: Sequence[Refutation] = (),
    progress: Progress | None = None,
) -> VerificationResult:
    """VerificationResult of a calibration by a recording, as `rig verify` makes it.

    wanted : poses that the recording's frames, in order, were meant to take, or None; refutations : what later
    recordings found against the calibration; progress : called with (label, done, of), or None
    Raises RigError for a recording of another kind of machine and for other poses than frames
    """
    calibration.refuse_kind(recording.design.mechanism.kind, str(recording.folder))
    sampled = sample_recording(recording, progress=progress)
    samples = calibration.with_physics(recording, sampled.samples)
    label = configuration_numbers(samples.commanded, axis_ranges(calibration.correction.nominal))
    before, after = errors_before_and_after_correction(calibration.correction, samples)
    held = compare_errors(before, after, samples.total_covariance(), np.random.default_rng(SEED), label)
    figures = Verified(
        recording.design,
        samples,
        before,
        after,
        held,
        verify_claim_on_samples(calibration, samples, np.random.default_rng(SEED)),
        calibration,
        refutations,
        calibration_from_recording.frames_used_in_calibration(calibration, recording),
        None if wanted is None else _driven(calibration, recording, sampled.samples, wanted),
        sampled.measurement.unsolved if sampled.measurement is not None else {},
        confounds_of_recordings([recording]),
    )
    return VerificationResult(recording, sampled, figures)


def _driven(
    calibration: Calibration, recording: Recording, samples: Samples, wanted: Poses
) -> tuple[Figures, tuple[float, float], Floats]:
    """(Figures of measured against wanted poses, stated standard uncertainty (m, rad) of their difference, the
    differences (n, 6)).
    """
    frames = recording.exposures.times()[0].tolist()
    if len(frames) != len(wanted.frame):
        raise RigError(f"{len(wanted.frame)} poses were wanted, but the recording has {len(frames)} frames")
    T = wanted.T_base_platform[[frames.index(frame) for frame in samples.frame]]
    of_model = corrected_pose_covariance(calibration, T, samples.commanded)
    if wanted.covariance is not None:  # as `rig correct` stated it, of what it knew
        of_model = wanted.covariance[[frames.index(frame) for frame in samples.frame]]
    errors = pose_errors(T, samples)
    return error_statistics(errors), rms_uncertainty(samples.total_covariance() + of_model), errors


def _side(figures: Figures) -> Json:
    """Figures of one side, as JSON has them."""
    names = ("rms", "p95", "max", "mean")
    position, rotation = (*figures.position, figures.mean[0]), (*figures.rotation, figures.mean[1])
    return {"position": dict(zip(names, position)), "rotation": dict(zip(names, rotation)), "bias": figures.bias}
