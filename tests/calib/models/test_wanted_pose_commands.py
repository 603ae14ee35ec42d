"""Commands for wanted poses: the library gives those of the command line, leaves no known physics out, and states how
sure each pose is.
"""

from contextlib import nullcontext

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import calib
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.files import calibration_file
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.chain import chain_error_model_and_identification as chains
from calib.models.machine_parameters_and_file_entries import corrected_pose_covariance
from rig.effects.framework.effect_checks_and_fit_coordinates import fit_coordinates_of_effects
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import FileError, RigError, Unreachable
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.layout import hexapod_layout_and_camera_placement, shipped_arms_and_layouts
from rig.recording import corner_and_pose_csv_tables
from rig.recording.corner_and_pose_csv_tables import Poses, write_poses
from rig.recording.recording_folder import Sensors
from rig.recording.wanted_poses_and_roll_pitch_yaw import WantedPoses
from tests import gantry_and_hexapod
from tests.cli import command


def designed(folder, kind):
    """Design of a machine of a kind."""
    if kind == "chain":
        return gantry_and_hexapod.written(folder)
    text = (
        shipped_arms_and_layouts.shipped_arm_rig_toml("puma560")
        if kind == "arm"
        else hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3)
        if kind == "hexapod"
        else hexapod_layout_and_camera_placement.two_strut_layout_rig_toml(0.3)
    )
    (folder / "rig.toml").write_text(text)
    return design_from_rig_toml.load_design(folder / "rig.toml")


def calibrated(design, *effects):
    """Calibration of a machine as stated, a little unsure, but for effects."""
    m = design.mechanism
    kind, count = m.kind, len(m.axes)
    known = None
    p = (
        12 + 5 * count
        if kind == "arm"
        else len(chains.parameter_tolerances(m))
        if kind == "chain"
        else len(geometric_parameters(m))
    )
    if effects:
        n = len(fit_coordinates_of_effects(effects))
        known = Physics(
            effects,
            1e-12 * np.eye(n),
            np.zeros((p, n)),
            design.gravity,
            design.actuator,
            design.platform,
            {
                name: (21.0, 1.0)
                for name in ("ambient_temperature_C", *(f"strut{k}_temperature_C" for k in range(1, 7)))
            },
        )
    none = (None,) * count
    correction = (
        ArmCorrection(m, m, none, sobol_configurations(m.limits, 40, 0.7, 5))
        if kind == "arm"
        else Correction(m, m, none)
    )
    scatter = np.repeat([2e-6, 1e-5], 3) if kind in ("arm", "chain") else np.full(count, 3e-6)
    return Calibration(correction, 1e-12 * np.eye(p), scatter, (1,), (), None, {"seed": 0}, None, known)


def wanted_of(design, count=6):
    m = design.mechanism
    return mechanisms.kinematics_of(m).forward(
        sobol_configurations(mechanisms.kinematics_of(m).travel_ranges(m), count, 0.5, 3), m
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "effects"),
    [
        ("hexapod", ("backlash:strut3:gap=1e-4", "thermal_expansion:rig:coefficient=2e-5")),
        ("arm", ("backlash:joint 2:gap=4e-4", "scale_error:joint 1:scale=4e-4")),
    ],
)
def test_the_library_commands_what_the_command_line_does_and_refuses_to_leave_physics_out(
    tmp_path, capsys, kind, effects
):
    design = designed(tmp_path, kind)
    calibration, wanted = calibrated(design, *map(parse_effect, effects)), wanted_of(design)
    calibration_file.save(tmp_path / "c.json", calibration)
    write_poses(tmp_path / "w.csv", Poses(np.arange(len(wanted)), wanted, None))
    command(capsys)("correct", tmp_path / "c.json", "--poses", tmp_path / "w.csv", "--out", tmp_path / "k.csv")
    given = csv_and_parquet_tables_and_time_origin.read_csv_table(
        tmp_path / "k.csv", ("frame", *design.mechanism.axes)
    ).matrix(design.mechanism.axes)
    loaded = calibration_file.load(tmp_path / "c.json")
    done = calib.correct(loaded, wanted)
    np.testing.assert_allclose(done.values, given, atol=1e-9)
    np.testing.assert_allclose(calib.correct(loaded, wanted[0]).values, given[:1], atol=1e-9)
    assert np.abs(loaded.correction.inverse_without_physics(wanted) - given).max() > 1e-5
    for one in (loaded.correction.inverse, loaded.correction.single_step):
        with pytest.raises(RigError, match=r"physics that commands must compensate \(.*backlash at .*calib\.correct"):
            one(wanted)
    sensors = Sensors(np.array([0.0]), {name: np.array([25.0]) for name in calibration.physics.channels})
    t = 100.0 * (1 + np.arange(len(wanted)))
    timed = calib.correct(
        loaded, WantedPoses(Poses(np.arange(len(t)), wanted, None), t), calib.CorrectOptions(sensors)
    ).commanded
    np.testing.assert_array_equal(timed.route.times, t)
    with pytest.raises(Unreachable, match="frame 0"):
        calib.correct(loaded, RigidTransform.from_translation([9.0, 0, 0]) * wanted)


