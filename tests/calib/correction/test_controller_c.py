"""The controller's C file: compiled, it commands what `rig correct` does, refuses what it must, allocates nothing."""

import ctypes
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.api.correct import CorrectOptions, correct
from calib.api.export_calibration_or_recording import export
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    correction_with_pose_space_map,
    fit_field,
    home_pose,
)
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import FieldSamples
from calib.correction.machine_correction import Correction
from calib.correction.physical_effects_of_calibration_and_their_compensation import Machine
from calib.correction.timed_command_sequence_and_pose_space_correction_map import untimed_route
from calib.files import calibration_file
from calib.models.wanted_pose_commands import commands_along_route
from rig.cli.command_line import main
from rig.effects.framework.effect_base_class import Effect
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.model.mechanism_geometry_classes import Chain
from rig.model.mechanisms import hexapod
from rig.model.pose import pose, pose_difference
from tests.calib.controllers_in_c import (
    BAD_POSE,
    CALIBRATIONS,
    LONGEST,
    NO_STATE,
    NOT_CONVERGED,
    OK,
    OUT_OF_STROKE,
    SENSOR_MISSING,
    WARM,
    Controller,
    c_text,
    calibration_of,
    effects,
    field_samples,
    fitted,
    needs_compiler,
    pointer,
    pose_map,
    sensors_of,
    wanted,
)
from tests.calib.correction.test_physics import MOVING, SOME, known_to_be
from tests.rig.arms import STANFORD

SAME = 1e-9  # m
FEW, MANY, AT_ONCE, TIMED = 2000, 1_000_000, 25_000, 50_000  # poses
COMPARED = ("plain", "simplices", "backlash", "thermal")


@pytest.fixture(scope="module")
def compiled(design, tmp_path_factory):
    """name -> (Calibration, Controller), each compiled once."""

    @cache
    def make(name):
        calibration = CALIBRATIONS[name](design)
        return calibration, Controller(calibration, tmp_path_factory.mktemp("c"))

    return make


@needs_compiler
@pytest.mark.parametrize("name", CALIBRATIONS)
def test_the_controller_commands_what_rig_correct_does(design, compiled, name):
    calibration, controller = compiled(name)
    T, sensors = wanted(design, FEW), sensors_of(calibration)
    controller.start()
    lengths, status = controller(T, WARM)
    done = correct(calibration, T, CorrectOptions(sensors))
    assert (status == OK).all() and np.abs(lengths - done.values).max() < SAME
    plain = hexapod.inverse(T, design.mechanism)
    assert np.abs(lengths - plain).max() > 1e-5


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name, count", [*((name, MANY) for name in COMPARED), ("radial", AT_ONCE), ("all", AT_ONCE)])
def test_very_many_poses_are_commanded_alike(design, compiled, name, count, capsys):
    """Runs of poses, each from home, in the middle of the play. Sums over samples alone may take long."""
    calibration, controller = compiled(name)
    sensors, home, worst = sensors_of(calibration), hexapod.home_values(design.mechanism), 0.0
    T = wanted(design, count)
    for at in range(0, count, AT_ONCE):
        controller.start()
        lengths, status = controller(T[at : at + AT_ONCE], WARM)
        done = commands_along_route(calibration, T[at : at + AT_ONCE], home, None, sensors)
        assert (status == OK).all()
        worst = max(worst, np.abs(lengths - done.values).max())
    most, mean = controller.took(T[:TIMED], LONGEST if name in COMPARED else np.inf)
    with capsys.disabled():
        print(
            f"\n{name}: {count} poses, {worst:.2g} m at most; of {TIMED} at most the slowest {most * 1e6:.2f} us, "
            f"{mean * 1e6:.2f} us in the mean"
        )
    assert worst < SAME
    assert most < LONGEST or name not in COMPARED


def reached(calibration, T, values, sensors):
    """Poses that commands (n, 6) m give one after the other, by the forward model and not by any inverse of it."""
    machine = Machine(calibration.correction, calibration.physics, sensors)
    route = untimed_route(values, hexapod.home_values(calibration.correction.nominal))
    effective = machine.effective(route.commands(values), route.times, T)
    return hexapod.forward(effective, calibration.correction.fitted, T)


coordinates = st.lists(st.floats(-1, 1), min_size=6, max_size=6)
SPAN = np.array([0.03] * 3 + [0.12] * 3)  # m, rad from home


def near_home(design, shares):
    """Poses (n,) of shares (n, 6) from home."""
    home = home_pose(design.mechanism)
    off = np.array(shares) * SPAN
    return pose(home.translation + off[:, :3], (Rotation.from_rotvec(off[:, 3:]) * home.rotation).as_rotvec())


