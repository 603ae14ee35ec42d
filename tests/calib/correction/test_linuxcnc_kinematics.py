"""LinuxCNC's kinematics module: compiled, it gives the joints of `rig correct`, and poses of joints; it refuses."""

import ctypes
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from calib.api.correct import CorrectOptions, correct
from calib.api.export_calibration_or_recording import ExportOptions, export
from calib.correction.hexapod_kinematics_c_source_for_linuxcnc_and_grblhal import linuxcnc_kinematics_source
from calib.files import calibration_file
from rig.cli.command_line import main
from rig.errors import RigError
from rig.model.mechanisms import hexapod
from rig.model.pose import pose, pose_difference
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
from tests.calib.linuxcnc_interface import HAL, HEADERS

SAME = 1e-9  # m
SINGULAR = 6
UNITS = {"mm": 1e3, "m": 1.0}
WITHOUT_PLAY = [name for name in CALIBRATIONS if name not in ("backlash", "all")]


def source_of(calibration, units="mm"):
    return linuxcnc_kinematics_source(calibration.correction, calibration.physics, "rig 1.2.3", units)


class Module:
    """rigkins of a calibration, compiled against least headers and started."""

    def __init__(self, calibration, folder, units="mm", most_pins=64):
        self.units, self.text = UNITS[units], source_of(calibration, units).text
        for name, text in (HEADERS | {"rigkins.c": self.text, "hal.c": HAL}).items():
            (folder / name).write_text(text)
        self.library = compiled_library(folder, "rigkins", "rigkins.c", "hal.c", include=("-I.",))
        self.library.pin.restype = ctypes.c_void_p
        ctypes.c_int.in_dll(self.library, "most_pins").value = most_pins
        self.started = self.library.rtapi_app_main()

    def pin(self, name, kind=ctypes.c_int32):
        """A pin's place in memory, to be read or written."""
        at = self.library.pin(f"rigkins.{name}".encode())
        assert at is not None, name
        return kind.from_address(at)

    def warm(self, sensors):
        for name in re.findall(r"channels\[\d+\] (\w+)", self.text):
            self.pin(name, ctypes.c_double).value = sensors[name]

    def world(self, T):
        """(9,) as LinuxCNC holds a pose."""
        place = np.r_[T.translation * self.units, T.rotation.as_euler("xyz", degrees=True), 0, 0, 0]
        return np.ascontiguousarray(place)

    def inverse(self, T):
        """(status, (6,) m) of a pose, NaN where none is written."""
        at, joint = self.world(T) if isinstance(T, RigidTransform) else T, np.full(9, np.nan)
        status = self.library.kinematicsInverse(*map(pointer, (at, joint)), None, None)
        assert np.isnan(joint[6:]).all()
        return status, joint[:6] / self.units

    def forward(self, lengths, world):
        """Status of the forward kinematics of lengths (6,) m; world (9,) is the guess, and what is found."""
        joint = np.ascontiguousarray(lengths * self.units)
        return self.library.kinematicsForward(*map(pointer, (joint, world)), None, None)

    def pose(self, world):
        turned = Rotation.from_euler("xyz", world[3:6], degrees=True)
        return RigidTransform.from_components(world[:3] / self.units, turned)


@pytest.fixture(scope="module")
def compiled(design, tmp_path_factory):
    """(name, units) -> (Calibration, Module), each compiled once."""

    @cache
    def make(name, units="mm"):
        calibration = CALIBRATIONS[name](design)
        return calibration, Module(calibration, tmp_path_factory.mktemp("kins"), units)

    return make


@needs_compiler
@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("name", WITHOUT_PLAY)
def test_joints_are_those_of_rig_correct_and_forward_finds_the_pose_again(design, compiled, name, units):
    calibration, module = compiled(name, units)
    module.warm(WARM)
    T = wanted(design, 40)
    done = correct(calibration, T, CorrectOptions(sensors_of(calibration))).values
    assert module.started == 0 and module.library.kinematicsType() == 4
    for i in range(len(T)):
        status, lengths = module.inverse(T[i])
        assert status == 0 and np.abs(lengths - done[i]).max() < SAME
        for guess in (T[i - 1], T[i]):
            world = module.world(guess)
            assert module.forward(lengths, world) == 0
            assert np.abs(pose_difference(module.pose(world), T[i])).max() < SAME
    assert np.abs(done - hexapod.inverse(T, design.mechanism)).max() > 1e-5


@needs_compiler
def test_a_guess_that_is_no_pose_is_replaced_by_home(design, compiled):
    """LinuxCNC begins with zeros where no home is set, and may hold rubbish after a fault."""
    _, module = compiled("simplices")
    T = wanted(design, 20)
    flipped = RigidTransform.from_components([0, 0, -0.4], Rotation.identity())
    for i, start in enumerate([np.zeros(9), np.full(9, 1e6), np.full(9, np.nan), module.world(flipped)] * 5):
        world = start.copy()
        assert module.forward(module.inverse(T[i])[1], world) == 0
        assert np.abs(pose_difference(module.pose(world), T[i])).max() < SAME


