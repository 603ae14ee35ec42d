"""rig verify: verify a calibration by a recording not used for it: error before and after correction."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files
from rig.cli.shared.command_options import (
    SEED,
    Progress,
    add_json_option,
    add_page_option,
    add_recording_argument,
    page_links,
    page_path,
    print_frames_without_pose,
    print_held_out_errors,
    print_json,
    read_recording,
)
from rig.errors import RigError
from rig.report.verdict import Verdict, exit_status

if TYPE_CHECKING:
    import numpy as np

    from calib.certify.held_out_errors import Figures
    from calib.files.calibration_file import Calibration
    from calib.report.verification_and_visit_pages import Verified
    from calib.samples.pose_samples import Samples
    from calib.samples.recording_samples import Sampled
    from rig.recording.corner_and_pose_tables import Poses
    from rig.recording.recording_folder import Recording

    Driven = tuple[Figures, tuple[float, float], np.ndarray]


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.epilog = "Ends with 0 where the verdict is good or check, with 3 where it is bad: the claim is NOT kept."
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    add_recording_argument(parser)
    add_json_option(parser)
    add_page_option(parser)
    calibration_and_effect_files.add_effects_option(parser)
    parser.add_argument(
        "--wanted", metavar="FILE", type=Path, help="poses that the recording's frames, in order, were meant to take"
    )


def run(arguments: Namespace) -> int:
    """Hold a calibration against a recording and print the figures; 3 where the verdict is bad."""
    from calib.files import calibration_file
    from rig.recording import recording_folder as recordings

    progress = Progress()
    progress("reading the recording", 0, 1)
    calibration = calibration_and_effect_files.load_calibration(
        arguments.calibration, calibration_and_effect_files.load_effect_files(arguments)
    )
    wanted = recordings.load_poses(arguments.wanted, are_commands=True) if arguments.wanted else None
    recording = read_recording(arguments)
    calibration.refuse_kind(recording.design.mechanism.kind, str(arguments.recording))
    page = page_path(arguments)

    import numpy as np

    from calib.certify import calibration as words
    from calib.certify.calibration_evidence import verify_claim_on_samples
    from calib.certify.distinct_configurations import axis_ranges, configuration_numbers
    from calib.certify.held_out_errors import compare_errors, errors_before_and_after_correction
    from calib.report.verification_and_visit_pages import (
        Verified,
        refutes_claim,
        verification_verdict,
        write_verification_page,
    )
    from calib.samples.confounded_conditions import confounds_of_recordings
    from calib.samples.recording_samples import sample_recording

    sampled = sample_recording(recording, progress=progress)
    samples = calibration.with_physics(recording, sampled.samples)
    label = configuration_numbers(samples.commanded, axis_ranges(calibration.correction.nominal))
    before, after = errors_before_and_after_correction(calibration.correction, samples)
    held = compare_errors(before, after, samples.total_covariance(), np.random.default_rng(SEED), label)
    same, found = (
        calibration_file.frames_used_in_calibration(calibration, recording),
        verify_claim_on_samples(calibration, samples, np.random.default_rng(SEED)),
    )
    driven = _driven(calibration, recording, sampled.samples, wanted) if wanted is not None else None
    confounds = confounds_of_recordings([recording])
    progress.close()
    unsolved = sampled.measurement.unsolved if sampled.measurement is not None else {}
    refuted = calibration_and_effect_files.read_refutations(arguments.calibration)
    shown = Verified(
        recording.design, samples, before, after, held, found, calibration, refuted, same, driven, unsolved, confounds
    )
    verdict = verification_verdict(shown)
    if page is not None:
        write_verification_page(page, recording.name, shown, page_links(arguments, arguments.page))
    if found is not None and refutes_claim(shown):
        calibration_and_effect_files.write_refutation(
            arguments, arguments.calibration, recording.name, words.refutation_sentence(found)
        )
    if arguments.json:
        print_json(_verification(shown, verdict, sampled) | {"confounds": confounds and confounds.tree()})
        return exit_status(verdict)
    if same:
        print(
            f"warning: the calibration was made from {len(same)} of this recording's "
            f"{len(recording.exposures.times()[0])} frames, so these "
            "figures are not held out",
            file=sys.stderr,
        )
    _say(shown, verdict, sampled)
    if confounds is not None:
        print(confounds.line())
    if page is not None:
        print(f"written: {arguments.page}")
    return exit_status(verdict)


def _say(shown: Verified, verdict: Verdict, sampled: Sampled) -> None:
    """Print what was found."""
    print(verdict.line)
    if shown.driven is None:
        print_held_out_errors(shown.held, f"{len(shown.samples)} poses from {sampled.source}")
        if shown.found is not None and shown.found.parts:
            print(
                "an error of the machine would have been noticed from "
                + " and ".join(
                    f"{part.noticed * 1e3:.4f} {'mm' if name == 'position' else 'mrad'} RMS on"
                    for name, part in shown.found.parts.items()
                )
            )
    else:
        figures, stated, _ = shown.driven
        turned = ("", "", "")
        if 0 < stated[1] < float("inf"):  # the machine turns at all, and that was measured
            turned = (
                f"; rotation {figures.rotation[0] * 1e3:.4f} mrad RMS, {figures.rotation[2] * 1e3:.4f} max",
                f" and {stated[1] * 1e3:.4f} mrad",
                f" and {figures.rotation[0] / stated[1]:.2f}",
            )
        print(
            f"{figures.n} poses as measured, against the poses wanted: position "
            f"{figures.position[0] * 1e3:.4f} mm RMS, "
            f"{figures.position[2] * 1e3:.4f} max{turned[0]}"
        )
        print(
            "stated standard uncertainty of that, calibration and measurement together: "
            f"{stated[0] * 1e3:.4f} mm{turned[1]}: "
            f"the error is {figures.position[0] / stated[0]:.2f}{turned[2]} times it"
        )
    print_frames_without_pose(sampled.measurement)


def _driven(calibration: Calibration, recording: Recording, samples: Samples, wanted: Poses) -> Driven:
    """(Figures of measured against wanted poses, stated standard uncertainty (m, rad) of their difference, the
    differences (n, 6)).
    """
    from calib.certify.held_out_errors import error_statistics, pose_errors
    from calib.models.corrected_pose_covariance import corrected_pose_covariance
    from calib.samples.pose_samples import rms_uncertainty

    frames = recording.exposures.times()[0].tolist()
    if len(frames) != len(wanted.frame):
        raise RigError(f"{len(wanted.frame)} poses were wanted, but the recording has {len(frames)} frames")
    T = wanted.T_base_platform[[frames.index(frame) for frame in samples.frame]]
    of_model = corrected_pose_covariance(calibration, T, samples.commanded)
    if wanted.covariance is not None:  # as `rig correct` stated it, of what it knew
        of_model = wanted.covariance[[frames.index(frame) for frame in samples.frame]]
    stated = samples.total_covariance() + of_model
    errors = pose_errors(T, samples)
    return error_statistics(errors), rms_uncertainty(stated), errors


def _verification(shown: Verified, verdict: Verdict, sampled: Sampled) -> dict:
    from dataclasses import asdict

    def side(figures: Figures) -> dict:
        names = ("rms", "p95", "max", "mean")
        position, rotation = (*figures.position, figures.mean[0]), (*figures.rotation, figures.mean[1])
        return {"position": dict(zip(names, position)), "rotation": dict(zip(names, rotation)), "bias": figures.bias}

    held, same, claim = shown.held, shown.same, shown.calibration.claim
    tree = {
        "schema": "verification/1",
        "verdict": verdict.tree(),
        "unit": {"position": "m", "rotation": "rad"},
        "held_out": not same,
        "frames_used_in_fitting": same,
        "n": held.after.n,
        "before": side(held.before),
        "after": side(held.after),
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
            **side(shown.driven[0]),
            "stated_uncertainty": {"position": shown.driven[1][0], "rotation": shown.driven[1][1]},
        }
    return tree
