"""LinuxCNC itself with simulated joints: through rigkins its joints stand where `rig correct` commands them."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calib.api.correct import CorrectOptions, correct
from calib.correction.hexapod_kinematics_c_source_for_linuxcnc_and_grblhal import linuxcnc_kinematics_source
from rig.model.mechanisms import hexapod
from tests.calib.controllers_in_c import (
    CALIBRATIONS,
    THERMAL,
    WARM,
    calibration_of,
    effects,
    fitted,
    remainder,
    sensors_of,
    wanted,
)

MODULES = Path("/usr/lib/linuxcnc/modules")
LIMIT = 900  # s, of one run
SAME = 1e-6  # m
PERIOD = 3e-3  # m, the most that F180000 moves in a servo period

INI = """[EMC]
VERSION = 1.1
[DISPLAY]
DISPLAY = {folder}/drive.py
[RS274NGC]
PARAMETER_FILE = sim.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 60.0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[HAL]
HALFILE = sim.hal
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = sim.tbl
"""
HAL = """loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
loadrt minmax count=6
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net estop iocontrol.0.user-enable-out iocontrol.0.emc-enable-in
net prepared iocontrol.0.tool-prepare iocontrol.0.tool-prepared
net changed iocontrol.0.tool-change iocontrol.0.tool-changed
"""
# What an operator's panel does: switch on, home, send one line after the other, read where all stands.
BEGIN = """#!/usr/bin/python3
import json, subprocess, time, traceback
import linuxcnc

command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
found = {"rows": [], "path": [], "messages": []}


def read():
    status.poll()
    return [list(status.actual_position[:6]), list(status.joint_actual_position[:6])]


def pins(names):
    return [float(subprocess.run(["halcmd", "getp", n], capture_output=True, text=True).stdout) for n in names]


def send(line):
    command.mdi(line)
    while (done := command.wait_complete(0.004)) == -1:
        found["path"].append(read())
    return done


# What `found` returns once it is the same twice, at most a minute later: a line is done before its joints stand.
def until_same(found, same):
    until, now = time.monotonic() + 60, found()
    while time.monotonic() < until:
        time.sleep(0.01)
        before, now = now, found()
        if same(before, now):
            break
    return now


def near(a, b, tolerance):
    return max(abs(x - y) for x, y in zip(a, b)) < tolerance


try:
    command.state(linuxcnc.STATE_ESTOP_RESET)
    command.wait_complete()
    command.state(linuxcnc.STATE_ON)
    command.wait_complete()
    command.home(-1)
    until = time.monotonic() + 20
    while not all(status.homed[:6]) and time.monotonic() < until:
        time.sleep(0.05)
        status.poll()
    command.mode(linuxcnc.MODE_MDI)
    command.wait_complete()
    while errors.poll():
        pass
"""
LINES = """    lines, goals, play, bad = json.load(open("lines.json"))
    motors = [f"joint.{i}.motor-pos-cmd" for i in range(6)]
    for line, goal in zip(lines, goals):
        assert send(line) == 1, line
        row = until_same(read, lambda a, b: a == b and near(b[0], goal, 1e-6))
        if play:
            row.append(until_same(lambda: pins(motors), lambda a, b: near(a, b, 1e-4)))
        found["rows"].append(row)
    found["bad"] = send(bad)
    found["after"] = read()
    time.sleep(0.2)
    while message := errors.poll():
        found["messages"].append(message[1])
    found["pins"] = pins(["rigkins." + n for n in ("refused", "refused-strut", "refusals", "forward-status")])
"""
END = """except BaseException:
    found["fault"] = traceback.format_exc()
