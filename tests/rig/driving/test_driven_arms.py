"""Arms and gantries driven as struts are: units on the wire, conformance, plan to run to calibration, refusals."""

import json
import re
import socket
import subprocess
import threading
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from rig.cli import command_line
from rig.driving.axis_display_units_and_controller_counts import controller_counts_per_metre_or_radian
from rig.driving.driving_clock import SystemClock
from rig.driving.emulators import emulator_opening_and_serving_over_terminal_or_tcp as opening
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import Faults
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.driving.emulators.protocol_conformance_checks_against_emulator import (
    check_protocol_conformance,
    protocol_conformance_design,
)
from rig.errors import FileError, PositionLost, Unreachable
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Arm
from rig.model.pose import pose_to_vector
from tests.cli import RIG

INSTRUMENT = '\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-6\nrotation_sigma = 1e-6\n'
FAST = "max_speed = 50.0\nmax_acceleration = 1000.0\n"
MACHINES = {"urscript": ("ur10", ""), "grblhal": ("gantry", ""), "linuxcnc": ("stanford", "")}  # by what drives them


def written(folder, arm, controller):
    """rig.toml of a shipped arm with an instrument and a [controller]."""
    path = folder / "rig.toml"
    text = (files("rig") / "arms" / f"{arm}.toml").read_text()
    path.write_text(f"{text}{INSTRUMENT}\n[controller]\n{controller}{FAST}")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("protocol", MACHINES)
def test_every_arm_passes_the_conformance_checks(tmp_path, protocol):
    design = load_design(written(tmp_path, MACHINES[protocol][0], f'protocol = "{protocol}"\nport = "none"\n'))
    checks = list(check_protocol_conformance(design, protocol, 40))
    assert len(checks) == 28 and [(check.name, check.problem) for check in checks if check.problem] == []


def test_conformance_of_urscript_without_a_rig_toml_is_tested_on_an_arm():
    design = protocol_conformance_design(None, "urscript")
    assert design.mechanism.axis_words == ("joint",) * 6
    assert not next(check_protocol_conformance(design, "urscript")).problem


def test_joints_are_counted_in_degrees_and_slides_in_mm(tmp_path):
    design = load_design(written(tmp_path, "stanford", 'protocol = "grblhal"\nport = "none"\n'))
    units = mechanisms.axis_units(design.mechanism)
    assert set(units) == {"m", "rad"}
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(design, "grblhal")
    driver.open()
    driver.home()
    goal = emulator.machine.home + np.array([0.02 if unit == "rad" else 0.003 for unit in units])
    driver.move(goal)
    np.testing.assert_allclose(emulator.machine.axes.at(emulator.now), goal, atol=2e-5)
    counted = controller_counts_per_metre_or_radian(units) * (goal - design.controller.zero)
    np.testing.assert_allclose(emulator._counts * emulator.machine.counters(emulator.now), counted, atol=2e-3)


def test_ranges_steps_and_speeds_of_joints_are_checked(tmp_path):
    path = written(tmp_path, "ur10", 'protocol = "urscript"\nport = "none"\nmax_step = 0.5\n')
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(load_design(path), "urscript")
    driver.open()
    driver.trust()
    start = driver.lengths()
    with pytest.raises(Unreachable, match=r"joint 2: 400\.\d+ deg is outside -360"):
        driver.move(start + np.eye(6)[1] * np.radians(400))
    with pytest.raises(Unreachable, match=r"34\.377 deg, \[controller\] max_step allows 28\.648 deg"):
        driver.move(start + np.eye(6)[2] * 0.6)
    with pytest.raises(ValueError, match=r"3437\.747 deg per second exceeds .* 2864\.7890 deg per"):
        driver.move(start + np.eye(6)[2] * 0.1, speed=60.0)
    with pytest.raises(ValueError, match=r"expected 6 finite values \(rad\)"):
        driver.move(start[:5])
    driver.move(start + np.eye(6)[2] * 0.1)
    assert len(emulator.machine.executed) == 1


def ur10_driver(tmp_path, **controller):
    design = load_design(written(tmp_path, "ur10", 'protocol = "urscript"\nport = "none"\n'))
    return emulated_driver_with_emulator_and_clock(design, "urscript", **controller)


@pytest.mark.parametrize(("zero", "known"), [(0.0, True), (7.0, False)])
def test_absolute_encoders_that_read_beyond_the_limits_are_not_believed(tmp_path, zero, known):
    driver, _, _ = ur10_driver(tmp_path)
    driver.controller = replace(driver.controller, zero=np.full(6, zero))
    assert driver.open().known == known
    if not known:
        with pytest.raises(PositionLost, match="--trust"):
            driver.move(np.zeros(6))


@pytest.mark.parametrize(("travel", "longest"), [(0.0, 0.1), (5e-5, 0.7)])
def test_a_move_to_where_the_arm_stands_is_no_fault(tmp_path, travel, longest):
    driver, _, clock = ur10_driver(tmp_path)
    driver.open()
    begun = clock.now()
    assert driver.move(driver.lengths() + travel).note == ""
    assert clock.now() - begun < longest


@pytest.mark.parametrize(
    "arm, controller, says",
    [
        ("ur10", 'protocol = "gcs"\nport = "none"\n', "joints that turn take"),
        ("panda", 'protocol = "urscript"\nport = "none"\n', "drives six joints"),
        ("ur10", 'protocol = "urscript"\nport = "none"\nhoming = true\n', "must state where homing = true"),
        ("stanford", 'protocol = "linuxcnc"\nport = "none"\nkinematics = "world"\n', "poses of a hexapod"),
    ],
)
def test_controllers_that_do_not_suit_an_arm_are_refused(tmp_path, arm, controller, says):
    with pytest.raises(FileError, match=says):
        load_design(written(tmp_path, arm, controller))


