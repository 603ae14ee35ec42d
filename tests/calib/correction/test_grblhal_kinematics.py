"""grblHAL's kinematics plug-in: compiled, motors go where `rig correct` commands along every line; it refuses."""

import ctypes
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calib.api.correct import CorrectOptions, correct
from calib.api.export_calibration_or_recording import ExportOptions, export
from calib.correction.hexapod_kinematics_c_source_for_linuxcnc_and_grblhal import grblhal_kinematics_source
from calib.files import calibration_file
from rig.cli.command_line import main
from rig.errors import RigError
from rig.model.mechanisms import hexapod
from tests.calib.controllers_in_c import (
    BAD_POSE,
    CALIBRATIONS,
    NOT_CONVERGED,
    OUT_OF_STROKE,
    SENSOR_MISSING,
    WARM,
    calibration_of,
    compiled_library,
    effects,
    fitted,
    needs_compiler,
    pointer,
    sensors_of,
    wanted,
)
from tests.calib.grblhal_interface import CORE, HEADERS

SINGULAR = 6
STEPS_PER_MM = 1e4
STEP = 1e-3 / STEPS_PER_MM  # m
SAME = 2e-8  # m: grblHAL holds poses and motors in single precision, 15 nm of a height of half a metre
STRAIGHT = 2e-7  # m, from a line where motors run at constant ratios for half a millimetre or a tenth of a degree
RAPID, INVERSE_TIME, JOG, CANCELLED, BROKEN_OFF = 1, 2, 4, 8, 16
MOST = 4000
WITH_PLAY = ("backlash", "all")
WITHOUT_PLAY = [name for name in CALIBRATIONS if name not in WITH_PLAY]


def source_of(calibration, zero=None):
    return grblhal_kinematics_source(calibration.correction, calibration.physics, "rig 1.2.3", "rig 1.2.3 test", zero)


class PlugIn:
    """The plug-in of a calibration, compiled against least headers and started at home. zero : (6,) m"""

    def __init__(self, calibration, folder, zero=None):
        self.zero = hexapod.home_values(calibration.correction.nominal) if zero is None else zero
        self.text = source_of(calibration, zero).text
        (folder / "grbl" / "kinematics").mkdir(parents=True)
        for name, text in (HEADERS | {"rigkins.c": self.text, "core.c": CORE}).items():
            (folder / name).write_text(text)
        self.library = compiled_library(
            folder, "rigkins", "rigkins.c", "core.c", include=("-I.", "-std=gnu11", "-Wno-unused-function")
        )
        self.library.start(ctypes.c_float(STEPS_PER_MM))

    def array(self, name, kind, count):
        """(count,) of the core's or the plug-in's memory."""
        return np.ctypeslib.as_array((kind * count).in_dll(self.library, name))

    @property
    def steps(self):
        return self.array("sys", ctypes.c_int32, 6)

    @property
    def lengths(self):
        """(6,) m, where the motors stand."""
        return self.zero + self.steps * STEP

    def written(self):
        """What was written since the last call."""
        text = (ctypes.c_char * 4096).in_dll(self.library, "written")
        found, text.value = text.value.decode(), b""
        return found

    def line(self, goal, feed=600.0, kind=0):
        """(ends (n, 6) m of struts, feeds (n,), multipliers (n,)) of a line's segments; None where it is refused."""
        motors, feeds, multipliers = (np.zeros(shape, np.float32) for shape in ((MOST, 6), MOST, MOST))
        count = self.library.line(
            pointer(goal), ctypes.c_float(feed), kind, pointer(motors), pointer(feeds), pointer(multipliers), MOST
        )
        assert count >= -1
        return None if count < 0 else (self.zero + motors[:count] * 1e-3, feeds[:count], multipliers[:count])

    def where(self):
        """(6,) mm and degrees, as grblHAL reports it."""
        found = np.zeros(6, np.float32)
        self.library.where(pointer(found))
        return found

    def command(self, text):
        return self.library.command(None if text is None else ctypes.create_string_buffer(text.encode()))


def pose_words(T):
    """(6,) of a pose, mm and degrees in single precision."""
    return np.r_[T.translation * 1e3, T.rotation.as_euler("xyz", degrees=True)].astype(np.float32)


