"""What `rig calibrate` says of a calibration: the verdict, which poses agree, a promise kept or not, what becomes of
the workspace.
"""

from __future__ import annotations

from argparse import Namespace
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from calib.certify.platform_certification import Certified as PlatformCertified
    from calib.certify.workspace_claim import Claim
    from calib.correct.physics import Physics
    from calib.files.calibration_file import Calibration
    from calib.models.arm.certification import Certified
    from calib.models.chain.certification import Certified as ChainCertified
    from calib.samples.recording_samples import Sampled
    from rig.cli.shared.progress_bars import Progress

MOST_NAMED = 10  # frames


def show_calibration(
    page: Path | None, draw: Callable[[Path], None], calibration: Calibration, progress: Progress
) -> None:
    """Draw the page, where there is one, and print the verdict, first of all."""
    from calib.certify.calibration_evidence import calibration_verdict
    from calib.certify.calibration_verdict import claim_lines

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


def tell(arguments: Namespace, calibration: Calibration, poses: int) -> None:
    """Say what a calibration of so many poses is worth, and leave for --json its held-out figures and claim, as
    calibration.json has them.
    """
    from calib.certify.calibration_evidence import calibration_verdict

    held, claim = calibration.held_out, calibration.claim
    arguments.result = {
        "schema": "calibrated/1",
        "held_out": held and asdict(held),
        "claim": claim and asdict(claim),
        "poses": poses,
        "confounds": calibration.confounds and calibration.confounds.tree(),
        "verdict": calibration_verdict(calibration).tree(),
    }
    if calibration.confounds is not None:
        print(calibration.confounds.line())
    _say_promise(arguments.promise, claim)
    _say_workspace(calibration)


def _say_promise(promise: float | None, claim: Claim | None) -> None:
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


def _say_workspace(calibration: Calibration) -> None:
    """Print what a calibration does to the workspace; nothing where that was not worked out."""
    from calib.workspace.workspace_sentences import workspace_lines
    from rig.model import mechanisms

    if calibration.workspace is not None:
        print(workspace_lines(calibration.workspace, mechanisms.travel_unit(calibration.correction.nominal))[0])


def say_joints(done: Certified, physics: Physics | None) -> None:
    """Print what an arm's correction does beyond its geometry, and what that is worth on the held-out poses."""
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
    say_physics(physics)


def say_physics(physics: Physics | None) -> None:
    """Print which of the physics that a calibration knows its commands undo; nothing where it knows none."""
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
    """Print how many poses of how many configurations there are, how many agree with one geometry, and which frames do
    not.
    """
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
