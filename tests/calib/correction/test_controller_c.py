"""The controller's C file: compiled, it commands what `rig correct` does, refuses what it must, allocates nothing."""

import ctypes
import re
import shutil
import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest

from calib.api.correct import CorrectOptions, correct
from calib.certification.calibration_dataclass_and_accuracy_claim_sentences import Calibration
from calib.correction.command_sequence_timing_and_pose_error_map import untimed_route
from calib.correction.correction import Correction
from calib.correction.correction_as_c_source import correction_c_source
from calib.correction.interpolation.field_interface_and_combinations import (
    FieldSamples,
    RestrictedMap,
    SpacePart,
    SummedPasses,
)
from calib.correction.interpolation.gaussian_process import fit_gaussian_process
from calib.correction.interpolation_methods_and_correction_summand_fields import (
    correction_with_pose_space_map,
    fit_field,
    home_pose,
)
from calib.models.wanted_pose_commands import commands_along_route
from rig.effects.framework.effect import Effect
from rig.effects.texts.effect_text_parsing import parse_effect
from rig.model.mechanisms import hexapod
from rig.model.pose import pose, pose_difference, pose_to_vector
from rig.planning import configuration_sets
from rig.recording.recording_folder import Sensors
from synthetic import secret_machine
from tests.calib.correction.test_physics import physics_of

COMPILER = shutil.which("cc")
needs_compiler = pytest.mark.skipif(
    COMPILER is None, reason="no C compiler cc here, and nothing else proves the C file"
)
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", "-Wmissing-prototypes", "-Wshadow")
OK, BAD_POSE, OUT_OF_STROKE, NOT_CONVERGED, SENSOR_MISSING, NO_STATE = range(6)
SAME = 1e-9  # m
FEW, MANY, AT_ONCE = 2000, 1_000_000, 25_000  # poses
WARM = {f"strut{i + 1}_temperature_C": 20.0 + 1.5 * i for i in range(6)} | {"ambient_temperature_C": 24.0}
LOOP = r"""
int poses(const double *pose, const double *channels, struct rig_state *state, double *lengths, int *status, int n);
int poses(const double *pose, const double *channels, struct rig_state *state, double *lengths, int *status, int n)
{
    int worst = 0;
    for (int i = 0; i < n; i++) {
        status[i] = rig_correct(pose + 6 * i, channels, state, lengths + 6 * i);
        worst = status[i] > worst ? status[i] : worst;
    }
    return worst;
}
"""