def poses_of(words):
    """Poses (n,) of words (n, 6)."""
    words = np.asarray(words, float)
    turned = Rotation.from_euler("xyz", words[:, 3:], degrees=True)
    return RigidTransform.from_components(words[:, :3] / 1e3, turned)


def commanded(calibration, words):
    """(n, 6) m that `rig correct` commands for poses (n, 6), mm and degrees."""
    return correct(calibration, poses_of(words), CorrectOptions(sensors_of(calibration))).values


@pytest.fixture(scope="module")
def compiled(design, tmp_path_factory):
    """name -> (Calibration, PlugIn), each compiled once."""

    @cache
    def make(name):
        calibration = CALIBRATIONS[name](design)
        plug_in = PlugIn(calibration, tmp_path_factory.mktemp("grblhal"))
        for channel in re.findall(r"channels\[\d+\] (\w+)", plug_in.text):
            assert plug_in.command(f"{channel}:{WARM[channel]}") == 0
        return calibration, plug_in

    return make


@needs_compiler
@pytest.mark.parametrize("name", WITHOUT_PLAY)
def test_motors_go_where_rig_correct_commands_along_every_line(design, compiled, name):
    """At the ends of segments and, as motors run at constant ratios there, in the middle of each."""
    calibration, plug_in = compiled(name)
    start = plug_in.where().astype(float)
    for T in wanted(design, 4, fill=0.5):
        goal = pose_words(T)
        ends, _, _ = plug_in.line(goal)
        shares = np.arange(1, len(ends) + 1)[:, None] / len(ends)
        assert len(ends) > 10
        done = commanded(calibration, start + shares * (goal - start))
        middle = commanded(calibration, start + (shares[1:] - 0.5 / len(ends)) * (goal - start))
        assert np.abs(ends - done).max() < SAME + STEP
        assert np.abs((ends[1:] + ends[:-1]) / 2 - middle).max() < STRAIGHT
        assert np.abs(plug_in.lengths - commanded(calibration, goal[None])[0]).max() < SAME + STEP
        start = plug_in.where().astype(float)
        assert np.abs(start - goal).max() < 2e-4  # mm, degrees: a few steps, through the Jacobian
        assert np.abs(done - hexapod.inverse(poses_of(start + shares * (goal - start)), design.mechanism)).max() > 1e-5


@needs_compiler
def test_the_feed_is_millimetres_or_degrees_of_the_pose_whichever_take_longer(design, compiled):
    _, plug_in = compiled("plain")
    home = pose_words(hexapod.forward(hexapod.home_values(design.mechanism), design.mechanism))
    for shift, longest in (([3, 4, 0, 0, 0, 0], 5.0), ([0, 0, 0, 1, -4, 2], 4.0), ([3, 4, 0, 0, 0, 6], 6.0)):
        plug_in.line(home)
        before = plug_in.lengths
        ends, feeds, multipliers = plug_in.line(home + np.array(shift, np.float32), 600.0)
        distance = np.linalg.norm(np.diff(np.r_[before[None], ends], axis=0), axis=1) * 1e3  # mm, of the motors
        assert np.isclose((distance / feeds).sum(), longest / 600.0, rtol=1e-3)  # min
        assert np.allclose(feeds * multipliers, 600.0, rtol=1e-5)
        plug_in.line(home)
        ends, feeds, _ = plug_in.line(home + np.array(shift, np.float32), 12.0, INVERSE_TIME)
        assert np.isclose((1 / feeds).sum(), 1 / 12.0)
        plug_in.line(home)
        assert (plug_in.line(home + np.array(shift, np.float32), 0.0, RAPID)[1] == 0.0).all()


@needs_compiler
@pytest.mark.parametrize("kind", [0, JOG])
def test_a_line_is_refused_as_a_whole_with_its_reason_and_moves_nothing(design, tmp_path, kind):
    """Also one of ten million turns, and one that a jog has declared to be valid."""
    plug_in = PlugIn(CALIBRATIONS["thermal"](design), tmp_path)
    home = plug_in.where()
    bad = home.copy()
    bad[3] = np.nan
    for goal, status, text in (
        (home + np.array([0, 0, 300, 0, 0, 0], np.float32), OUT_OF_STROKE, "a strut leaves its range (strut 1)]"),
        (bad, BAD_POSE, "a number is not finite]"),
        (home + np.array([0, 0, 0, 0, 0, 3.6e9], np.float32), OUT_OF_STROKE, "a strut leaves its range"),
    ):
        plug_in.written()
        before = plug_in.steps.copy()
        assert plug_in.line(goal, kind=kind) is None and (plug_in.steps == before).all()
        assert plug_in.command(None) == 0
        written = plug_in.written()
        assert f"refused={status}," in written and written.startswith("[MSG:Warning: pose refused: ")
        assert text in written
    assert "refusals=3," in written
    assert plug_in.line(home) is not None


