"""Tilt sensors on an arm that stands on a bending column: corrected at least twice as well as without them.

Kinematics, the column's bending, the sensors and the Cramer-Rao bound are those of a second writer: tests.truth.column.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import calib
import rig
from calib.api.calibrate import CalibrateOptions
from calib.models.arm.arm_error_model_and_instrument_observations import (
    arm_with_parameter_step,
    observations_of_samples,
    parameter_jacobian,
)
from calib.models.arm.arm_identification_and_joint_profiles import identify_arm
from calib.models.arm.tilt_observations import (
    link_rotation_jacobian_by_joints,
    link_rotation_jacobian_by_parameters,
    tilt_equation_rows,
)
from calib.models.base_and_tool_displacement_between_recordings import samples_without_displacement
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.errors import FileError, RigError
from rig.model.base_and_link_tilt_sensors import TiltReadings, TiltSensor
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from tests.numerical_derivatives import jacobian
from tests.rig.arms import UR10
from tests.truth import draw
from tests.truth.case import Case
from tests.truth.column import Column, least_position_error, standing_on_a_column
from tests.truth.kinematics import Arm
from tests.truth.written import rig_toml, table

TILT, POSITION = 2e-4, 3e-4  # rad and m, noise
LEAN = 4e-3  # rad RMS of the column
COUNT = 30
LINKS = (0, 1, 2, 3, 5)


def case_on_a_column(seed: int, lean: float = LEAN) -> tuple[Case, Column, np.random.Generator]:
    """(the case of its arm, the arm as it is on a column with level sensors, rng)."""
    case, rng = draw(seed, "none", kind="arm"), np.random.default_rng([2026, seed])
    assert isinstance(case.owner, Arm) and isinstance(case.machine, Arm)
    middle = case.owner.frames(case.owner.ranges.mean(axis=1)[None])
    mounts = {link: middle[link][0, :3, :3].T for link in LINKS}
    return case, standing_on_a_column(case.machine, lean, mounts, rng), rng


def recorded(case: Case, column: Column, q, rng, folder, sensors=LINKS):
    """Recording of positions, and of the sensors on some links, at commands q (n, 6)."""
    folder.mkdir()
    text = rig_toml(replace(case, sigma=(POSITION, 0.0))).replace("rotation_sigma = 0.0\n", "")
    middle = case.owner.frames(case.owner.ranges.mean(axis=1)[None])
    for link in sensors:
        level = Rotation.from_matrix(middle[link][0, :3, :3].T).as_rotvec().tolist()
        text += f'\n[[tilt_sensor]]\nname = "s{link}"\nlink = {link}\nsigma = {TILT}\nmount = {level}\n'
    (folder / "rig.toml").write_text(text)
    t = 10.0 * np.arange(len(q))
    (folder / "frames.csv").write_text("frame,t,camera,image\n" + "".join(f"{k},{x + 5},,\n" for k, x in enumerate(t)))
    rows = np.column_stack([np.concatenate([t + 4, t + 6]), np.tile(q, (2, 1))])
    table(folder / "commands.csv", ("t", *case.owner.names), rows[np.argsort(rows[:, 0])])
    seen = column.forward(q)[:, :3, 3] + rng.normal(0, POSITION, (len(q), 3))
    table(folder / "poses.csv", ("frame", "x", "y", "z"), np.column_stack([np.arange(len(q)), seen]))
    if sensors:
        read = column.read(q, TILT, rng)
        names = [f"tilt_s{link}_{axis}_rad" for link in sensors for axis in "xy"]
        table(folder / "sensors.csv", ("t", *names), np.column_stack([t + 5, *(read[link] for link in sensors)]))
    return rig.load(folder)


def error_when_driven(column: Column, calibration, goal: np.ndarray) -> float:
    """m, RMS position error where commands of a calibration for poses goal (n, 4, 4) take the arm."""
    commands = calib.correct(calibration, RigidTransform.from_matrix(goal)).values
    off = column.forward(np.asarray(commands))[:, :3, 3] - goal[:, :3, 3]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def errors_without_and_with_sensors(seed: int, tmp_path) -> tuple[list[float], list[float]]:
    """([m, RMS error after correction without tilt sensors, with], [m, Cramer-Rao bound of each])."""
    case, column, rng = case_on_a_column(seed)
    ranges = case.owner.ranges
    q = rng.uniform(*ranges.T, (COUNT, 6))
    middle, half = ranges.mean(axis=1), np.ptp(ranges, axis=1) / 2
    new = middle + 0.8 * half * rng.uniform(-1, 1, (60, 6))
    goal, found = column.forward(new), []
    for sensors in ((), LINKS):
        folder = tmp_path / f"{seed} {len(sensors)}"
        made = calib.calibrate(recorded(case, column, q, rng, folder, sensors), CalibrateOptions(quick=True))
        found.append(error_when_driven(column, made.calibration, goal))
    second = recorded(case, column, new, rng, tmp_path / f"{seed} again")
    placed = samples_without_displacement(made.calibration, second, sample_recording(second).samples).samples
    left = made.calibration.correction.predict(placed.effective).translation - placed.T_base_platform.translation
    assert np.sqrt((left**2).mean()) < 1.6 * POSITION  # what the base leans is taken off once, not twice
    return found, [least_position_error(column, q, new, POSITION, noise, 0.02) for noise in (0.0, TILT)]


@pytest.mark.slow
def test_tilt_sensors_halve_the_error_of_an_arm_on_a_column(tmp_path):
    (without, with_them), (bound_without, bound) = errors_without_and_with_sensors(1, tmp_path)
    print(f"error {without * 1e3:.3f} mm without, {with_them * 1e3:.3f} mm with; bound {bound * 1e3:.3f} mm")
    assert with_them < without / 2 and with_them < 1.4 * bound < 1.4 * bound_without


@pytest.mark.slow
def test_tilt_sensors_halve_the_error_of_twelve_arms(tmp_path):
    each = [errors_without_and_with_sensors(seed, tmp_path) for seed in range(12)]
    error, bound = (np.array(part) for part in zip(*each))
    ratio, over = error[:, 0] / error[:, 1], error[:, 1] / bound[:, 1]
    print(f"without over with: {np.sort(ratio).round(2)}; with over its bound: {np.sort(over).round(2)}")
    print(f"bound without over with: {np.sort(bound[:, 0] / bound[:, 1]).round(2)}")
    assert ratio.min() > 2 and np.median(over) < 1.25


def test_rows_agree_with_differences():
    rng, n = np.random.default_rng(4), 5
    sensors = (TiltSensor("a", 0, TILT, np.zeros(3)), TiltSensor("b", 3, TILT, np.array([0.4, -0.2, 0.1])))
    q = 0.3 * rng.normal(size=(n, 6))
    down = np.tile([0.05, -0.02, -1.0] / np.linalg.norm([0.05, -0.02, -1.0]), (n, 1))
    arm = UR10

    def shown(arm, q=q, lean=(0.0, 0.0, 0.0)):
        links = Rotation.from_rotvec(lean).as_matrix() @ mechanism.single_hand_arm_link_frames(q, arm)[..., :3, :3]
        return np.stack([sensor.shown(links[:, sensor.link], down) for sensor in sensors], axis=1)

    read = TiltReadings(sensors, shown(arm), down)
    rows = tilt_equation_rows(read, q, arm)
    np.testing.assert_allclose(rows.residuals, 0, atol=1e-12)
    turned = link_rotation_jacobian_by_parameters(read, q, arm, parameter_jacobian(q, arm))
    by_step = jacobian(lambda step: shown(arm_with_parameter_step(arm, step)), np.zeros(42))
    np.testing.assert_allclose(rows.turns @ turned, by_step, atol=1e-7)
    by_joint = jacobian(lambda step: shown(arm, q + step), np.zeros(6))
    np.testing.assert_allclose(rows.turns @ link_rotation_jacobian_by_joints(read, q, arm), by_joint, atol=1e-7)
    np.testing.assert_allclose(rows.turns, jacobian(lambda lean: shown(arm, lean=lean), np.zeros(3)), atol=1e-7)
    leaned = TiltReadings(sensors, shown(arm, lean=np.array([1e-3, 2e-3, 0])), down)
    back = leaned.with_lean(np.tile([1e-3, 2e-3, 0], (n, 1)))
    np.testing.assert_allclose(tilt_equation_rows(back, q, arm).residuals, 0, atol=1e-12)


def test_a_wild_reading_is_left_out_and_a_sensor_that_scatters_counts_less(tmp_path):
    case, column, rng = case_on_a_column(2, 1e-6)
    recording = recorded(case, column, rng.uniform(*case.owner.ranges.T, (COUNT, 6)), rng, tmp_path / "a")
    log = recording.sensors.channels
    wild = {**log, "tilt_s2_x_rad": log["tilt_s2_x_rad"] + 0.05 * (np.arange(COUNT) == 7)}
    wild["tilt_s3_y_rad"] = wild["tilt_s3_y_rad"] + rng.normal(0, 3e-3, COUNT)
    recording = replace(recording, sensors=replace(recording.sensors, channels=wild))
    observed = observations_of_samples(sample_recording(recording).samples)
    found = identify_arm(observed, recording.design.mechanism)
    assert not found.tilts.used[7, LINKS.index(2)] and found.tilts.used[:, LINKS.index(2)].sum() >= COUNT - 2
    assert 1e-3 < found.tilts.scatter[LINKS.index(3)] < 5e-3 and found.tilts.scatter[0] < TILT


@pytest.mark.parametrize(
    "was, now, says",
    [
        ("link = 2", "link = 7", "is 0, the base, to 6, not 7"),
        ("sigma = 0.0002\nmount", "sigm = 0.0002\nmount", "sigm"),
        ('name = "s2"', 'name = "s1"', "listed twice"),
    ],
)
def test_what_is_stated_wrongly_is_refused(tmp_path, was, now, says):
    case, column, rng = case_on_a_column(3)
    folder = tmp_path / "a"
    recorded(case, column, rng.uniform(*case.owner.ranges.T, (COUNT, 6)), rng, folder)
    text = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(text.replace(was, now, 1))
    with pytest.raises(FileError, match=says):
        rig.load(folder)


def test_a_sensor_that_was_not_logged_is_refused(tmp_path):
    case, column, rng = case_on_a_column(3)
    recording = recorded(case, column, rng.uniform(*case.owner.ranges.T, (COUNT, 6)), rng, tmp_path / "a")
    logged = {name: values for name, values in recording.sensors.channels.items() if "s2" not in name}
    with pytest.raises(RigError, match="tilt_s2_x_rad"):
        calib.calibrate(replace(recording, sensors=replace(recording.sensors, channels=logged)))
    half = {**logged, "tilt_s2_x_rad": np.zeros(COUNT)}
    with pytest.raises(RigError, match="belong together"):
        calib.calibrate(replace(recording, sensors=replace(recording.sensors, channels=half)))