class Controller:
    """The C file of a calibration, compiled. channels : names in their order; state : as C holds it, or None"""

    def __init__(self, calibration, folder, start=None, stateless=False):
        self.text = correction_c_source(calibration, "0").text
        (folder / "correction.c").write_text(self.text)
        alone = subprocess.run(
            [COMPILER, *FLAGS, "-c", "correction.c", "-o", "correction.o"], cwd=folder, capture_output=True, text=True
        )
        assert alone.returncode == 0, alone.stderr
        (folder / "loop.c").write_text('#include "correction.c"\n' + LOOP)
        done = subprocess.run(
            [COMPILER, *FLAGS, "-shared", "-fPIC", "loop.c", "-o", "loop.so", "-lm"],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        self.library = ctypes.CDLL(str(folder / "loop.so"))
        self.channels = re.findall(r"channels\[\d+\] (\w+)", self.text)
        self.state = None if stateless else np.full(12, np.nan)
        if not stateless:
            assert self.start(start) == OK

    def start(self, lengths=None):
        """Status of standing at lengths (6,) m, or home."""
        given = None if lengths is None else np.ascontiguousarray(lengths)
        return self.library.rig_start(_pointer(self.state), _pointer(given))

    def __call__(self, T, sensors=None):
        """(lengths (n, 6) m, status (n,)) of poses (n,). sensors : {channel: value}, None to pass none"""
        wanted = np.ascontiguousarray(pose_to_vector(T).reshape(-1, 6))
        values = None if sensors is None else np.array([sensors[name] for name in self.channels] or [0.0])
        lengths, status = np.full(wanted.shape, np.nan), np.zeros(len(wanted), np.int32)
        self.library.poses(*map(_pointer, (wanted, values, self.state, lengths, status)), len(wanted))
        return lengths, status


def _pointer(array):
    return None if array is None else ctypes.c_void_p(array.ctypes.data)


def summand(design, x):
    """(n, 6) m: a smooth summand of some 40 um, with more along each strut's own command."""
    low, high = design.mechanism.strut_range.T
    u = (2 * x - low - high) / (high - low)
    return 2e-5 * np.sin(2 * u + u[:, ::-1]) + 1e-5 * u[:, [1, 2, 3, 4, 5, 0]] ** 2


def field_samples(design, kind):
    """FieldSamples of that summand, on a grid where a kind takes one."""
    strokes = design.mechanism.strut_range
    if kind in ("simplex", "linear"):
        x = np.stack(np.meshgrid(*np.linspace(strokes[:, 0], strokes[:, 1], 3, axis=1), indexing="ij"), -1)
        x = x.reshape(-1, 6)
    else:
        x = configuration_sets.sobol_configurations(strokes, 120, 1.0, 5)
    return FieldSamples(x, summand(design, x), np.full(x.shape, 1e-14), strokes)


def fitted(design, seed=4):
    """A Correction whose geometry is another than the nominal one."""
    true = secret_machine.draw_machine(design, np.random.default_rng(seed)).true.mechanism
    return Correction(design.mechanism, true, (None,) * 6)


def calibration_of(correction, physics=None):
    return Calibration(correction, 1e-14 * np.eye(42), np.zeros(6), (), (), None, {}, None, physics)


def restricted(design):
    """Two passes, the second over a part of one strut's stroke."""
    low, high = design.mechanism.strut_range[2]
    bounds = np.full((2, 6), np.inf) * [[-1], [1]]
    bounds[:, 2] = low + 0.3 * (high - low), low + 0.6 * (high - low)
    first = fit_field("linear", field_samples(design, "linear"))
    second = fit_field("axes", field_samples(design, "axes"))
    return SummedPasses((first, RestrictedMap(second, SpacePart(*bounds))))


def pose_map(design, kind):
    """A field in pose space, of some 30 um and 30 urad."""
    home = home_pose(design.mechanism)
    size = np.array([0.05] * 3 + [0.15] * 3)
    u = configuration_sets.sobol_configurations(np.tile([-1.0, 1.0], (6, 1)), 150, 1.0, 8)
    x = u * size + np.r_[home.translation, np.zeros(3)]
    values = 3e-5 * np.sin(2 * u + u[:, ::-1])
    return fit_field(kind, FieldSamples(x, values, np.full(x.shape, 1e-14), np.stack([x.min(0), x.max(0)], 1)))


def remainder(design):
    """A Correction whose struts 2 and 5 have a Gaussian process each."""
    known, start = field_samples(design, "radial"), fitted(design)
    parts = [
        fit_gaussian_process(known.configurations, known.values[:, i], known.variances[:, i], i, known.strokes)
        if i in (1, 4)
        else None
        for i in range(6)
    ]
    return replace(start, remainder=tuple(parts))


def effects(design, *texts):
    return physics_of(design, *[parse_effect(text) for text in texts])


BACKLASH = ("backlash:strut1:gap=8e-5", "backlash:strut4:gap=3e-5")
THERMAL = ("thermal_expansion:rig:coefficient=1.2e-5", "base_expansion:rig:coefficient=2e-5")
CALIBRATIONS = {
    "plain": lambda design: calibration_of(fitted(design)),
    "simplices": lambda design: calibration_of(
        replace(fitted(design), extension=fit_field("simplex", field_samples(design, "simplex")))
    ),
    "backlash": lambda design: calibration_of(fitted(design), effects(design, *BACKLASH)),
    "thermal": lambda design: calibration_of(fitted(design), effects(design, *THERMAL)),
    "all": lambda design: calibration_of(remainder(design), effects(design, *BACKLASH, *THERMAL)),
    "linear and part": lambda design: calibration_of(replace(fitted(design), extension=restricted(design))),
    **{
        kind: lambda design, kind=kind: calibration_of(
            replace(fitted(design), extension=fit_field(kind, field_samples(design, kind)))
        )
        for kind in ("axes", "radial", "polynomial")
    },
    "pose maps": lambda design: calibration_of(
        correction_with_pose_space_map(
            correction_with_pose_space_map(remainder(design), pose_map(design, "polynomial")),
            pose_map(design, "radial"),
        )
    ),
}
ASKED = ("plain", "simplices", "backlash", "thermal")


@pytest.fixture(scope="module")
def compiled(design, tmp_path_factory):
    """name -> (Calibration, Controller), each compiled once."""
    found = {}

    def make(name):
        if name not in found:
            calibration = CALIBRATIONS[name](design)
            found[name] = calibration, Controller(calibration, tmp_path_factory.mktemp("c"))
        return found[name]

    return make


def wanted(design, count, seed=11, fill=0.9):
    """Poses (count,) all over the workspace, as numbers of a file have them: vectors there and back."""
    lengths = configuration_sets.sobol_configurations(design.mechanism.strut_range, count, fill, seed)
    found = pose_to_vector(hexapod.forward(lengths, design.mechanism))
    return pose(found[:, :3], found[:, 3:])


def sensors_of(calibration):
    return None if calibration.physics is None else Sensors(np.zeros(1), {k: np.array([v]) for k, v in WARM.items()})


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
@pytest.mark.parametrize("name", (*ASKED, "all"))
def test_a_million_poses_are_commanded_alike(design, compiled, name, capsys):
    """Runs of poses, each from where the machine then stands, in the middle of its play."""
    calibration, controller = compiled(name)
    sensors, worst, took, slowest = sensors_of(calibration), 0.0, 0.0, 0.0
    T = wanted(design, MANY)
    for at in range(0, MANY, AT_ONCE):
        part = T[at : at + AT_ONCE]
        controller.start()
        begin = time.perf_counter()
        lengths, status = controller(part, WARM)
        took += time.perf_counter() - begin
        done = commands_along_route(
            replace(calibration, physics=calibration.physics),
            part,
            hexapod.home_values(design.mechanism),
            None,
            sensors,
        )
        assert (status == OK).all()
        worst = max(worst, np.abs(lengths - done.values).max())
    one = controller(T[:1], WARM)[0]
    vector, lengths, state = np.ascontiguousarray(pose_to_vector(T)), np.empty(6), _pointer(controller.state)
    values = _pointer(np.array([WARM[name] for name in controller.channels] or [0.0]))
    for row in vector[:20_000]:
        begin = time.perf_counter_ns()
        controller.library.rig_correct(_pointer(row), values, state, _pointer(lengths))
        slowest = max(slowest, (time.perf_counter_ns() - begin) * 1e-9)
    assert np.isfinite(one).all()
    with capsys.disabled():
        print(
            f"\n{name}: {MANY} poses, {worst:.2g} m at most, {took / MANY * 1e6:.2f} us a pose, the slowest of 20000 "
            f"single calls {slowest * 1e6:.1f} us with the call from Python"
        )
    assert worst < SAME


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
        status = controller.library.rig_correct(*map(_pointer, (row, values, controller.state, lengths)))
        assert status == BAD_POSE and (lengths == 7).all()
    up = pose([[0.0, 0.0, T.translation[:, 2].max() + 0.3]], [[0.0, 0.0, 0.0]])
    assert controller(up, WARM)[1] == OUT_OF_STROKE
    assert controller(T[1:2])[1] == SENSOR_MISSING
    for name in controller.channels:
        assert controller(T[1:2], WARM | {name: np.nan})[1] == SENSOR_MISSING
    assert np.isnan(controller(up, WARM)[0]).all() and (controller.state == before).all()
    kept, controller.state = controller.state, None
    assert controller(T[1:2], WARM)[1] == NO_STATE and controller.start() == NO_STATE
    controller.state = kept
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
    begin = time.perf_counter()
    _, status = controller(wanted(design, 100))
    assert (status == NOT_CONVERGED).all() and time.perf_counter() - begin < 1


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
            correction_c_source(calibration, "0")
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
    text = correction_c_source(CALIBRATIONS[name](design), "1.2.3").text
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
        correction_c_source(twice, "0")
    some = np.arange(120) < 40
    field = fit_field("delaunay", field_samples(design, "delaunay").take(some))
    with pytest.raises(RigError, match=r"'delaunay' is in no C file.*--extend simplex"):
        correction_c_source(calibration_of(replace(fitted(design), extension=field)), "0")


def test_the_command_writes_the_file_and_says_what_it_leaves(design, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    late = effects(design, "thermal_expansion:strut2:coefficient=1e-5,lag=600")
    calibration_file.save("calibration.json", calibration_of(fitted(design), late))
    assert main(["export", "calibration.json", "--format", "c", "--out", "correction.c"]) == 0
    assert "strut2_temperature_C: pass what a first-order lag of 600 s" in capsys.readouterr().out
    assert (tmp_path / "correction.c").read_text() == export(tmp_path / "calibration.json", "c").text
    assert main(["export", "calibration.json", "--format", "c"]) != 0
    assert "c takes a calibration.json and --out" in capsys.readouterr().err