@needs_compiler
def test_a_sensor_that_is_not_finite_refuses_every_line(design, tmp_path):
    plug_in = PlugIn(CALIBRATIONS["thermal"](design), tmp_path)
    home = plug_in.where()
    values = plug_in.array("rig_channel_values", ctypes.c_double, 7)
    values[0] = np.nan
    assert plug_in.line(home) is None and "a sensor is not finite" in plug_in.written()
    assert np.isnan(plug_in.where()).all()
    plug_in.library.report()
    assert f"|RIG:{SENSOR_MISSING}" in plug_in.written()
    values[0] = 22.0
    assert plug_in.line(home) is not None and np.isfinite(plug_in.where()).all()
    assert plug_in.command("no_such:1") == 3 and plug_in.command("ambient_temperature_C") == 3
    assert plug_in.command("ambient_temperature_C:warm") == 2 and plug_in.command("ambient_temperature_C:2 ") == 2
    assert plug_in.command("ambient_temperature_C:30.5") == 0 and values[6] == 30.5


@needs_compiler
def test_where_parking_is_enabled_nothing_moves(design, compiled):
    """grblHAL parks by sending a pose to the motors."""
    _, plug_in = compiled("plain")
    home = pose_words(hexapod.forward(hexapod.home_values(design.mechanism), design.mechanism))
    plug_in.library.park(1)
    plug_in.written()
    assert plug_in.line(home) is None and "set $41=0" in plug_in.written()
    plug_in.library.park(0)
    assert plug_in.line(home) is not None


@needs_compiler
def test_between_two_reachable_poses_a_way_beyond_a_range_is_refused(design, tmp_path):
    """Across strut 1, which is shortest in the middle of that way, and there too short."""
    free = fitted(design)
    home = hexapod.forward(hexapod.home_values(design.mechanism), design.mechanism)
    strut = home.apply(free.fitted.platform_joints[0]) - free.fitted.base_joints[0]
    across = np.cross(strut, [0, 0, 1]) / np.linalg.norm(np.cross(strut, [0, 0, 1]))
    ways = pose_words(home) + np.outer([-20, 0, 20], np.r_[across, 0, 0, 0])
    lengths = commanded(calibration_of(free), ways)
    narrow = design.mechanism.strut_range.copy()
    narrow[0, 0] = lengths[1, 0] + 2e-4
    assert (lengths[[0, 2], 0] > narrow[0, 0]).all()
    plug_in = PlugIn(calibration_of(replace(free, nominal=replace(free.nominal, strut_range=narrow))), tmp_path)
    plug_in.steps[:] = np.round((lengths[0] - plug_in.zero) / STEP)
    before, ways = plug_in.steps.copy(), ways.astype(np.float32)
    assert plug_in.line(ways[2]) is None and (plug_in.steps == before).all()
    assert plug_in.line(ways[0]) is not None
    assert [plug_in.library.jog_allowed(pointer(one)) for one in ways] == [1, 0, 1]
    ctypes.c_int.in_dll(plug_in.library, "state").value = 2  # a check: each line begins where the one before ended
    over = ways[1] + np.array([0, 0, 6, 0, 0, 0], np.float32)
    assert [plug_in.line(one) is not None for one in (over, ways[2], ways[0])] == [True, True, False]