json.dump(found, open("found.json", "w"))
"""
# Near a singularity: a line, an axis that is jogged in world mode, joints that are jogged, a line from there, and back.
SINGULAR = """    near, bad, lengths = json.load(open("lines.json"))
    names = ["rigkins." + n for n in ("inverse-status", "forward-status", "refused", "refusals")]


    def note(key, rows=()):
        time.sleep(0.1)
        status.poll()
        texts = []
        while message := errors.poll():
            texts.append(message[1])
        found[key] = {"at": read(), "pins": pins(names), "enabled": bool(status.enabled), "messages": texts}
        found[key]["rows"] = list(rows)


    def watch(seconds):
        until, rows = time.monotonic() + seconds, []
        while time.monotonic() < until:
            rows.append(read())
            time.sleep(0.004)
        return rows


    assert send(near) == 1
    note("near")
    found["line"] = send(bad)
    note("refused")
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.teleop_enable(1)
    command.wait_complete()
    command.jog(linuxcnc.JOG_CONTINUOUS, False, 5, 10)
    rows = watch(2)
    command.jog(linuxcnc.JOG_STOP, False, 5)
    note("jogged", rows)
    command.state(linuxcnc.STATE_ON)
    command.wait_complete()
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.teleop_enable(0)
    command.wait_complete()
    for i, goal in enumerate(lengths):
        command.jog(linuxcnc.JOG_INCREMENT, True, i, 50, goal - read()[1][i])
    note("joints", watch(2))
    for value in ("1", "0"):  # from here on the least and greatest command of every period count
        for i in range(6):
            subprocess.run(["halcmd", "setp", f"minmax.{i}.reset", value])
        time.sleep(0.05)
    command.mode(linuxcnc.MODE_MDI)
    command.wait_complete()
    found["from there"] = send(near)
    watch(1)
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.teleop_enable(1)
    command.wait_complete()
    command.jog(linuxcnc.JOG_CONTINUOUS, False, 5, -10)
    watch(1)
    command.jog(linuxcnc.JOG_STOP, False, 5)
    note("held")
    found["span"] = [pins([f"minmax.{i}.{end}" for end in ("min", "max")]) for i in range(6)]
    command.state(linuxcnc.STATE_ON)
    command.wait_complete()
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.teleop_enable(0)
    command.wait_complete()
    for i, goal in enumerate(found["near"]["at"][1]):
        command.jog(linuxcnc.JOG_INCREMENT, True, i, 50, goal - read()[1][i])
    note("back", watch(2))
    command.mode(linuxcnc.MODE_MDI)
    command.wait_complete()
    found["again"] = send(near)
    note("again at")
