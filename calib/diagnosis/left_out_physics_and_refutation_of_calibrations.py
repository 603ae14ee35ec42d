"""Physics that a calibration leaves out, and refutation of calibrations by it.

Effects found by diagnosing its recording, stated in its claim.

Good needs that nothing is unexplained, which is known where somebody has looked for it: a calibration looks as `rig
diagnose` does.
Where a diagnosis gives a cause to poses that a fit left out as wild, these are the machine's doing, and the claim has
to hold for them as well.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.calibration_evidence_verdict_and_claim_check import (
    OfCalibrations,
    calibration_evidence,
    verify_claim_on_samples,
)
from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.certification.held_out_pose_error_statistics import pose_errors, predicted_poses
from calib.diagnosis.engine.problem_interface import Progress
from calib.diagnosis.recording_diagnosis import DiagnosisOptions, diagnose
from calib.diagnosis.report.diagnosis_json_entries import UNKNOWN
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import (
    Report,
    diagnosis_report,
    missing_evidence_of_report,
    unexplained_sentences,
)
from calib.diagnosis.report.diagnosis_sentences_and_table_rows import finding_size_text, finding_title
from calib.files import calibration_file
from calib.files.calibration_file import SEED
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples
from rig.array_and_json_types import Floats, Json
from rig.errors import NotEnoughData
from rig.recording.frame_selection_and_content_hashes import Marks, frames_with_known_hashes
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import State, refutations_of_file

LARGEST = 50_000_000  # bytes of a file that is looked into
NOT_SEARCHED = "it was not searched for unmodelled effects"
EDGES = (0.025, 0.975)
BEYOND = ("physics", "extension", "pose_maps")  # of a calibration that is more than a geometry and its remainder


class Refutation(NamedTuple):
    """What a recording says against a calibration made from it. path : its file; state : BAD where it is refuted, else
    CHECK; finding : a sentence
    """

    path: Path
    state: State
    finding: str


def calibration_with_left_out_physics(
    calibration: Calibration, recording: Recording, sampled: Sampled, progress: Progress | None = None
) -> Calibration:
    """The Calibration with the physics that it leaves out.

    Found by diagnosing its recording, stated in its claim.
    sampled : Sampled that it was made from; progress : called with (label, done, of), or None
    """
    if calibration.claim is None or calibration.claim.after is None:
        return calibration
    try:
        options = DiagnosisOptions(sampled=sampled, detectable_sizes=False)
        report = diagnosis_report(diagnose(recording, options, progress))
    except NotEnoughData as error:
        return _with(calibration, (f"the search for unmodelled effects failed: {error}",))
    return _add_left_out_physics(calibration, report, sampled.samples)


def mark_as_not_searched_for_left_out_physics(calibration: Calibration) -> Calibration:
    """Mark a calibration as not searched for left-out physics.

    In its claim.
    """
    return _with(calibration, (NOT_SEARCHED,))


def _add_left_out_physics(calibration: Calibration, report: Report, samples: Samples) -> Calibration:
    """The Calibration with what a Report of its own recording says of its claim. samples : Samples of the recording,
    all of them
    """
    if _refutes_calibration(report, calibration, samples):
        calibration = replace(calibration, claim=_widened_claim(calibration, samples))
    return _with(
        calibration, (*unexplained_sentences(report), *(one.text for one in missing_evidence_of_report(report)))
    )


def _refutes_calibration(report: Report, calibration: Calibration, samples: Samples) -> bool:
    """Whether the poses of its own recording, those that it left out among them, refute a calibration's claim, and a
    Report gives that a cause.
    """
    if not report.mattering and not report.unknown:
        return False
    found = verify_claim_on_samples(calibration, samples, np.random.default_rng(SEED))
    return found is not None and found.refutes


def _widened_claim(calibration: Calibration, samples: Samples) -> Claim:
    """A calibration's claim, no better than the errors of all poses of its recording beyond what measuring adds.

    Few poses may show most of it: as many as count are taken for a Poisson draw, whose 95 % interval is that of the
    mean square.
    samples : Samples, those that were left out among them
    """
    claim = calibration.claim
    assert claim is not None and claim.before is not None and claim.after is not None
    errors, covariance = (
        pose_errors(predicted_poses(calibration.correction, samples), samples),
        samples.total_covariance(),
    )
    after = tuple(
        _no_better(three, errors[:, part], covariance[:, part, part])
        for part, three in zip((slice(0, 3), slice(3, 6)), claim.after)
    )
    b, a = claim.before[0], after[0]
    pairs = ((b[0], a[0]), (b[1], a[2]), (b[2], a[1]))
    seen = float(np.trace(covariance[:, :3, :3], axis1=1, axis2=2).mean())
    ratio = tuple(x / max(y, np.finfo(float).tiny) for x, y in pairs)
    return replace(
        claim, after=after, ratio=ratio, measured=tuple(math.sqrt((x**2 + seen) / (y**2 + seen)) for x, y in pairs)
    )


def _no_better(three: tuple[float, ...], errors: Floats, covariance: Floats) -> tuple[float, ...]:
    """(median, low, high) of a claim, no better than errors (n, 3) of a covariance (n, 3, 3) show; as it is where these
    were not measured.
    """
    own = (errors**2).sum(axis=1)
    if not np.isfinite(own).all() or not own.any():
        return three
    size = math.sqrt(max(float((own - np.trace(covariance, axis1=1, axis2=2)).mean()), 0.0))
    count = float(own.sum() ** 2 / (own**2).sum())  # of poses that show it
    low, high = (math.sqrt(float(gammaincinv(k, edge)) / count) for k, edge in zip((count, count + 1), EDGES))
    return tuple(max(x, y * size) for x, y in zip(three, (1.0, low, high)))


def refuted_calibrations_of_recording(
    report: Report, recording_marks: Marks, calibration_paths: Iterable[Path], samples: Samples | None
) -> list[Refutation]:
    """Calibrations of a recording that are refuted ([Refutation]).

    They leave out what a Report of it finds.
    recording_marks : marks of the recording; calibration_paths : files that may be calibrations, all else is
        passed over; samples : Samples of the recording, None where nothing was commanded
    """
    out = []
    for path, tree in _made_from(recording_marks, calibration_paths):
        known = _known(tree)
        left = [f for f in report.mattering if (f.effect, f.place) not in known]
        nameless = [f.place for f in report.unknown if (f.effect, f.place) not in known]
        if not left and not nameless:
            continue
        found = ["it omits " + "; ".join(f"{finding_title(f)}{finding_size_text(f)}" for f in left)] if left else []
        found += [f"no catalogued effect explains the residual at {', '.join(nameless)}"] if nameless else []
        after = (tree.get("claim") or {}).get("after")
        claimed = f", where {float(after[0][2]) * 1e6:.3g} um is claimed" if after else ""
        refuted = (
            samples is not None
            and not tree.get("physics")
            and _refutes_calibration(report, calibration_file.load(path), samples)
        )
        out.append(Refutation(path, State.BAD if refuted else State.CHECK, "; ".join(found) + claimed))
    return out


def unexplained_findings_and_refutations(
    recording_marks: Marks, calibration_paths: Iterable[Path], include_later_refutations: bool
) -> OfCalibrations:
    """Findings that calibrations of a recording leave unexplained, and refutations of them, by the recording's marks.

    include_later_refutations : whether what other recordings found against them counts, as for what is learnt from the
        recording itself
    """
    refuted: list[str] = []
    left: list[str] = []
    for path, tree in _made_from(recording_marks, calibration_paths):
        if any(tree.get(key) for key in BEYOND):
            continue
        known = calibration_evidence(
            calibration_file.load(path, several_hands=True),
            refutations_of_file(path) if include_later_refutations else (),
        )
        refuted += [f"{path.name} {text}" for text in known.refuted] if include_later_refutations else []
        left += known.unexplained
    return OfCalibrations(tuple(dict.fromkeys(refuted)), tuple(dict.fromkeys(left)))


def _with(calibration: Calibration, texts: tuple[str, ...]) -> Calibration:
    """The Calibration with more that its claim leaves unexplained."""
    claim = calibration.claim
    if claim is None:
        return calibration
    return replace(calibration, claim=replace(claim, unexplained=tuple(dict.fromkeys([*claim.unexplained, *texts]))))


def _made_from(of: Marks, paths: Iterable[Path]) -> list[tuple[Path, Json]]:
    """[(path, tree)] of the calibrations among files that were made from a recording with marks."""
    found = [(path, _calibration(path)) for path in paths]
    return [
        (path, tree)
        for path, tree in found
        if tree is not None and frames_with_known_hashes(of, set(tree["provenance"].get("data", ())))
    ]


def _known(tree: Json) -> set[tuple[object, object]]:
    """{(effect, place)} of the physics that a calibration knows."""
    physics = tree.get("physics") or {}
    known = {(e.get("effect"), e.get("place")) for e in physics.get("effects", ()) if isinstance(e, dict)}
    return known | {(UNKNOWN, e.get("place")) for e in physics.get("unknown", ()) if isinstance(e, dict)}


def _calibration(path: Path) -> Json | None:
    """The tree of a calibration's file, None of what is none."""
    if path.stat().st_size > LARGEST:
        return None
    try:
        tree = json.loads(path.read_bytes())
    except ValueError:  # another file that ends in .json
        return None
    own = (
        isinstance(tree, dict)
        and str(tree.get("schema", "")).startswith("calibration/")
        and isinstance(tree.get("provenance"), dict)
    )
    return tree if own else None