@needs_compiler
def test_near_a_singularity_a_line_is_refused(design, tmp_path):
    """Struts without ends: the platform turns about its normal, and stops where little of the Jacobian is left."""
    free = fitted(design)
    free = replace(free, nominal=replace(free.nominal, strut_range=np.tile([0.01, 9.0], (6, 1))))
    plug_in = PlugIn(calibration_of(free), tmp_path)
    home = plug_in.where().astype(float)
    turns = home + np.outer(np.arange(0, 172, 2.0), [0, 0, 0, 0, 0, 1])
    T = poses_of(turns)
    scale = np.r_[1, 1, 1, np.full(3, np.linalg.norm(free.fitted.platform_joints, axis=1).mean())]
    values = np.linalg.svd(hexapod.jacobian(T, free.fitted) / scale, compute_uv=False)[:, -1]
    signs = np.sign(np.linalg.det(hexapod.jacobian(T, free.fitted)))
    regular = np.logical_and.accumulate((values > 0.1 * values[0]) & (signs == signs[0]))
    assert 10 < regular.sum() < 80
    done = []
    for turn in turns:
        plug_in.line(home.astype(np.float32))
        done.append(plug_in.line(turn.astype(np.float32)) is not None)
    assert np.array_equal(done, regular)
    plug_in.written()
    plug_in.command(None)
    assert f"refused={SINGULAR}," in plug_in.written()


@needs_compiler
def test_while_homing_axes_are_motors_and_afterwards_poses(design, compiled):
    calibration, plug_in = compiled("simplices")
    low = commanded(calibration, pose_words(wanted(design, 1)[0])[None])[0]
    plug_in.array("switches", ctypes.c_float, 6)[:] = (low - plug_in.zero) * 1e3 - 1.0
    found = np.zeros(6, np.float32)
    assert plug_in.library.home(pointer(found)) == 1
    assert np.abs(plug_in.lengths - low).max() < STEP + SAME
    assert np.abs(found - pose_words(wanted(design, 1)[0])).max() < 1e-3
    home = pose_words(hexapod.forward(hexapod.home_values(design.mechanism), design.mechanism))
    assert plug_in.line(home) is not None


@needs_compiler
def test_motors_without_a_pose_are_reported_as_such_and_nothing_starts_there(design, compiled):
    _, plug_in = compiled("plain")
    home = pose_words(hexapod.forward(hexapod.home_values(design.mechanism), design.mechanism))
    stood = plug_in.steps.copy()
    plug_in.steps[:] = [-4_000_000, 4_000_000] * 3
    assert np.isnan(plug_in.where()).all() and plug_in.line(home) is None
    plug_in.library.report()
    assert f"|KPos:-400.0000,400.0000,-400.0000,400.0000,-400.0000,400.0000|RIG:{NOT_CONVERGED}" in plug_in.written()
    plug_in.steps[:] = stood
    assert plug_in.line(home) is not None and "|RIG:" not in (plug_in.library.report(), plug_in.written())[1]


@needs_compiler
def test_a_cancelled_jog_ends_at_a_segment_and_check_mode_moves_nothing(design, compiled):
    _, plug_in = compiled("plain")
    home = pose_words(hexapod.forward(hexapod.home_values(design.mechanism), design.mechanism))
    plug_in.line(home)
    assert len(plug_in.line(home + np.array([9, 0, 0, 0, 0, 0], np.float32), kind=JOG | CANCELLED)[0]) == 2
    plug_in.line(home)
    state = ctypes.c_int.in_dll(plug_in.library, "state")
    state.value = 2
    assert plug_in.line(home + np.array([0, 0, 5, 0, 0, 0], np.float32)) is not None
    assert np.abs(plug_in.where() - home).max() < 1e-3  # nothing has moved
    state.value = 0
    ends, _, _ = plug_in.line(home + np.array([0, 0, 1, 0, 0, 0], np.float32))
    assert len(ends) in (2, 3)


@needs_compiler
def test_motors_count_from_the_lengths_that_are_stated(design, tmp_path):
    calibration, zero = CALIBRATIONS["plain"](design), np.linspace(0.44, 0.46, 6)
    plug_in = PlugIn(calibration, tmp_path, zero)
    plug_in.steps[:] = np.round((hexapod.home_values(design.mechanism) - zero) / STEP)
    goal = pose_words(wanted(design, 1, fill=0.5)[0])
    assert plug_in.line(goal) is not None
    assert np.abs(plug_in.lengths - commanded(calibration, goal[None])[0]).max() < SAME + STEP
    assert "Motor C: -33.648182 to 65.351818, 0 where strut 6 is 0.460000000 m long" in plug_in.text