@needs_compiler
def test_next_to_the_guess_the_pose_takes_few_steps(design, compiled):
    _, module = compiled("simplices")
    T = wanted(design, 1)[0]
    world = module.world(T)
    near = module.inverse(T)[1] + 1e-5
    assert module.forward(near, world) == 0 and 1 <= module.pin("forward-steps").value <= 4
    assert module.forward(near, world) == 0 and module.pin("forward-steps").value == 0


@needs_compiler
def test_turns_stay_those_of_the_guess(design, compiled):
    """An axis that stands at 370 degrees is not called 10."""
    _, module = compiled("plain")
    T = wanted(design, 1)[0]
    world = module.world(T)
    world[5] += 720.0
    before = world.copy()
    assert module.forward(module.inverse(T)[1], world) == 0 and np.abs(world - before).max() < 1e-6


@needs_compiler
def test_play_is_left_to_linuxcnc_and_the_rest_is_not(design, tmp_path):
    """Half a play on either side of the joints is what `rig correct` commands."""
    calibration = CALIBRATIONS["all"](design)
    module = Module(calibration, tmp_path)
    module.warm(WARM)
    assert source_of(calibration).gaps[[0, 3]].tolist() == [8e-5, 3e-5]
    assert "BACKLASH = 0.080000000" in module.text and module.text.count("BACKLASH = ") == 2
    T = wanted(design, 40)
    done = correct(calibration, T, CorrectOptions(sensors_of(calibration))).values
    off = np.array([module.inverse(T[i])[1] - done[i] for i in range(len(T))])
    assert np.abs(np.abs(off) - source_of(calibration).gaps / 2).max() < 1e-7
    assert {-1, 1} <= set(np.sign(off[:, 0])) and np.abs(off[:, 1]).max() < 1e-7


def test_play_with_a_cyclic_error_is_refused(design):
    both = effects(design, "backlash:strut1:gap=1e-5", "cyclic_error:strut1:amplitude=1e-5,order=1,phase=0.3")
    with pytest.raises(RigError, match="play together with a cyclic error"):
        source_of(calibration_of(fitted(design), both))


@needs_compiler
def test_what_is_refused_returns_below_zero_names_itself_and_changes_nothing(design, tmp_path):
    calibration = CALIBRATIONS["thermal"](design)
    module = Module(calibration, tmp_path)
    module.warm(WARM)
    T = wanted(design, 1)[0]
    count, message = module.pin("refusals", ctypes.c_uint32), (ctypes.c_char * 256).in_dll(module.library, "message")
    high = RigidTransform.from_components(T.translation + [0, 0, 0.3], T.rotation)
    world = module.world(T)
    world[3] = np.nan
    assert module.inverse(T)[0] == 0 and count.value == 0
    for bad, status in ((high, OUT_OF_STROKE), (world, BAD_POSE)):
        found, lengths = module.inverse(bad)
        assert found == -status and np.isnan(lengths).all() and module.pin("refused").value == status
    assert count.value == 2 and b"a number is not finite" in message.value
    printed = ctypes.c_int.in_dll(module.library, "messages")
    before = printed.value
    assert [module.inverse(high)[0] for _ in range(5)] == [-OUT_OF_STROKE] * 5
    assert printed.value == before + 1 and b"a strut leaves its range (strut 1" in message.value
    assert module.pin("refused-strut").value == 1
    assert module.inverse(T)[0] == 0 and module.pin("inverse-status").value == 0
    assert module.pin("refused").value == OUT_OF_STROKE and count.value == 7  # stays to be read
    module.pin("ambient_temperature_C", ctypes.c_double).value = np.nan
    world = module.world(T)
    world_before = world.copy()
    assert module.inverse(T)[0] == -SENSOR_MISSING
    assert module.forward(hexapod.inverse(T, design.mechanism), world) == -SENSOR_MISSING
    module.warm(WARM)
    assert module.forward(np.full(6, np.nan), world) == -BAD_POSE
    assert module.forward(np.r_[0.1, 0.9, 0.1, 0.9, 0.1, 0.9], world) == -NOT_CONVERGED
    assert module.pin("forward-status").value == NOT_CONVERGED and (world == world_before).all()


def least_share(design, mechanism, T):
    """Least singular value of the Jacobian of poses (n,), of that at home; turns at the joints' mean radius."""
    scale = np.r_[1, 1, 1, np.full(3, np.linalg.norm(mechanism.platform_joints, axis=1).mean())]
    home = hexapod.forward(hexapod.home_values(mechanism), mechanism)
    values = [np.linalg.svd(hexapod.jacobian(one, mechanism) / scale, compute_uv=False)[..., -1] for one in (T, home)]
    return values[0] / values[1]


