"""Summary of a calibration that `rig calibrate` prints: verdict, poses used, promise, workspace, physics."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from calib.certify.platform_certification import Certified as PlatformCertified
    from calib.certify.workspace_claim import Claim
    from calib.correct.physics_compensation import Physics
    from calib.files.calibration_file import Calibration
    from calib.models.arm.certification import Certified
    from calib.models.chain.certification import Certified as ChainCertified
    from calib.samples.recording_samples import Sampled
    from rig.cli.shared.terminal_output import Progress

MOST_NAMED = 10  # frames


def draw_page_and_print_verdict(
    page: Path | None, draw: Callable[[Path], None], calibration: Calibration, progress: Progress
) -> None:
    """Draw the page of a calibration, where one is requested, and print the verdict."""
    from calib.certify.calibration import claim_lines
    from calib.certify.calibration_evidence import calibration_verdict

    if page:
        progress("drawing the page", 0, 1)
        draw(page)
    progress.close()
    judged = calibration_verdict(calibration)
    print(
        "\n".join(
            [
                judged.line,
                *judged.rests_on,
                *(claim_lines(calibration.claim)[1:] if calibration.claim is not None else []),
            ]
        )
    )


def print_calibration_summary(arguments: Namespace, calibration: Calibration, pose_count: int) -> None:
    """Print the summary of a calibration; its held-out errors and claim are left in arguments.result for --json."""
    from calib.certify.calibration_evidence import calibration_verdict

    held, claim = calibration.held_out, calibration.claim
    arguments.result = {
        "schema": "calibrated/1",
        "held_out": held and asdict(held),
        "claim": claim and asdict(claim),
        "poses": pose_count,
        "confounds": calibration.confounds and calibration.confounds.tree(),
        "verdict": calibration_verdict(calibration).tree(),
    }
    if calibration.confounds is not None:
        print(calibration.confounds.line())
    _print_promise(arguments.promise, claim)
    _print_workspace_change(calibration)


def _print_promise(promise: float | None, claim: Claim | None) -> None:
    """Print whether a promise (m) is kept by the upper end of what is claimed; nothing where none was made."""
    if promise is None or claim is None:
        return
    if claim.after is None:
        print(f"the promise of {promise * 1e6:.4g} um cannot be said to be met: {claim.reason}")
        return
    middle, _, most = claim.after[0]
    met = (
        "is met"
        if most <= promise
        else "is NOT met yet; rig plan --promise --given the recording names the next best poses"
    )
    print(
        f"the promise of {promise * 1e6:.4g} um {met}: {middle * 1e6:.4g} um RMS over the workspace, "
        f"{most * 1e6:.4g} at most (97.5 %)"
    )


def _print_workspace_change(calibration: Calibration) -> None:
    """Print what a calibration does to the workspace; nothing where that was not worked out."""
    from calib.workspace.workspace_page import workspace_lines
    from rig.model import mechanisms

    if calibration.workspace is not None:
        print(workspace_lines(calibration.workspace, mechanisms.travel_unit(calibration.correction.nominal))[0])


def print_arm_correction(done: Certified, physics: Physics | None) -> None:
    """Print what an arm's correction does beyond its geometry, and its held-out errors."""
    if done.held_out and done.geometry and done.scattered:
        kept = [i + 1 for i, part in enumerate(done.correction.remainder) if part is not None]
        beyond = [
            *(
                ["the physics that was found, refitted without the poses held out"]
                if physics is not None and physics.effects
                else []
            ),
            *([f"joints {', '.join(map(str, kept))} corrected over the configuration space"] if kept else []),
        ]
        print(
            "beyond the geometry: "
            + (
                f"{' and '.join(beyond)}; the geometry alone leaves {done.geometry.after.mean[0] * 1e3:.4f} "
                "mm mean on the "
                "same poses"
                if beyond
                else "nothing that pays on held-out poses"
            )
        )
        flattered = done.scattered.after
        placed = flattered.mean[0] == flattered.mean[0]
        mean, rms, unit = (
            (flattered.mean[0], flattered.position[0], "mm")
            if placed
            else (flattered.mean[1], flattered.rotation[0], "mrad")
        )
        print(
            f"the same with single rows held out at random, which flatters: {mean * 1e3:.4f} {unit} mean, "
            f"{rms * 1e3:.4f} RMS"
        )
    print_compensated_physics(physics)


def print_compensated_physics(physics: Physics | None) -> None:
    """Print which physics of a calibration the commands compensate; nothing where it has none."""
    if physics is None:
        return
    again, known = physics.compensable_effects(), [f"{e.label()} at {e.place}" for e in physics.compensable_effects()]
    print("physics that is undone by commands: " + (", ".join(known) or "none"))
    left = [f"{e.label()} at {e.place}" for e in physics.effects if e not in again]
    if left:
        print(f"taken out of what was measured, and not the commands' to undo: {', '.join(left)}")
    for u in physics.unknown:
        print(
            f"unknown at {u.place}: "
            + (
                "corrected as a smooth function of the configuration"
                if u.corrected
                else "not corrected, as no smooth function of the configuration explains it"
            )
        )


def print_pose_counts(sampled: Sampled, done: PlatformCertified | Certified | ChainCertified) -> None:
    """Print the counts of poses and configurations, how many agree with one geometry, and the frames that do not."""
    odd = [str(frame) for frame in sampled.samples.frame[~done.found.inliers]]
    named = (
        f"; not frame {', '.join(odd[:MOST_NAMED])}"
        + (f" and {len(odd) - MOST_NAMED} more" if len(odd) > MOST_NAMED else "")
        if odd
        else ""
    )
    print(
        f"{len(sampled.samples)} poses of {done.label.max() + 1} distinct configurations from "
        f"{sampled.source}, {done.found.inliers.sum()} of "
        f"them agree with one geometry{named}"
    )
