"""The controller's own limits against the rig.toml's: a line with both figures, and goals that it would refuse."""

from dataclasses import replace

import numpy as np
import pytest

from rig.driving.controller_status_and_limits import limits_of_linuxcnc_ini, require_goals_within_limits
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.errors import FileError, Unreachable
from tests.emulated_run import RigInThread

INI = """
[TRAJ]
LINEAR_UNITS = mm  # of joints too
[JOINT_0]
MIN_LIMIT = -20
MAX_LIMIT = 20.0
MAX_VELOCITY = 5
MAX_ACCELERATION = 50
MAX_ACCELERATION = 1
"""


def test_limits_that_are_the_rigs_own_are_not_warned_of(ready):
    assert ready[0].limit_warnings() == []


def test_a_slower_grblhal_with_a_shorter_travel_is_told_with_both_figures(driven_design):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, "grblhal", (), 1)
    whole = np.ptp(driver.mechanism.strut_range[2]) * 1e3
    emulator.settings |= {112: 300.0, 123: 40.0, 132: 30.0}
    driver.open()
    speed, acceleration = driver.limit_warnings()
    assert "strut 3" in speed and "5 mm/s ($110 ..)" in speed and "max_speed is 10 mm/s" in speed
    assert "strut 4" in acceleration and "40 mm/s^2" in acceleration and "100 mm/s^2" in acceleration
    emulator.settings[20] = 1
    driver.close()
    driver.open()
    travel = driver.limit_warnings()[0]
    assert "strut 3" in travel and "30.000 mm" in travel and f"{whole:.3f} mm" in travel


def test_a_gcs_with_a_shorter_travel_is_told_with_both_ends(driven_design):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, "gcs", (), 1)
    emulator.limits = emulator.limits.copy()
    emulator.limits[4, 1] -= 2e-3
    driver.open()
    (line,) = driver.limit_warnings()
    low, high = driver.mechanism.strut_range[4] * 1e3
    assert "strut 5" in line and f"to {high - 2:.3f} mm (TMN?, TMX?)" in line and f"to {high:.3f} mm" in line
    goals = np.tile(driver.mechanism.strut_range.mean(axis=1), (3, 1))
    require_goals_within_limits(driver.limits(), goals, driver.controller.zero, driver.mechanism)
    goals[1, 4] = high * 1e-3 - 1e-3
    with pytest.raises(Unreachable, match=f"goal 2: strut 5 to {high - 1:.3f} mm.*to {high - 2:.3f} mm"):
        require_goals_within_limits(driver.limits(), goals, driver.controller.zero, driver.mechanism)


def test_a_gcs_that_does_not_know_the_question_is_driven_all_the_same(driven_design, monkeypatch):
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, "gcs", (), 1)
    ask = emulator._ask
    monkeypatch.setattr(
        emulator, "_ask", lambda word, rest: setattr(emulator, "error", 2) if word[:2] == "TM" else ask(word, rest)
    )
    driver.open()
    assert driver.limits() is None and driver.status().fault == ""


def test_linuxcnc_limits_come_from_its_ini(driven_design, tmp_path):
    path = tmp_path / "machine.ini"
    path.write_text(INI)
    found = limits_of_linuxcnc_ini(path, ["m"] * 6)
    np.testing.assert_allclose(found.travel[0], [-0.02, 0.02])
    assert found.speed[0] == 5e-3 and found.acceleration[0] == 50e-3 and np.isnan(found.travel[1:]).all()
    design = replace(driven_design, controller=replace(driven_design.controller, ini=str(path)))
    driver, _, _ = emulated_driver_with_emulator_and_clock(design, "linuxcnc", (), 1)
    travel, speed, acceleration = driver.limit_warnings()
    assert "its ini" in travel and "5 mm/s" in speed and "max_speed is 10 mm/s" in speed and "50 mm/s^2" in acceleration
    path.write_text(INI.replace("-20", "left"))
    with pytest.raises(FileError, match=r"\[JOINT_0\] MIN_LIMIT = 'left' is no number"):
        driver.limits()


@pytest.mark.parametrize("word, size", [("radian", 1.0), ("gon", np.pi / 200), ("degree", np.pi / 180)])
def test_angles_of_an_ini_are_in_its_units(tmp_path, word, size):
    path = tmp_path / "machine.ini"
    path.write_text(INI.replace("[JOINT_0]", f"ANGULAR_UNITS = {word}\n[JOINT_0]\nTYPE = ANGULAR"))
    np.testing.assert_allclose(limits_of_linuxcnc_ini(path, ["rad"]).travel[0], [-20 * size, 20 * size])
    with pytest.raises(FileError, match=r"\[JOINT_0\] TYPE = ANGULAR, but the rig.toml's axis 1 counts in m"):
        limits_of_linuxcnc_ini(path, ["m"])
    path.write_text(path.read_text().replace(word, "turns"))
    with pytest.raises(FileError, match="ANGULAR_UNITS = 'turns' is none of deg, degree, rad"):
        limits_of_linuxcnc_ini(path, ["rad"])


def test_a_plan_beyond_the_controllers_travel_is_refused_at_the_dry_run_and_at_the_start(tmp_path, capsys):
    from rig.cli.command_line import main

    rig = RigInThread(tmp_path)
    try:
        words = ["run", str(rig.path), "--plan", "sobol:2", "--out", str(tmp_path / "rec")]
        rig.emulator.settings |= {110: 600.0}
        assert main([*words, "--dry-run"]) == 0
        printed = capsys.readouterr()[0]
        assert "warning: strut 1: the controller allows 10 mm/s ($110 ..), max_speed is 5000 mm/s" in printed
        assert main(["status", str(rig.path)]) == 0 and "warning: strut 1" in capsys.readouterr()[0]
        rig.emulator.settings |= {20: 1, 130: 2.0}
        assert main([*words, "--dry-run"]) == 1
        assert "the controller travels 2.000 mm ($130 .. with $20=1)" in capsys.readouterr()[1]
        with pytest.raises(Unreachable, match="strut 1 needs .* the controller travels 2.000 mm"):
            rig.run(tmp_path / "other")
        assert not rig.emulator.machine.executed and not rig.emulator.machine.homed
    finally:
        rig.close()