"""
# The modules' folder with rigkins in it, seen by this run alone; then as no superuser, which LinuxCNC refuses.
START = """set -e
mount --bind {modules} {folder}/installed
mount --bind {folder}/modules {modules}
cd {folder}
exec unshare --user --map-user=1000 --map-group=1000 env HOME={folder} RTAPI_FIFO_PATH={folder}/fifo linuxcnc -r sim.ini
"""
PRIVATE = ["unshare", "-r", "-m", "-i", "-p", "--fork", "--kill-child", "--mount-proc"]


def why_not():
    """Why LinuxCNC cannot be run here, or None."""
    missing = [name for name in ("linuxcnc", "halcompile", "unshare", "cc") if shutil.which(name) is None]
    if missing or not MODULES.is_dir():
        return f"no LinuxCNC to run here: {', '.join(missing) or MODULES} is missing"
    if subprocess.run([*PRIVATE, "true"], capture_output=True).returncode:
        return "no private folder of modules: unshare with namespaces of its own is not allowed here"
    return None


def settings(text):
    """The ini's lines that the module's head comment states, with simulated joints and axes completed."""
    stated = re.findall(r"^ \* (\[[A-Z_0-9]+\]|[A-Z_]+ = .*)$", text.split("*/")[0], flags=re.MULTILINE)
    more = {
        "[JOINT": ["TYPE = LINEAR", "MAX_VELOCITY = 9000", "MAX_ACCELERATION = 100", "HOME_SEQUENCE = 0"]
        + ["FERROR = 10", "MIN_FERROR = 10"],
        "[TRAJ]": ["NO_FORCE_HOMING = 1", "MAX_LINEAR_VELOCITY = 3000", "DEFAULT_LINEAR_VELOCITY = 3000"]
        + ["MAX_ANGULAR_VELOCITY = 3000", "DEFAULT_ANGULAR_VELOCITY = 3000"]
        + ["MAX_LINEAR_ACCELERATION = 50000", "DEFAULT_LINEAR_ACCELERATION = 50000"],
    }
    lines = []
    for line in stated:
        key, _, value = line.partition(" = ")
        lines += [line, *more.get(line[:6], [])]
        if key == "HOME" and " " not in value:
            lines.append(f"HOME_OFFSET = {value}")
    for axis in "XYZABC":
        lines += [f"[AXIS_{axis}]", "MIN_LIMIT = -1000", "MAX_LIMIT = 1000", "MAX_VELOCITY = 3000"]
        lines.append("MAX_ACCELERATION = 50000")
    return "\n".join(lines)


def run_linuxcnc(calibration, folder, steps, data):
    """What a run found that drives by BEGIN, steps and END, with data for these."""
    text = linuxcnc_kinematics_source(calibration.correction, calibration.physics, "rig 1.2.3").text
    (folder / "rigkins.c").write_text(text)
    built = subprocess.run(["halcompile", "--compile", "rigkins.c"], cwd=folder, capture_output=True, text=True)
    assert built.returncode == 0 and (folder / "rigkins.so").exists(), built.stdout + built.stderr
    assert "warning" not in built.stderr, built.stderr
    for name in ("modules", "installed"):
        (folder / name).mkdir()
    for module in MODULES.glob("*.so"):
        (folder / "modules" / module.name).symlink_to(folder / "installed" / module.name)
    shutil.copy(folder / "rigkins.so", folder / "modules")
    channels = re.findall(r"^ \*   rigkins\.(\w+)", text, flags=re.MULTILINE)
    loop = [f"net j{i} joint.{i}.motor-pos-cmd => joint.{i}.motor-pos-fb minmax.{i}.in" for i in range(6)]
    loop += [f"addf minmax.{i} servo-thread" for i in range(6)]
    warm = [f"setp rigkins.{name} {WARM[name]!r}" for name in channels]
    for name, written in {
        "sim.ini": INI.format(folder=folder) + settings(text),
        "sim.hal": HAL + "\n".join([*loop, *warm, ""]),
        "sim.tbl": "",
        "sim.var": "",
        "drive.py": BEGIN + steps + END,
        "start.sh": START.format(folder=folder, modules=MODULES),
        "lines.json": json.dumps(data),
    }.items():
        (folder / name).write_text(written)
    (folder / "drive.py").chmod(0o755)
    done = subprocess.run(
        [*PRIVATE, "bash", "start.sh"], cwd=folder, capture_output=True, text=True, timeout=LIMIT, errors="replace"
    )
    assert (folder / "found.json").exists(), done.stdout + done.stderr
    found = json.loads((folder / "found.json").read_text())
    assert "fault" not in found, found["fault"] + done.stdout + done.stderr
    return found


def line(pose):
    """The G-code line of a pose (6,), mm and degrees."""
    return "G21 G90 G1 F180000 " + " ".join(f"{a}{v:.6f}" for a, v in zip("XYZABC", pose))


def run_lines(calibration, T, folder, play=False):
    """(poses (n, 6) mm and degrees as written, what the run found) of poses (n,), one line each."""
    given = np.round(np.c_[T.translation * 1e3, T.rotation.as_euler("xyz", degrees=True)], 6)
    data = [[line(row) for row in given], given.tolist(), play, "G1 Z900"]
    return given, run_linuxcnc(calibration, folder, LINES, data)


def commanded(calibration, poses):
    """(n, 6) m that `rig correct` commands for poses (n, 6) as LinuxCNC holds them, mm and degrees."""
    turned = Rotation.from_euler("xyz", poses[:, 3:], degrees=True)
    T = RigidTransform.from_components(poses[:, :3] / 1e3, turned)
    return correct(calibration, T, CorrectOptions(sensors_of(calibration), approach="never")).values


@pytest.mark.slow
def test_a_thousand_segments_end_and_run_where_rig_correct_commands(design, tmp_path, capsys):
    reason = why_not()
    if reason:
        pytest.skip(reason)
    calibration = calibration_of(remainder(design), effects(design, *THERMAL))
    given, found = run_lines(calibration, wanted(design, 1000, fill=0.6), tmp_path)
    ends, path = np.array(found["rows"]), np.array(found["path"])
    worst = np.abs(ends[:, 1] / 1e3 - commanded(calibration, given)).max()
    off = np.abs(path[:, 1] / 1e3 - commanded(calibration, path[:, 0])).max(axis=1)
    torn = off >= SAME  # LinuxCNC's status is copied while it is written: a pose with the joints of the period before
    with capsys.disabled():
        print(f"\nLinuxCNC: {len(ends)} segments, {worst:.2g} m at their ends; {off[~torn].max():.2g} m at {len(path)}")
        print(f"on the way, of which {torn.sum()} pair a pose with joints of another period, {off.max():.2g} m off")
    assert worst < SAME and len(path) > 2000 and np.mean(torn) < 1e-3 and off.max() < PERIOD
    assert np.abs(ends[:, 0] - given).max() < 1e-6  # mm, degrees: by its forward kinematics it stands where it was sent
    nominal = hexapod.inverse(wanted(design, 1000, fill=0.6), design.mechanism)
    assert np.abs(ends[:, 1] / 1e3 - nominal).max() > 1e-4  # without the correction it is elsewhere
    assert found["pins"][0] == 2 and found["pins"][2] >= 1 and 1 <= found["pins"][1] <= 6 and found["pins"][3] == 0
    assert any("a strut leaves its range" in text for text in found["messages"])
    assert any("fails kinematicsInverse" in text for text in found["messages"]) and np.allclose(
        found["after"], ends[-1], 0, 1e-8
    )


@pytest.mark.slow
def test_with_backlash_in_its_ini_linuxcnc_takes_up_the_play(design, tmp_path, capsys):
    """Motors are commanded what `rig correct` does, where a strut came without turning back on the way."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    calibration = CALIBRATIONS["all"](design)
    given, found = run_lines(calibration, wanted(design, 100, fill=0.6), tmp_path, play=True)
    joints, motors = (np.array([row[i] for row in found["rows"]]) / 1e3 for i in (1, 2))
    motors += hexapod.home_values(design.mechanism)  # they count from where they stood when they were homed
    halves = np.array([4e-5, 0, 0, 1.5e-5, 0, 0])
    assert np.abs(np.abs(motors - joints) - halves).max() < 1e-7  # half of the acceleration times a period squared
    off = np.abs(motors - commanded(calibration, given)).max(axis=1)
    with capsys.disabled():
        print(f"\nLinuxCNC with play: {np.mean(off < SAME):.0%} of {len(off)} ends within {SAME:g} m of rig correct")
    assert np.mean(off < SAME) > 0.8


