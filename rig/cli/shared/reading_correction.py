"""rig correct CALIBRATION --forward readings.csv: what a measuring machine reads -> the poses that it stands for,
corrected.
"""

from argparse import Namespace

from rig.cli.shared import user_effects_option
from rig.errors import RigError

BEYOND = 0.05  # of an axis' range, by which a reading may lie beyond it


def poses_of_readings(arguments: Namespace) -> None:
    """Readings -> poses with covariance: the summands with the opposite sign.

    Raises RigError for options that are about commands, and for what cannot be read
    Source: configuration-space patent, [0062], [0068] to [0072], [0131]
    """
    import numpy as np

    from calib.models.corrected_pose_covariance import pose_covariance
    from rig.formats import csv_table
    from rig.model import mechanisms
    from rig.recording import recording_tables
    from rig.recording.corner_and_pose_tables import Poses

    if arguments.uncorrected or arguments.single_step or arguments.skip_unreachable or arguments.sensors:
        raise RigError(
            "--uncorrected, --single-step, --skip-unreachable and --sensors are about commands for wanted "
            "poses, not about --forward"
        )
    calibration = user_effects_option.load_calibration(
        arguments.calibration, user_effects_option.load_effect_files(arguments)
    )
    correction, nominal = calibration.correction, calibration.correction.nominal
    kinematics = mechanisms.kinematics_of(nominal)
    rows = csv_table.read(arguments.forward, ("frame", *nominal.axes))
    readings, frames = rows.matrix(nominal.axes), rows.whole("frame")
    out = arguments.outputs.file(arguments.out)
    far = np.abs(kinematics.limits(readings, nominal)) > BEYOND * np.ptp(kinematics.travel(nominal), axis=1)
    if far.any():
        i, axis = np.argwhere(far)[0].tolist()
        rows.fail(f"{nominal.axes[axis]} is read beyond its range", i, nominal.axes[axis], readings[i, axis])
    T = correction.predict(readings)
    covariance = pose_covariance(calibration, T, readings)
    recording_tables.write_poses(out, Poses(frames, T, covariance))
    position, rotation = (
        float(np.sqrt(np.trace(covariance[:, part, part], axis1=1, axis2=2).mean()))
        for part in (slice(0, 3), slice(3, 6))
    )
    moved = np.linalg.norm(T.translation - kinematics.forward(readings, nominal).translation, axis=1)
    print(
        f"{len(frames)} poses written to {arguments.out}: {np.sqrt((moved**2).mean()) * 1e3:.4f} mm RMS from "
        "what the owner's model reads; "
        f"standard uncertainty {position * 1e3:.4f} mm and {rotation * 1e3:.4f} mrad RMS"
    )
    if calibration.physics is not None:
        print("what the calibration knows of physics is not taken off readings: it depends on what went before them")