@needs_compiler
def test_near_a_singularity_poses_and_joints_are_refused(design, tmp_path):
    """Struts without ends: the platform turns about its normal until little of the Jacobian is left, and beyond."""
    free = fitted(design)
    wide = np.tile([0.01, 9.0], (6, 1))
    free = replace(free, nominal=replace(free.nominal, strut_range=wide))
    module = Module(calibration_of(free), tmp_path)
    home = hexapod.forward(hexapod.home_values(design.mechanism), free.fitted)
    turns = Rotation.from_euler("z", np.linspace(0, 170, 86)[:, None], degrees=True)
    T = RigidTransform.from_components(np.tile(home.translation, (86, 1)), turns * home.rotation)
    share = least_share(design, free.fitted, T)
    signs = np.sign(np.linalg.det(hexapod.jacobian(T, free.fitted)))
    regular = (share > 0.1) & (signs == signs[0])
    assert (~regular).sum() > 10 and (share[signs != signs[0]] > 0.1).any()
    status = np.array([module.inverse(T[i])[0] for i in range(86)])
    assert (status == np.where(regular, 0, -SINGULAR)).all()
    assert module.pin("refused").value == SINGULAR
    beyond = T[int(np.flatnonzero((signs != signs[0]) & (share > 0.1))[0])]
    world = module.world(beyond)  # at home's side other joints have the same lengths, or none has
    status = module.forward(hexapod.inverse(beyond, free.fitted), world)
    assert status < 0 or np.abs(pose_difference(module.pose(world), beyond)).max() > 1e-3


@needs_compiler
def test_joints_without_a_pose_are_held_at_the_first_pose_of_world_mode_and_refused_another(design, tmp_path):
    """LinuxCNC takes home for the pose of such joints: they would leap to home, or to 0 where it is refused."""
    free = fitted(design)
    free = replace(free, nominal=replace(free.nominal, strut_range=np.tile([0.01, 9.0], (6, 1))))
    module, home = Module(calibration_of(free), tmp_path), free.nominal.home
    turned = [home * pose([0, 0, 0], [0, 0, np.radians(angle)]) for angle in (88, 90)]
    lost, further = (hexapod.inverse(T, free.fitted) for T in turned)
    for joints in (lost, further, lost):  # in joint mode joints are jogged, and no pose is asked for
        for _ in range(6):
            assert module.forward(joints, module.world(home)) == -SINGULAR
        for _ in range(3):
            status, held = module.inverse(home)
            assert status == 0 and np.abs(held - joints).max() < 1e-12
            module.forward(joints + 1e-6, module.world(home))  # fed back: what is held does not creep
        assert module.inverse(home * pose([0, 0, 1e-3], [0, 0, 0]))[0] == -SINGULAR
        assert module.inverse(home)[0] == 0
    regular = hexapod.inverse(home, free.fitted)
    assert module.forward(regular, module.world(home)) == 0
    status, joints = module.inverse(home)
    assert status == 0 and np.abs(joints - regular).max() < 1e-9


shares = st.lists(st.floats(-1, 1), min_size=6, max_size=6)


@pytest.mark.slow
@needs_compiler
@given(off=shares, near=shares)
@settings(max_examples=150, deadline=None)
def test_forward_undoes_inverse_from_any_guess_nearby(design, compiled, off, near):
    _, module = compiled("pose maps")
    span = np.array([0.02] * 3 + [0.1] * 3)
    home = hexapod.forward(hexapod.home_values(design.mechanism), design.mechanism)
    T, guess = (
        RigidTransform.from_components(home.translation + part[:3], Rotation.from_rotvec(part[3:]) * home.rotation)
        for part in (np.array(off) * span, np.array(near) * span)
    )
    status, lengths = module.inverse(T)
    assert status in (0, -OUT_OF_STROKE)
    if status == 0:
        world = module.world(guess)
        assert module.forward(lengths, world) == 0
        assert np.abs(pose_difference(module.pose(world), T)).max() < SAME


@needs_compiler
def test_a_start_without_room_for_pins_fails_and_leaves_no_component(design, tmp_path):
    module = Module(CALIBRATIONS["thermal"](design), tmp_path, most_pins=8)
    assert module.started < 0 and ctypes.c_int.in_dll(module.library, "ready").value == 0


def test_the_command_writes_the_module(design, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calibration_file.save("calibration.json", CALIBRATIONS["thermal"](design))
    given = ["export", "calibration.json", "--format", "linuxcnc-kins"]
    assert main([*given, "--units", "m", "--out", "rigkins.c"]) == 0
    text = (tmp_path / "rigkins.c").read_text()
    assert text == export(tmp_path / "calibration.json", "linuxcnc-kins", ExportOptions("m")).text
    assert "LINEAR_UNITS = 0.001" in text and "KINEMATICS = rigkins" in text
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|goto|while|do|float|long)\b", code)
    assert main(given) != 0
    assert "linuxcnc-kins takes a calibration.json and --out" in capsys.readouterr().err
