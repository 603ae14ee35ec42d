"""An emulated rig's cameras and sensors show the pose that its struts truly give it at the moment of asking, over TCP
as well.
"""

import threading
from dataclasses import replace

import numpy as np
import pytest

from rig.driving.cameras import CameraError, open_camera
from rig.driving.driving_clock import SimulatedClock, SystemClock
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.design import Sensor
from rig.model.pose import pose_difference
from rig.planning.layout.shipped_arms_and_layouts import load_shipped_arm_design
from rig.recording.recording_folder import Commands
from synthetic import emulated_camera_images_sensors_and_server_process, random_true_machine_and_truth_file
from synthetic.image_simulation import Images


@pytest.fixture
def secret(design):
    return random_true_machine_and_truth_file.random_true_machine(
        design, np.random.default_rng(3), 1.0, (parse_effect("backlash:strut2:gap=3e-4"),)
    )


@pytest.fixture
def strut_history(design):
    """Struts that went out and back: a play of strut 2 shows in where they stand."""
    home = mechanisms.kinematics_of(design.mechanism).inverse(design.mechanism.home, design.mechanism)
    return np.array([100.0, 101.0, 103.0, 105.0]), np.array([home, home, home + 0.02, home + 0.005])


def test_what_is_shown_is_the_true_pose_with_what_the_way_did_to_it(secret, strut_history):
    shown = emulated_camera_images_sensors_and_server_process.EmulatedCameras(
        secret, Images(Sensor()), 1, lambda: strut_history, SimulatedClock(105.0)
    )
    T = motion_simulation.simulate_machine_run(
        secret.true, Commands(strut_history[0] - 100, strut_history[1]), [5.0], secret.effects, None
    ).T_base_platform[0]
    np.testing.assert_allclose(shown.pose(105.0), T.as_matrix(), atol=1e-12)
    other = motion_simulation.simulate_machine_run(
        secret.true,
        Commands(strut_history[0][-2:] - 103, strut_history[1][-1:].repeat(2, axis=0)),
        [2.0],
        secret.effects,
        None,
    ).T_base_platform[0]
    assert np.abs(pose_difference(T, other)).max() > 5e-5, "the way does matter here"
    assert np.abs(shown.pose(102.0)[:3, 3] - shown.pose(105.0)[:3, 3]).max() > 1e-3, "on its way it is elsewhere"


def test_an_arm_is_shown_where_its_joints_and_their_play_have_it():
    stated = load_shipped_arm_design("ur10")
    arm = stated.mechanism
    world = random_true_machine_and_truth_file.World(stated, stated, (parse_effect("backlash:joint2:gap=1e-3"),))
    q = np.array([0.3, -1.0, 1.4, 0.2, 0.9, -0.4])
    history = np.array([100.0, 101.0, 103.0, 104.0]), np.array([q, q, q + 0.2, q + 0.1])
    shown = emulated_camera_images_sensors_and_server_process.EmulatedCameras(
        world, Images(Sensor()), 1, lambda: history, SimulatedClock(105.0)
    )
    off = shown.pose(103.9)[:3, 3] - mechanisms.kinematics_of(arm).forward(q + 0.11, arm).translation
    assert 1e-4 < np.linalg.norm(off) < 2e-3  # of 1.2 m of arm beyond joint 2, whose play is 1 mrad


def test_what_is_not_yet_told_is_waited_for_and_never_guessed(secret, strut_history):
    clock, rows = SimulatedClock(104.0), [2]

    def grows():
        if clock.now() >= 104.6:
            rows[0] = 4
        return strut_history[0][: rows[0]], strut_history[1][: rows[0]]

    shown = emulated_camera_images_sensors_and_server_process.EmulatedCameras(secret, Images(Sensor()), 1, grows, clock)
    np.testing.assert_allclose(
        shown.pose(104.0),
        emulated_camera_images_sensors_and_server_process.EmulatedCameras(
            secret, Images(Sensor()), 1, lambda: strut_history, clock
        ).pose(104.0),
        atol=1e-12,
    )
    assert clock.now() >= 104.6
    with pytest.raises(RigError, match="no further for 20 s"):
        shown.pose(106.0)