@pytest.mark.parametrize("kind", ["hexapod", "planar2", "arm", "chain"])
@pytest.mark.parametrize("timed", [False, True])
def test_how_sure_each_pose_is_stands_beside_the_commands_of_every_machine(tmp_path, capsys, kind, timed):
    design = designed(tmp_path, kind)
    calibration, wanted = calibrated(design), wanted_of(design)
    calibration_file.save(tmp_path / "c.json", calibration)
    write_poses(tmp_path / "w.csv", Poses(np.arange(len(wanted)), wanted, None))
    if timed:
        rows = (tmp_path / "w.csv").read_text().splitlines()
        (tmp_path / "w.csv").write_text(
            "\n".join([rows[0] + ",t", *(f"{row},{60 * (k + 1)}" for k, row in enumerate(rows[1:]))]) + "\n"
        )
    output = command(capsys)("correct", tmp_path / "c.json", "--poses", tmp_path / "w.csv", "--out", tmp_path / "k.csv")
    assert "stated standard uncertainty of the poses: 0.0" in output
    stated = corner_and_pose_csv_tables.load_poses(tmp_path / "k.poses.csv", are_commands=True)
    done = calib.correct(calibration, wanted)
    np.testing.assert_allclose(
        stated.covariance, corrected_pose_covariance(calibration, wanted, done.values), rtol=1e-6, atol=1e-18
    )
    np.testing.assert_allclose(stated.T_base_platform.as_matrix(), wanted.as_matrix(), atol=1e-9)
    with pytest.raises(FileError, match="not positive definite") if kind == "planar2" else nullcontext():
        corner_and_pose_csv_tables.load_poses(tmp_path / "k.poses.csv")
    assert (np.trace(stated.covariance[:, :3, :3], axis1=1, axis2=2) > 1e-12).all()


@pytest.mark.parametrize("kind", ["hexapod", "planar2", "arm", "chain"])
def test_commands_in_mm_and_degrees_with_decimal_commas_are_those_in_m_and_rad(tmp_path, capsys, kind):
    design = designed(tmp_path, kind)
    calibration, wanted = calibrated(design), wanted_of(design)
    calibration_file.save(tmp_path / "c.json", calibration)
    write_poses(tmp_path / "w.csv", Poses(np.arange(len(wanted)), wanted, None))
    table = csv_and_parquet_tables_and_time_origin.read_csv_table(tmp_path / "w.csv", ("frame",))
    factors = [1e3] * 3 + [180 / np.pi] * 3
    lines = [";".join([row[0], *(f"{float(v) * f:.12f}" for v, f in zip(row[1:7], factors))]) for row in table.rows]
    text = "\n".join(["frame;x;y;z;rx;ry;rz", *(line.replace(".", ",") for line in lines)]) + "\n"
    (tmp_path / "mm.csv").write_text(text)
    run = command(capsys, "correct", tmp_path / "c.json")
    run("--poses", tmp_path / "w.csv", "--out", tmp_path / "k.csv")
    stated = ("--units", "mm, deg", "--decimal", "comma")
    run("--poses", tmp_path / "mm.csv", "--out", tmp_path / "k_mm.csv", *stated)
    axes = design.mechanism.axes
    plain = csv_and_parquet_tables_and_time_origin.read_csv_table(tmp_path / "k.csv", axes).matrix(axes)
    form = csv_and_parquet_tables_and_time_origin.TableFormat(decimal="comma")
    found = csv_and_parquet_tables_and_time_origin.read_csv_table(tmp_path / "k_mm.csv", axes, form=form).matrix(axes)
    per = [1e3 if unit == "m" else 180 / np.pi for unit in mechanisms.axis_units(design.mechanism)]
    np.testing.assert_allclose(found, plain * per, rtol=0, atol=1e-6)
    assert "," in (tmp_path / "k_mm.csv").read_text().splitlines()[1]
    (tmp_path / "far.csv").write_text("frame;x;y;z;rx;ry;rz\n0;90000,5;0;0;0;0;0\n")
    output = run("--poses", tmp_path / "far.csv", "--out", tmp_path / "no.csv", *stated, ok=False)
    assert "far.csv:2:2: x = 90000.5 mm is implausible" in output
    output = run("--poses", tmp_path / "w.csv", "--out", tmp_path / "no.csv", "--units", "mm,degs", ok=False)
    assert "--units takes a unit of lengths" in output
    output = run("--forward", tmp_path / "k.csv", "--out", tmp_path / "no.csv", "--units", "mm,deg", ok=False)
    assert "--units and --decimal apply to commands for wanted poses" in output