@pytest.mark.slow
def test_near_a_singularity_lines_jogs_and_joints_are_refused_and_nothing_leaps(design, tmp_path, capsys):
    reason = why_not()
    if reason:
        pytest.skip(reason)
    free = fitted(design)
    free = replace(free, nominal=replace(free.nominal, strut_range=np.tile([0.01, 9.0], (6, 1))))
    home = free.nominal.home.translation * 1e3
    near, bad = np.r_[home, 0, 0, 80], np.r_[home, 0, 0, 88]
    T = RigidTransform.from_components(bad[:3] / 1e3, Rotation.from_euler("z", 88, degrees=True))
    lengths = (1e3 * hexapod.inverse(T, free.fitted)).tolist()
    found = run_linuxcnc(calibration_of(free), tmp_path, SINGULAR, [line(near), line(bad), lengths])
    refused, jogged, joints, held = (found[key] for key in ("refused", "jogged", "joints", "held"))
    assert found["line"] != 1 and refused["pins"][2:] == [6, 1] and np.allclose(refused["at"], found["near"]["at"])
    assert any("too near a singularity" in text for text in refused["messages"])
    assert any("fails kinematicsInverse" in text for text in refused["messages"])
    # An axis that is jogged in world mode: LinuxCNC disables motion where little of the Jacobian is left.
    assert not jogged["enabled"] and "kinematicsInverse failed" in jogged["messages"]
    turned = np.array([row[0][5] for row in jogged["rows"]])
    assert turned.min() >= 80 and 84 < turned.max() < 85 and jogged["at"][0][5] == turned[-1]
    # Joints that are jogged there: the operator is told that they have no pose, and from there nothing moves or leaps.
    assert joints["pins"][1] == 6 and np.allclose(joints["at"][1], lengths, 0, 1e-6)
    assert any("no pose of the joints: too near a singularity" in text for text in joints["messages"])
    assert found["from there"] != 1 and np.allclose(held["at"][1], lengths, 0, 1e-6)
    assert any("the joints have none; jog them back in joint mode" in text for text in held["messages"])
    span = np.ptp(found["span"], axis=1).max()
    assert span < 1e-3, "mm, between commands of any two servo periods; pins are printed with seven digits"
    assert found["back"]["pins"][1] == 0 and found["again"] == 1 and found["again at"]["pins"][0] == 0
    assert np.allclose(found["again at"]["at"], found["near"]["at"], 0, 1e-6)
    with capsys.disabled():
        print(f"\nNear a singularity: stopped at {turned[-1]:.2f} of 88 degrees, {span:.1g} mm moved without a pose")
