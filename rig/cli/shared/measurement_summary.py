"""What `rig measure` prints of a measurement: the verdict, how well poses are known, cameras and places adjusted."""

import numpy as np

from calib.api.learn import LearningResult
from calib.api.poses_from_readings_and_limbs import MeasuredLimbPoses
from rig.cli.shared.command_options import print_frames_without_pose
from rig.model.pose import pose_to_vector, rms_uncertainty
from vision.bundle.adjustment_validation_and_determinacy import NotHeldOut
from vision.bundle.marker_displacements import Places
from vision.measurement_result import MeasurementResult


def print_measurement(result: MeasurementResult) -> None:
    """Print what was measured, the verdict first."""
    print(result.verdict.line)
    _print_figures(result)
    print_frames_without_pose(result.measurement)
    _print_stages(result)
    if result.suspects:
        print(
            f"{len(result.suspects)} marker{'s are' if len(result.suspects) > 1 else ' is'} not what rig.toml "
            "says; what disagrees is left out of the "
            "poses:"
        )
        for suspect in result.suspects:
            print(f"  {suspect}")
    if result.places:
        _print_places(result.places)
    _print_cameras(result)
    if result.determination is not None:
        print(result.determination.summary())


def print_limb_pose_uncertainty(limb_measurement: MeasuredLimbPoses) -> None:
    """Print the standard uncertainty of poses by measuring limbs, and their agreement with vision."""
    position, rotation = rms_uncertainty(limb_measurement.poses.covariance)
    print(
        f"poses to {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad (standard uncertainty, RMS), of "
        "which readings "
        f"{rms_uncertainty(limb_measurement.poses.own)[0] * 1e3:.4f} mm, the limbs' geometry the rest; it agreed with vision "
        f"over {limb_measurement.accepted.agreement.n} poses"
    )


def print_learning(result: LearningResult, verdict_first: bool = True) -> None:
    """Print what poses taught. verdict_first : whether the verdict leads"""
    print("\n".join([*([result.verdict.line] if verdict_first else []), *result.found.lines]))
    print_frames_without_pose(result.sampled.measurement)


def _print_figures(result: MeasurementResult) -> None:
    """Print how much was measured and how well."""
    measured, held, (position, rotation) = result.measurement, result.held, result.uncertainty
    print(
        f"measured: {len(measured.frames)} of {result.frame_count} frames solved, poses to {position * 1e3:.4f} "
        f"mm and {rotation * 1e3:.4f} "
        "mrad "
        "(standard uncertainty, RMS)"
    )
    print(f"corners scatter by {measured.noise:.4f} px; {measured.inliers.sum()} of {len(measured.inliers)} used")
    print(
        f"held-out frames: residuals {held.ratio:.3f} +- {2 * held.scatter:.3f} of what the covariance predicts, "
        f"{held.rms:.3f} px RMS over {held.corners} corners"
        if not isinstance(held, NotHeldOut)
        else f"no held-out figure: {held.reason}"
    )


def _print_stages(result: MeasurementResult) -> None:
    """Print how many poses of a chain's stages there are and how well they are known."""
    for stage, own in result.measurement.stages.items():
        known = ""
        if len(own.frames):
            position, rotation = rms_uncertainty(own.covariance)
            known = f", poses to {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad"
        print(f"stage {stage}: {len(own.frames)} of {result.frame_count} frames solved{known}: poses_stage{stage}.csv")


def _print_cameras(result: MeasurementResult) -> None:
    """Print how far each camera stands from where its owner has it."""
    for stated, camera in zip(result.recording.design.cameras, result.measurement.design.cameras):
        step = pose_to_vector(stated.pose.inv() * camera.pose)
        print(
            f"camera {camera.name}: {(step[:3] ** 2).sum() ** 0.5 * 1e3:.3f} mm and "
            f"{(step[3:] ** 2).sum() ** 0.5 * 1e3:.3f} mrad from "
            f"where rig.toml has it, focal length {camera.matrix[0, 0] - stated.matrix[0, 0]:+.2f} px"
        )


def _print_places(moved: Places) -> None:
    """Print what adjusting the markers' places did."""
    print(
        "places of the markers adjusted: x y z in mm, rx ry rz in mrad, along the marker's own axes, with 95 "
        "% intervals"
    )
    for move in moved.moves:
        values = [f"{by * 1e3:+8.3f} +- {half * 1e3:.3f}" for by, half in zip(move.by, move.ci95)]
        print(f"  {str(move.place):12} {'moved' if move.moved else 'stays'} " + " ".join(values))
    for name, value in (("as stated", moved.before), ("as adjusted", moved.after)):
        print(
            f"residual of the platform per frame, places {name}: median {np.median(value):.3f}, 95 % "
            f"{np.quantile(value, 0.95):.3f}, "
            f"max {value.max():.3f} px RMS per axis"
        )
    print(
        f"squares over degrees of freedom, all corners by their scatter: {moved.weighted[0]:.2f} as stated, "
        f"{moved.weighted[1]:.2f} as adjusted"
    )
    print(f"frames flipped against those before and after: {', '.join(map(str, moved.odd)) or 'none'}")