def test_a_jog_by_one_figure_is_of_one_unit(tmp_path, capsys):
    path = written(tmp_path, "stanford", 'protocol = "grblhal"\nport = "socket://127.0.0.1:9"\n')
    assert command_line.main(["jog", str(path), "--by", "3"]) == 1
    assert "these axes count both: name some by --strut" in capsys.readouterr().err
    for strut in ("1", "3"):
        assert command_line.main(["jog", str(path), "--by", "3", "--strut", strut]) == 1
        assert "127.0.0.1:9" in capsys.readouterr().err  # it goes as far as the port


@pytest.mark.slow
@pytest.mark.parametrize("protocol", MACHINES)
def test_a_plan_is_run_and_calibrated_and_a_pose_gone_to(tmp_path, protocol, capsys):
    path = written(tmp_path, MACHINES[protocol][0], f'protocol = "{protocol}"\nport = "none"\n')
    clock, design = SystemClock(), load_design(path)
    emulator = opening.emulator_of_design(design, Faults(), clock, speed_factor=20.0)
    wire, running = opening.tcp_server_for_emulator(emulator, ("127.0.0.1", 0)), threading.Event()
    served = threading.Thread(
        target=opening.serve_emulator,
        args=(emulator, wire, lambda: not running.is_set(), lambda name: None, lambda: None),
        daemon=True,
    )
    served.start()
    try:
        rec, out = tmp_path / "rec", tmp_path / "calibration.json"
        words = ["run", str(path), "--port", wire.name, "--plan", "sobol:24", "--settle", "time:0"]
        assert command_line.main([*words, "--out", str(rec)]) == 0, capsys.readouterr().err
        truth = design.mechanism
        rows = np.array(truth.joints) + np.where(np.asarray(truth.joints) != 0, 2e-4, 0.0)
        truth = Arm(rows, truth.limits, truth.base, truth.tool, truth.slides)
        write_poses_of_visits(rec, truth)
        assert command_line.main(["check", str(rec)]) == 0
        assert command_line.main(["calibrate", str(rec), "--out", str(out)]) == 0, capsys.readouterr().err
        wanted = poses_of(truth, truth.limits.mean(axis=1) + 0.1 * np.ptp(truth.limits, axis=1))
        capsys.readouterr()
        pose = ",".join(f"{value:.9f}" for value in wanted)
        words = ["go", str(out), "--rig", str(path), "--port", wire.name, f"--pose={pose}", "--json"]
        assert command_line.main(words + (["--trust"] if protocol != "urscript" else [])) == 0, capsys.readouterr().err
        gone = json.loads(capsys.readouterr().out)
        off = poses_of(truth, emulator.machine.axes.at(clock.now()))[:3] - wanted[:3]
        assert gone["moved"] and np.linalg.norm(off) < 2e-5, off
    finally:
        running.set()
        served.join()
        wire.close()


@pytest.mark.slow
def test_cameras_see_a_driven_arm(tmp_path, capsys):
    path, rec, found = tmp_path / "rig.toml", tmp_path / "rec", tmp_path / "found"
    words = ["new", "design", "--arm", "ur10", "--seen", "cubes", "--cameras", "2", "--size", "640x480"]
    assert command_line.main([*words, "--out", str(path)]) == 0
    with socket.create_server(("127.0.0.1", 0)) as free:
        source = f'"emulator:127.0.0.1:{free.getsockname()[1]}"'
    text = path.read_text().replace('shutter = "global"', f'shutter = "global"\nsource = {source}')
    path.write_text(text + f'\n[controller]\nprotocol = "urscript"\nport = "none"\nhoming = false\n{FAST}')
    emulate = [*RIG, "emulate", path, "--tcp", "0", "--cameras", source[10:-1]]
    with subprocess.Popen(emulate, stdout=subprocess.PIPE, text=True) as emulator:
        try:
            port = next(one[1] for line in emulator.stdout if (one := re.match("port (.*)", line)))
            words = ["run", str(path), "--port", port, "--plan", "sobol:4", "--settle", "time:0", "--no-measure"]
            assert command_line.main([*words, "--out", str(rec)]) == 0, capsys.readouterr().err
        finally:
            emulator.terminate()
    assert command_line.main(["measure", str(rec), "--out", str(found)]) == 0, capsys.readouterr().err
    seen = np.genfromtxt(found / "poses.csv", delimiter=",", skip_header=1)
    run = np.genfromtxt(rec / "commands.csv", delimiter=",", names=True)
    frames = np.genfromtxt(rec / "frames.csv", delimiter=",", names=True, dtype=None, encoding=None)
    arm = load_design(path).mechanism
    q = np.stack([np.interp(np.unique(frames["t"]), run["t"], run[name]) for name in arm.axes], axis=-1)
    assert len(seen) == 4
    np.testing.assert_allclose(seen[:, 1:4], poses_of(arm, q)[:, :3], atol=2e-4)


def write_poses_of_visits(rec, truth):
    """poses.csv of a run's visits, as an instrument sees a true arm."""
    visits = np.genfromtxt(rec / "visits.csv", delimiter=",", names=True, dtype=None, encoding=None)
    q = np.stack([visits[name] for name in truth.axes], axis=-1)
    vectors = poses_of(truth, q)
    lines = [f"{frame}," + ",".join(f"{value:.10f}" for value in row) for frame, row in zip(visits["frame"], vectors)]
    (rec / "poses.csv").write_text("\n".join(["frame,x,y,z,rx,ry,rz", *lines]) + "\n")


def poses_of(arm, q):
    """(..., 6) m and rad, poses of joint values (..., n)."""
    return pose_to_vector(mechanisms.kinematics_of(arm).forward(np.asarray(q, float), arm))