def test_history_is_read_as_it_grows_and_standing_takes_no_room(tmp_path):
    path = tmp_path / "history.csv"
    path.write_text("t,l1,l2\n")
    strut_history = emulated_camera_images_sensors_and_server_process.HistoryFromFile(path)
    with pytest.raises(RigError, match="does not yet state"):
        strut_history()
    with open(path, "a") as file:
        file.write("1.0,0.4,0.4\n2.0,0.4,0.4\n3.0,0.4,0.4\n4.0,0.5,")
        file.flush()
        assert strut_history()[0].tolist() == [1.0, 3.0]
        file.write("0.4\n")
        file.flush()
    t, lengths = strut_history()
    assert t.tolist() == [1.0, 3.0, 4.0] and lengths[-1].tolist() == [0.5, 0.4]


def test_measuring_limbs_read_the_pose(design, strut_history, tmp_path):
    from rig.formats.rig_toml import design_from_rig_toml
    from rig.planning.layout import hexapod_layout_and_camera_placement

    (tmp_path / "rig.toml").write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, 6)))
    secret = random_true_machine_and_truth_file.random_true_machine(
        design_from_rig_toml.load_design(tmp_path / "rig.toml"), np.random.default_rng(3)
    )
    shown = emulated_camera_images_sensors_and_server_process.EmulatedCameras(
        secret, Images(Sensor()), 1, lambda: strut_history, SimulatedClock(105.0)
    )
    limbs, T = secret.true.insitu, shown.pose(105.0)
    legs = limbs.platform_joints @ T[:3, :3].T + T[:3, 3] - limbs.base_joints
    read = shown.sensors(105.0)
    np.testing.assert_allclose(
        [read[f"m{i}"] for i in range(1, 7)], np.linalg.norm(legs, axis=1) - limbs.zeros, atol=6e-6
    )
    assert 15 < read["ambient_temperature_C"] < 25


@pytest.mark.slow
def test_every_picture_is_of_its_own_moment(secret, strut_history, opengl):
    small = tuple(
        replace(c, width=160, height=128, matrix=c.matrix * [[1 / 8], [1 / 8], [1]]) for c in secret.true.cameras
    )
    shown = emulated_camera_images_sensors_and_server_process.EmulatedCameras(
        replace(secret, true=replace(secret.true, cameras=small)),
        Images(Sensor()),
        1,
        lambda: strut_history,
        SimulatedClock(105.0),
    )
    home, away, second_away, back = (shown.image("cam0", t, 0.01).astype(int) for t in (100.5, 103.0, 103.0, 100.5))
    assert np.abs(home - away).max() > 50
    assert np.abs(away - second_away).max() == 0 and np.abs(home - back).max() == 0


def test_cameras_answer_over_tcp_brighter_with_longer_exposures(secret, strut_history, opengl):
    small = tuple(
        replace(c, width=160, height=128, matrix=c.matrix * [[1 / 8], [1 / 8], [1]]) for c in secret.true.cameras
    )
    secret = replace(secret, true=replace(secret.true, cameras=small))
    clock, going = SystemClock(), [True]
    now = clock.now()
    server = emulated_camera_images_sensors_and_server_process.CameraServer(
        emulated_camera_images_sensors_and_server_process.EmulatedCameras(
            secret, Images(Sensor(bits=12)), 1, lambda: (strut_history[0] - 105.0 + now + 3600, strut_history[1]), clock
        ),
        ("127.0.0.1", 0),
        clock,
    )
    requested = replace(small[1], source=f"emulator:{server.name}")
    got, done = {}, threading.Event()

    def ask():
        try:
            source = open_camera(requested, clock)
            for seconds in (0.005, 0.01):
                source.set_exposure(seconds)
                before = clock.now()
                got[seconds] = source.grab()
                assert before <= got[seconds].t <= clock.now()
            stranger = open_camera(replace(requested, name="cam9"), clock)
            with pytest.raises(CameraError, match="no camera 'cam9'"):
                stranger.grab()
            for one in (source, stranger):
                one.close()
            done.set()
        finally:
            going[0] = False

    thread = threading.Thread(target=ask)
    thread.start()
    server.serve(lambda: going[0])
    thread.join()
    server.close()
    assert done.is_set() and got[0.01].image.shape == (128, 160) and got[0.01].image.dtype == np.uint16
    assert 1.7 < got[0.01].image.mean() / got[0.005].image.mean() < 2.1
