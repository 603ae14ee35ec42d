"""The end of an investigation: a calibration with what was found, verified on new poses, and its certificate where
these suffice.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.experiment.investigation_folder import Look, diagnosis_path, plan_path, recording_path
from calib.experiment.investigation_machine import InvestigatedRig
from calib.files import calibration_file
from calib.models.arm import error_model
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.mechanism_kinds import require_arm
from rig.planning.configuration_sets import sobol_configurations
from rig.planning.plan import axis_strokes, build_plan
from rig.planning.plan_construction_and_table import write_plan_table
from rig.recording.recording_tables import Poses, write_poses

REACH = 0.7  # of the strokes, over which new poses lie: what is corrected has to be reached as well
VERIFYING = 1000  # added to the seed for the new poses


def certify_investigation(out: Path, rig: InvestigatedRig, looks: Sequence[Look]) -> tuple[str, ...]:
    """Calibrate, correct, verify on new poses and certify; what was done and what could not be, in lines. Raises
    Waiting as `InvestigatedRig.record` does

    Where a command refuses, what follows from it is left out, and that is a line
    """
    said = []
    recordings = [str(recording_path(out, look.number)) for look in looks]
    calibration, number = out / "calibration.json", len(looks)
    poses, commands, plan, again = (
        out / f"verify{number}{suffix}" for suffix in ("-poses.csv", "-commands.csv", ".csv", "")
    )
    done = plan.exists()
    try:
        if not done:
            rig.call(
                "calibrate", *recordings, "--diagnosis", str(diagnosis_path(out, number)), "--out", str(calibration)
            )
    except RigError as error:
        return (f"not calibrated: {error}",)
    found = ", ".join(looks[-1].findings) or "no physics"
    said.append(f"{calibration.name}: of {len(recordings)} recording{'s' * (len(recordings) > 1)}, with {found}")
    try:
        if not done:
            _wanted(poses, rig, calibration)
            rig.call(
                "correct",
                str(calibration),
                "--poses",
                str(poses),
                "--out",
                str(commands),
                "--skip-unreachable",
                "--force",
            )
            stands = build_plan(
                rig.design, f"commands:{plan_path(out, number)}"
            ).turned  # cubes stay as they were put back
            write_plan_table(
                plan, replace(build_plan(rig.design, f"commands:{commands}"), turned=stands), rig.design.mechanism.axes
            )
        rig.record(plan, again, rig.options.seed + VERIFYING)
        rig.call("verify", str(calibration), str(again))
        said.append(f"verified on new poses, commanded through the correction: {again.name}")
    except RigError as error:
        return (*said, f"not verified: {error}")
    try:
        rig.call("certify", str(calibration), str(again), "--out", str(out / "certificate"))
        said.append("certificate")
    except RigError as error:
        said.append(f"no certificate: {error}")
    return tuple(said)


def _wanted(path: Path, rig: InvestigatedRig, calibration: Path) -> None:
    """Write new poses all over what the axes reach; of an arm as its calibration has it, in the instrument's own
    frame.
    """
    m = rig.design.mechanism
    lengths = sobol_configurations(axis_strokes(rig.design), rig.options.verify, REACH, rig.options.seed + VERIFYING)
    if m.kind == "arm":
        T = error_model.predicted_target_poses(
            lengths, require_arm(calibration_file.load(calibration).correction.fitted)
        )
    else:
        T = mechanisms.kinematics_of(m).forward(lengths, m)
    write_poses(path, Poses(np.arange(len(lengths)), T, None))
