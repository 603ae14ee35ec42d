"""Effects against cases worked by hand: their sign and their size."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rig.effects.framework.machine_motion_and_play import first_order_lag, play_operator
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.design import Camera, Platform
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.hexapod import cardan_twist_angles_about_struts
from rig.model.pose import exp, pose, pose_difference
from rig.recording.recording_folder import Commands, Sensors
from vision.marker_corner_prediction import State, marker_map, predict_sightings, sightings_facing_cameras_anywhere


def moved(design, values, t, effect, sensors=None):
    """(n, 6) deviation of the struts along a path of commands (m, 6) at times 0, 1, .., exposed at t."""
    commands = Commands(np.arange(len(values), dtype=float), np.asarray(values, float))
    return motion_simulation.simulate_machine_run(design, commands, np.asarray(t, float), [effect], sensors).deviation


@pytest.fixture
def home(design):
    return hexapod.inverse(design.mechanism.home, design.mechanism)


def out_and_back(home, reach, strut=2):
    values = np.tile(home, (3, 1))
    values[1, strut] += reach
    return values


def test_scale_error_by_hand(design, home):
    found = moved(design, out_and_back(home, 0.01), [1], parse_effect("scale_error:strut3:scale=1e-3"))
    np.testing.assert_allclose(found[0], [0, 0, 1e-5, 0, 0, 0], atol=1e-15)


def test_a_scale_that_grows_along_the_travel_by_hand(design, home):
    half = float(np.ptp(design.mechanism.strut_range[2])) / 2
    values, own = out_and_back(home, 0.01), parse_effect("scale_error:strut3:scale=1e-3,curvature=0.2")
    np.testing.assert_allclose(moved(design, values, [1], own)[0, 2], 1e-5 * (1 + 0.2 * 0.01 / half), rtol=1e-12)
    other = parse_effect("axis_coupling:strut5:scale=1e-3,other=3,curvature=0.2")
    np.testing.assert_allclose(moved(design, values, [1], other)[0, 4], 1e-5 * (1 + 0.2 * 0.01 / half), rtol=1e-12)


@pytest.mark.parametrize(
    "text", ["scale_error:rig:scale=1e-3,curvature=0.2", "axis_coupling:strut5:scale=1e-3,other=3,curvature=-0.3"]
)
def test_a_controller_computes_a_scale_that_grows_alike(design, home, text):
    effect, values = parse_effect(text), out_and_back(home, 0.01)
    commands = Commands(np.arange(len(values), dtype=float), values)
    motion = motion_simulation.motion_of_commands(design, commands, np.array([1.0]), [effect])
    names = {"c": values[1], "d": np.zeros(6)}
    for line in effect.in_controller(motion).statements:
        exec(line.rstrip(";"), {}, names)  # the lines of C are arithmetic that Python reads too
    np.testing.assert_allclose(names["d"], effect.deviation(motion)[0], atol=1e-18)


def test_cyclic_error_by_hand(design, home):
    lead = design.actuator.screw_lead
    quarter = (np.floor(home[2] / lead) + 1.25) * lead - home[2]
    found = moved(design, out_and_back(home, quarter), [1], parse_effect("cyclic_error:strut3:amplitude=7e-6"))
    assert found[0, 2] == pytest.approx(7e-6, abs=1e-12)


def test_transmission_error_by_hand(design, home):
    low, high = design.mechanism.strut_range[2]
    found = moved(
        design,
        out_and_back(home, (low + high) / 2 - home[2]),
        [1],
        parse_effect("transmission_error:strut3:profile=0/3e-5/0"),
    )
    assert found[0, 2] == pytest.approx(3e-5, abs=1e-12)


def test_backlash_by_hand(design, home):
    found = moved(design, out_and_back(home, 1e-3), [0, 1, 2], parse_effect("backlash:strut3:gap=4e-5"))
    np.testing.assert_allclose(found[:, 2], [0, -2e-5, 2e-5], atol=1e-15)
    small = moved(design, out_and_back(home, 1.5e-5), [1, 2], parse_effect("backlash:strut3:gap=4e-5"))
    np.testing.assert_allclose(small[:, 2], [-1.5e-5, 0], atol=1e-15)  # within the gap the strut does not move at all


def test_hysteresis_by_hand(design, home):
    found = moved(design, out_and_back(home, 0.02), [1, 2], parse_effect("hysteresis:strut3:range=4e-3,weight=1e-2"))
    np.testing.assert_allclose(
        found[:, 2], [-2e-5, 2e-5], rtol=1e-9
    )  # weight x half the range, on the mean of the plays


def test_missed_steps_by_hand(design, home):
    found = moved(design, np.tile(home, (4, 1)), [0.5, 1.5, 2.5], parse_effect("missed_steps:strut3:jump=-4e-5,time=1"))
    np.testing.assert_allclose(found[:, 2], [0, -4e-5, -4e-5], atol=1e-15)


def test_servo_lag_by_hand(design, home):
    values = np.tile(home, (2, 1))
    values[1, 2] += 0.01  # 10 mm/s
    commands = Commands(np.array([0.0, 1.0]), values)
    motion = motion_simulation.motion_of_commands(
        design, commands, np.array([0.5]), [parse_effect("servo_lag:strut3:time_constant=0.02")]
    )
    assert motion.lengths[0, 2] - home[2] == pytest.approx(0.005 - 0.01 * 0.02, rel=1e-9)
    assert motion.lengths[0, 1] == home[1]


def test_knots_of_a_path_grow_with_the_lags_and_not_with_their_product(design, home):
    rng, count = np.random.default_rng(1), 20
    commands = Commands(np.arange(count, dtype=float), home + rng.uniform(-1e-3, 1e-3, (count, 6)))
    lags = [parse_effect(f"servo_lag:strut{i + 1}:time_constant=0.0{i + 1}") for i in range(6)]
    path = motion_simulation.motion_of_commands(design, commands, np.array([10.5]), lags).path
    assert len(path.t) < 40 * count


def test_creep_by_hand(design, home):
    values = np.tile(home, (4, 1))
    values[1:, 2] += 0.01
    commands = Commands(np.array([0.0, 1e-6, 20.0, 1e4]), values)
    found = motion_simulation.simulate_machine_run(
        design, commands, np.array([1e-6, 20.0, 9e3]), [parse_effect("creep:strut3:fraction=3e-3,time_constant=20")]
    ).deviation
    np.testing.assert_allclose(found[:, 2], [-3e-5, -3e-5 / np.e, 0], rtol=1e-6, atol=1e-12)


def test_thermal_expansion_by_hand(design, home):
    warm = Sensors(np.array([0.0, 9.0]), {f"strut{i}_temperature_C": np.full(2, 23.0) for i in range(1, 7)})
    found = moved(design, np.tile(home, (2, 1)), [1], parse_effect("thermal_expansion:rig:coefficient=1e-5"), warm)
    np.testing.assert_allclose(found[0], home * 3e-5)
    with pytest.raises(RigError, match="sensor channel 'strut1_temperature_C'"):
        moved(design, np.tile(home, (2, 1)), [1], parse_effect("thermal_expansion:rig:coefficient=1e-5"))


def test_warm_up_by_hand(design, home):
    commands = Commands(np.array([0.0, 1e5]), np.tile(home, (2, 1)))
    found = motion_simulation.simulate_machine_run(
        design, commands, np.array([0.0, 900.0, 9e4]), [parse_effect("warm_up:strut3:amplitude=5e-5,time_constant=900")]
    ).deviation
    np.testing.assert_allclose(found[:, 2], [0, 5e-5 * (1 - 1 / np.e), 5e-5], atol=1e-12)


def test_screw_coupling_by_hand(design):
    """Turned by psi about upright struts, every platform-side cardan turns by psi against its base."""
    upright = replace(
        design.mechanism, platform_joints=design.mechanism.base_joints, home=pose([0, 0, 0.45], [0, 0, 0])
    )
    psi = 0.01
    np.testing.assert_allclose(
        cardan_twist_angles_about_struts(pose([0, 0, 0.45], [0, 0, psi]), upright), psi, rtol=2e-3
    )
    T = design.mechanism.home * exp(np.array([0, 0, 0, 0, 0, psi]))
    lengths = hexapod.inverse(T, design.mechanism)
    found = moved(design, [lengths, lengths], [1], parse_effect("screw_coupling:rig:gain=0.5"))[0]
    twist = cardan_twist_angles_about_struts(T, design.mechanism) - cardan_twist_angles_about_struts(
        design.mechanism.home, design.mechanism
    )
    np.testing.assert_allclose(found, 0.5 * design.actuator.screw_lead / (2 * np.pi) * twist, rtol=1e-3)
    assert (found > 0).all()  # a positive turn lengthens
    ball = replace(design, actuator=replace(design.actuator, joints="cardan-ball"))
    with pytest.raises(RigError, match="a ball turns freely"):
        moved(ball, [lengths, lengths], [1], parse_effect("screw_coupling:rig:gain=0.5"))


def loaded(design):
    """The design with a platform of 12 kg balanced over its middle."""
    return replace(design, platform=Platform(12.0, np.zeros(3), np.zeros(3)))


def test_compliance_by_hand(design, home):
    upright = home[0] / (design.mechanism.home.translation[2])  # 1 / cosine of a strut's slope, alike for all six
    force = 12.0 * 9.80665 / 6 * upright
    found = moved(loaded(design), np.tile(home, (2, 1)), [1], parse_effect("compliance:rig:stiffness=5e6"))
    np.testing.assert_allclose(found[0], -force / 5e6, rtol=1e-4)


def test_joint_clearance_by_hand(design, home):
    found = moved(loaded(design), np.tile(home, (2, 1)), [1], parse_effect("joint_clearance:strut3:gap=3e-5"))
    np.testing.assert_allclose(found[0], [0, 0, -1.5e-5, 0, 0, 0], atol=1e-15)  # a strut that pushes
    pulled = replace(loaded(design), gravity=np.array([0, 0, 9.80665]))
    assert moved(pulled, np.tile(home, (2, 1)), [1], parse_effect("joint_clearance:strut3:gap=3e-5"))[
        0, 2
    ] == pytest.approx(1.5e-5)


def test_base_expansion_by_hand(design, home):
    warm = Sensors(np.array([0.0, 9.0]), {"ambient_temperature_C": np.full(2, 22.0)})
    m = design.mechanism
    commands = Commands(np.array([0.0, 1.0]), np.tile(home, (2, 1)))
    T = motion_simulation.simulate_machine_run(
        design, commands, np.array([1.0]), [parse_effect("base_expansion:rig:coefficient=5e-5")], warm
    ).T_base_platform
    grown = replace(m, base_joints=m.base_joints * (1 + 5e-5 * 2))
    np.testing.assert_allclose(pose_difference(T[0], hexapod.forward(home, grown)), 0, atol=1e-11)


def test_vibration_by_hand(design, home):
    commands = Commands(np.array([0.0, 1.0]), np.tile(home, (2, 1)))
    T = motion_simulation.simulate_machine_run(
        design, commands, np.array([0.25]), [parse_effect("vibration:rig:amplitude=2e-5,frequency=1,mode=2")]
    ).T_base_platform
    np.testing.assert_allclose(pose_difference(design.mechanism.home, T[0]), [0, 0, 2e-5, 0, 0, 0], atol=1e-12)


def test_the_clocks_by_hand(design, home):
    values = np.tile(home, (2, 1))
    values[1, 2] += 0.01
    commands = Commands(np.array([0.0, 100.0]), values)

    def at(text):
        return (
            motion_simulation.motion_of_commands(design, commands, np.array([50.0]), [parse_effect(text)]).lengths[0, 2]
            - home[2]
        )

    assert at("time_offset:clock:offset=0.02") == pytest.approx(1e-4 * 50.02)
    assert at("time_offset:clock:offset=0.02,since=60") == pytest.approx(1e-4 * 50.0)  # a clock that has not jumped yet
    assert at("clock_drift:clock:rate=1e-4") == pytest.approx(1e-4 * 50 * (1 + 1e-4))


@pytest.fixture
def looking(design):
    """One camera that looks straight at one marker of side 0.1 m, one metre ahead: f = 1000 px, middle (639.5,
    511.5).
    """
    from rig.model.design import Marker, Target

    camera = Camera(
        "cam1", 1280, 1024, [[1000.0, 0, 639.5], [0, 1000, 511.5], [0, 0, 1]], np.zeros(5), RigidTransform.identity()
    )
    ahead = pose([0, 0, 1.0], [np.pi, 0, 0])  # facing the camera, its top to the image's top
    one, two = (Marker(k, 0.1, ahead * pose([0.3 * k, 0, 0], [0, 0, 0]), 0.01) for k in range(2))
    rig = replace(design, cameras=(camera,), targets=(Target("t", "base", "DICT_5X5_100", listed=(one, two)),))

    def look(text=None, t=(0.0,), **channels):
        effects = [parse_effect(text)] if text else []
        state = State(rig.cameras, RigidTransform.concatenate([design.mechanism.home] * len(t)), {})
        sensors = Sensors(np.array([-1e9, 1e9]), {name: np.full(2, value) for name, value in channels.items()})
        found = sightings_facing_cameras_anywhere(state, marker_map(rig))
        return predict_sightings(found, state, marker_map(rig), np.array(t), effects, sensors)[::2] - [639.5, 511.5]

    np.testing.assert_allclose(look()[0], [[-50, -50], [50, -50], [50, 50], [-50, 50]], atol=1e-9)
    return look


@pytest.mark.parametrize(
    "text, corner",
    [
        ("print_scale:markers:scale=0.01", [-50.5, -50.5]),
        ("edge_bias:cameras:bias=0.5", [-49.5, -49.5]),
        ("face_misplacement:0:offset=0.001/0.002/0", [-49, -52]),
        ("cube_misplacement:t:motion=0.001/0.002/0/0/0/0", [-49, -48]),
        ("marker_swap:0:turn=1", [-50, 50]),
        ("marker_swap:0:other=1", [250, -50]),
        ("lens_distortion:cam1:terms=0.1/0/0/0/0/0/0/0/0/0/0/0", [-50 * (1 + 0.1 * 0.005)] * 2),
        ("camera_bump:cam1:motion=0.001/0/0/0/0/0,time=-1", [-51, -50]),
        ("refraction:cam1:thickness=0.01", [-50 / (1 - 0.01 * (1 - 1 / 1.5))] * 2),
    ],
)
def test_what_cameras_see_by_hand(looking, text, corner):
    np.testing.assert_allclose(looking(text)[0, 0], corner, rtol=2e-5)


def test_a_tilted_window_is_a_square_one_seen_from_aside():
    """Turning camera, window and points together changes nothing."""
    rng = np.random.default_rng(0)
    points, turn = np.r_[0, 0, 1.0] + 0.2 * rng.normal(size=(40, 3)), Rotation.from_rotvec([0.3, -0.4, 0.1])
    square, normal = parse_effect("refraction:cam1:thickness=0.01"), turn.apply([0, 0, 1.0])
    tilted = parse_effect(f"refraction:cam1:thickness=0.01,normal={normal[0]}/{normal[1]}/{normal[2]}")
    camera = Camera(
        "cam1", 1280, 1024, [[1000.0, 0, 639.5], [0, 1000, 511.5], [0, 0, 1]], np.zeros(5), RigidTransform.identity()
    )
    np.testing.assert_allclose(
        tilted.bend(camera, turn.apply(points)), turn.apply(square.bend(camera, points)), atol=1e-14
    )
    assert np.abs(tilted.bend(camera, points) - square.bend(camera, points)).max() > 1e-4
    with pytest.raises(RigError, match="away from the camera"):
        parse_effect("refraction:cam1:thickness=0.01,normal=1/0/0.1")


def test_a_slab_shifts_a_ray_as_snell_says():
    """At 45 degrees a plate of 10 mm and index 1.5 shifts a ray sideways by t sin(a - b) / cos b, b the angle
    inside.
    """
    camera = Camera(
        "cam1", 1280, 1024, [[1000.0, 0, 639.5], [0, 1000, 511.5], [0, 0, 1]], np.zeros(5), RigidTransform.identity()
    )
    a, b = np.pi / 4, np.arcsin(np.sin(np.pi / 4) / 1.5)
    shift = 0.01 * np.sin(a - b) / np.cos(b)
    window = parse_effect("refraction:cam1:thickness=0.01,normal=0.7071067811865476/0/0.7071067811865476")
    seen = window.bend(camera, np.array([[shift, 0.0, 1.0]]))[
        0
    ]  # its ray leaves the camera along the axis and bends towards the normal
    np.testing.assert_allclose(seen[:2] / seen[2], 0, atol=1e-12)


def test_camera_drift_and_focal_drift_by_hand(looking):
    drift = looking("camera_drift:cam1:motion=0.001/0/0/0/0/0,time_constant=100", t=(0.0, 100.0, 1e5))
    np.testing.assert_allclose(drift[:, 0, 0], [-50, -50 - (1 - 1 / np.e), -51], rtol=1e-9)
    assert looking("camera_bump:cam1:motion=0.001/0/0/0/0/0,time=50", t=(49.0, 51.0))[
        :, 0, 0
    ].tolist() == pytest.approx([-50, -51])
    assert looking("focal_drift:cameras:per_kelvin=1e-3", ambient_temperature_C=22.0)[0, 0, 0] == pytest.approx(-50.1)
    own = looking("focal_drift:cam1:per_kelvin=1e-3", ambient_temperature_C=22.0, camera_cam1_temperature_C=30.0)
    assert own[0, 0, 0] == pytest.approx(-50.5)
    with pytest.raises(RigError, match="ambient_temperature_C"):
        looking("focal_drift:cameras:per_kelvin=1e-3")


def test_rolling_shutter_by_hand(setting):
    """A corner is where the platform takes it by the time its row is read."""
    design, commands, t, _ = setting
    effect = parse_effect("rolling_shutter:cameras:row_time=2e-5")
    markers = marker_map(design)
    run = motion_simulation.simulate_machine_run(design, commands, t, rates=True)
    state = State(design.cameras, run.T_base_platform, {})
    found = sightings_facing_cameras_anywhere(state, markers)
    uv = predict_sightings(found, state, markers, t, [effect], None, run)
    k = np.flatnonzero(markers.on_platform[found.marker])[::29]
    late = 2e-5 * (uv[k, 0, 1] - 512)
    for j, seconds in zip(k, late):
        then = motion_simulation.simulate_machine_run(
            design, commands, np.array([t[found.frame[j]] + seconds])
        ).T_base_platform
        one = type(found)(np.array([0]), found.camera[[j]], found.marker[[j]])
        np.testing.assert_allclose(
            predict_sightings(one, State(design.cameras, then, {}), markers)[0, 0], uv[j, 0], atol=0.02
        )
    plain = predict_sightings(found, state, markers)
    assert np.abs(uv - plain).max() > 0.1


def test_play_and_lag_by_hand():
    path = np.array([[0.0], [1.0], [0.9], [0.2], [0.5]])
    np.testing.assert_allclose(play_operator(path, 0.1)[:, 0], [0, 0.9, 0.9, 0.3, 0.4])
    t = np.array([0.0, 1.0, 3.0])
    np.testing.assert_allclose(
        first_order_lag(t, np.array([[0.0], [1.0], [1.0]]), 1.0)[:, 0], [0, 1 / np.e, 1 - (1 - 1 / np.e) / np.e**2]
    )