@needs_compiler
@pytest.mark.parametrize("name", ["simplices", "pose maps"])
@given(shares=st.lists(coordinates, min_size=1, max_size=3))
@settings(max_examples=60, deadline=None)
def test_corrected_lengths_give_the_wanted_pose(design, compiled, name, shares):
    calibration, controller = compiled(name)
    T = near_home(design, shares)
    lengths, status = controller(T, WARM)
    good = status == OK
    assert np.isnan(lengths[~good]).all() and (status[~good] == OUT_OF_STROKE).all()
    if good.any():
        found = calibration.correction.predict(lengths[good], T[good])
        assert np.abs(pose_difference(found, T[good])).max() < SAME


@needs_compiler
@given(shares=st.lists(coordinates, min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_in_any_order_the_machine_with_its_play_comes_to_the_wanted_poses(design, compiled, shares):
    calibration, controller = compiled("all")
    T = near_home(design, [share for share in shares for _ in range(2)])  # each twice: the second time nothing moves
    controller.start()
    lengths, status = controller(T, WARM)
    good = status == OK
    if good.any():
        found = reached(calibration, T[good], lengths[good], sensors_of(calibration))
        assert np.abs(pose_difference(found, T[good])).max() < SAME
    assert (status[~good] == OUT_OF_STROKE).all()
    assert np.abs(lengths[0::2] - lengths[1::2])[good[0::2]].max(initial=0) < 1e-11


@needs_compiler
def test_what_cannot_be_commanded_is_refused_and_changes_nothing(design, compiled):
    _, controller = compiled("all")
    T = wanted(design, 3)
    controller.start()
    controller(T[:1], WARM)
    before = controller.state.copy()
    for bad in (np.nan, np.inf):
        row, lengths = np.array([0, 0, bad, 0, 0, 0.0]), np.full(6, 7.0)
        values = np.array([WARM[name] for name in controller.channels])
        status = controller.library.rig_correct(*map(pointer, (row, values, controller.state, lengths)))
        assert status == BAD_POSE and (lengths == 7).all()
    up = pose([[0.0, 0.0, T.translation[:, 2].max() + 0.3]], [[0.0, 0.0, 0.0]])
    assert controller(up, WARM)[1] == OUT_OF_STROKE
    assert controller(T[1:2])[1] == SENSOR_MISSING
    for name in controller.channels:
        assert controller(T[1:2], WARM | {name: np.nan})[1] == SENSOR_MISSING
    assert np.isnan(controller(up, WARM)[0]).all() and (controller.state == before).all()
    state, controller.state = controller.state, None
    assert controller(T[1:2], WARM)[1] == NO_STATE and controller.start() == NO_STATE
    controller.state = state
    controller.state[0] = np.nan
    assert controller(T[1:2], WARM)[1] == NO_STATE
    assert controller.start(np.full(6, np.nan)) == NO_STATE and controller.start() == OK
    assert controller(T[1:2], WARM)[1] == OK
    assert "ambient_temperature_C" in controller.channels and len(controller.channels) == 7


@needs_compiler
def test_strokes_end_where_rig_correct_ends_them(design, compiled):
    """Poses all about the edge: each is refused by both or by none."""
    calibration, controller = compiled("plain")
    T = wanted(design, 400, fill=1.02)
    _, status = controller(T)
    done = correct(calibration, T, CorrectOptions(skip_unreachable=True))
    assert (np.flatnonzero(status == OK) == done.index).all() and set(status) == {OK, OUT_OF_STROKE}


@needs_compiler
def test_what_has_no_fixed_point_is_said_not_to_converge(design, tmp_path):
    """A summand that changes more than the command does: the iteration goes on for ever, unless it is bounded."""
    strokes = design.mechanism.strut_range
    x = np.stack(np.meshgrid(*np.linspace(strokes[:, 0], strokes[:, 1], 2, axis=1), indexing="ij"), -1).reshape(-1, 6)
    steep = -1.5 * (x - strokes.mean(axis=1))
    field = fit_field("simplex", FieldSamples(x, steep, np.full(x.shape, 1e-14), strokes))
    controller = Controller(calibration_of(replace(fitted(design), extension=field)), tmp_path)
    _, status = controller(wanted(design, 100))
    assert (status == NOT_CONVERGED).all()


@needs_compiler
def test_a_large_map_in_pose_space_is_undone_on_the_group(design, tmp_path):
    """Of 2 mm and 20 mrad: rotation and translation count together, to third order."""
    large = pose_map(design, "polynomial", np.array([2e-3] * 3 + [2e-2] * 3))
    calibration = calibration_of(correction_with_pose_space_map(fitted(design), large))
    T = wanted(design, 200, fill=0.4)
    lengths, status = Controller(calibration, tmp_path)(T)
    done = correct(calibration, T)
    assert (status == OK).all() and np.abs(lengths - done.values).max() < SAME


@needs_compiler
def test_play_goes_on_from_where_the_struts_stand(design, compiled):
    calibration, controller = compiled("backlash")
    T, start = wanted(design, 40), hexapod.home_values(design.mechanism) + 0.01
    assert controller.start(start) == OK
    halves = np.vstack([controller(T[:20])[0], controller(T[20:])[0]])
    done = correct(calibration, T, CorrectOptions(sensors_of(calibration), start))
    assert np.abs(halves - done.values).max() < SAME
    away = done.values - hexapod.inverse(T, calibration.correction.fitted)
    assert set(np.round(np.abs(away[:, 0]), 7)) == {4e-5} and set(np.sign(away[:, 0])) == {-1, 1}


@needs_compiler
@pytest.mark.parametrize("kind", MOVING, ids=[kind.name for kind in MOVING])
def test_an_effect_is_stated_as_it_acts_or_refused(design, kind, tmp_path):
    """Every effect that commands undo: as `rig correct` undoes it, or an error that names it."""
    calibration = known_to_be(design, parse_effect(f"{kind.name}:{SOME[kind.name]}"))
    if kind.in_controller is Effect.in_controller:
        with pytest.raises(RigError, match=kind.label()):
            c_text(calibration)
        return
    controller, T = Controller(calibration, tmp_path), wanted(design, 50)
    lengths, status = controller(T, WARM)
    done = correct(calibration, T, CorrectOptions(sensors_of(calibration)))
    assert (status == OK).all() and np.abs(lengths - done.values).max() < SAME
    assert np.abs(lengths - hexapod.inverse(T, design.mechanism)).max() > 1e-6


@needs_compiler
def test_medians_stand_for_channels_that_nobody_measures(design, compiled):
    calibration, controller = compiled("thermal")
    T = wanted(design, 20)
    medians = (ctypes.c_double * 7).in_dll(controller.library, "rig_channel_medians")
    lengths, _ = controller(T, dict(zip(controller.channels, medians)))
    assert np.abs(lengths - correct(calibration, T).values).max() < SAME


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_nothing_is_allocated_and_no_other_header_is_needed(design, name):
    text = c_text(CALIBRATIONS[name](design))
    assert re.findall("#include.*", text) == ["#include <math.h>"]
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|goto|while|do|float|long)\b", code)
    assert "rig 1.2.3" in text and max(map(len, text.splitlines())) < 200
    bodies = re.findall(r"^[\w ]+?\b(\w+)\([^;{]*\)\n\{\n(.*?)^\}", code, flags=re.MULTILINE | re.DOTALL)
    order = [found for found, _ in bodies]
    assert order[-1] == "rig_correct" and len(order) >= 5
    for i, (_, body) in enumerate(bodies):  # none calls itself or one that comes after it: no recursion
        assert not set(re.findall(r"\b(\w+)\(", body)) & set(order[i:])


def test_two_plays_of_a_strut_and_unknown_ways_are_refused(design):
    twice = calibration_of(fitted(design), effects(design, "backlash:strut1:gap=1e-5", "backlash:strut1:gap=2e-5"))
    with pytest.raises(RigError, match="strut 1 has two plays"):
        c_text(twice)
    both = calibration_of(CALIBRATIONS["pose maps"](design).correction, effects(design, "backlash:strut1:gap=1e-5"))
    with pytest.raises(RigError, match="maps in pose space together with backlash at strut 1"):
        c_text(both)
    some = np.arange(120) < 40
    field = fit_field("delaunay", field_samples(design, "delaunay").take(some))
    with pytest.raises(RigError, match=r"'delaunay' is in no C file.*--extend simplex"):
        c_text(calibration_of(replace(fitted(design), extension=field)))


def test_a_chain_is_refused_by_kind():
    chain = Chain((STANFORD, STANFORD))
    with pytest.raises(RigError, match="holds a hexapod's calibration, or with --format c an arm's.*of kind 'chain'"):
        c_text(calibration_of(Correction(chain, chain, (None,) * len(chain.axes))))


def test_the_command_writes_the_file_and_says_what_it_leaves(design, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    late = effects(design, "thermal_expansion:strut2:coefficient=1e-5,lag=600")
    calibration_file.save("calibration.json", calibration_of(fitted(design), late))
    assert main(["export", "calibration.json", "--format", "c", "--out", "correction.c"]) == 0
    assert "strut2_temperature_C: pass what a first-order lag of 600 s" in capsys.readouterr().out
    assert (tmp_path / "correction.c").read_text() == export(tmp_path / "calibration.json", "c").text
    assert main(["export", "calibration.json", "--format", "c"]) != 0
    assert "c takes a calibration.json and --out" in capsys.readouterr().err