@needs_compiler
@pytest.mark.parametrize("name", WITH_PLAY)
def test_plays_are_taken_up_as_rig_correct_does_segment_by_segment(design, tmp_path, name):
    calibration = CALIBRATIONS[name](design)
    plug_in = PlugIn(calibration, tmp_path)
    for channel in re.findall(r"channels\[\d+\] (\w+)", plug_in.text):
        assert plug_in.command(f"{channel}:{WARM[channel]}") == 0
    start = plug_in.where().astype(float)
    words, ends = [], []
    for T in wanted(design, 12, fill=0.5):
        goal = pose_words(T)
        ends.append(plug_in.line(goal)[0])
        shares = np.arange(1, len(ends[-1]) + 1)[:, None] / len(ends[-1])
        words.append(start + shares * (goal - start))
        start = goal.astype(float)
        assert np.abs(plug_in.where() - goal).max() < 2e-4
    done = commanded(calibration, np.concatenate(words))
    assert np.abs(np.concatenate(ends) - done).max() < SAME + STEP
    turns = (np.diff(np.sign(np.diff(done, axis=0)), axis=0) != 0).sum(axis=0)
    assert (turns > 3).all()


def struts_driven(motors, struts, gaps):
    """(6,) m where struts stand after their motors ran through (n, 6) m, each with its play. struts : (6,) m before"""
    for row in motors:
        struts = np.clip(struts, row - gaps / 2, row + gaps / 2)
    return struts


@needs_compiler
def test_struts_with_play_stand_where_they_should_after_a_stop_and_after_homing(design, tmp_path):
    """Struts that follow their motors by the law of play alone, and lengths of a calibration that knows of none."""
    calibration = CALIBRATIONS["backlash"](design)
    plug_in, without = PlugIn(calibration, tmp_path), replace(calibration, physics=None)
    gaps = np.array([8e-5, 0, 0, 3e-5, 0, 0])
    motors = struts = plug_in.lengths
    goals = [pose_words(T) for T in wanted(design, 40, seed=3, fill=0.4)]
    for k, goal in enumerate(goals):
        if k == 20:  # homed: motors ran down by a millimetre and up again
            plug_in.array("switches", ctypes.c_float, 6)[:] = (motors - plug_in.zero) * 1e3 - 1
            assert plug_in.library.home(pointer(np.zeros(6, np.float32))) == 1
            struts = struts_driven([motors - 1e-3, motors], struts, gaps)
            assert np.allclose(struts, motors - gaps / 2)
        broken = k % 3 == 1
        ends, _, _ = plug_in.line(goal, kind=BROKEN_OFF if broken else 0)
        ends = ends[:3] if broken else ends
        struts, motors = struts_driven(np.r_[ends, plug_in.lengths[None]], struts, gaps), plug_in.lengths
        assert np.abs(commanded(without, [plug_in.where()])[0] - struts).max() < SAME + 2 * STEP
        if not broken:
            assert np.abs(commanded(without, goal[None])[0] - struts).max() < SAME + 2 * STEP
    assert np.abs(motors - struts).max() > 3e-5


def test_a_play_with_a_cyclic_error_is_refused_and_so_is_a_zero_that_is_no_length(design):
    both = effects(design, "backlash:strut1:gap=8e-5", "cyclic_error:strut1:amplitude=1e-5")
    with pytest.raises(RigError, match="play together with a cyclic error"):
        source_of(calibration_of(fitted(design), both))
    for zero in (np.full(6, np.nan), np.zeros(5)):
        with pytest.raises(RigError, match="--zero is one length or six"):
            source_of(CALIBRATIONS["plain"](design), zero)


def test_the_command_writes_the_plug_in(design, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calibration_file.save("calibration.json", CALIBRATIONS["thermal"](design))
    given = ["export", "calibration.json", "--format", "grblhal-kins"]
    assert main([*given, "--zero", "0.4758", "--out", "rigkins.c"]) == 0
    text = (tmp_path / "rigkins.c").read_text()
    assert text == export(tmp_path / "calibration.json", "grblhal-kins", ExportOptions(zero=(0.4758,))).text
    assert text.count("0.475800000 m long") == 6
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|goto|do)\b", code)
    assert main(given) != 0
    assert "grblhal-kins takes a calibration.json and --out" in capsys.readouterr().err
    assert main([*given, "--zero", "0.4", "0.5", "--out", "other.c"]) != 0
    assert "--zero is one length or six" in capsys.readouterr().err
