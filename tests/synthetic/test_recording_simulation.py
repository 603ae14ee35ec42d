"""Simulated recordings: what is written is what the machine did, hidden markers stay hidden, and truth stays apart."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import FileError, RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.design import Sensor
from rig.model.pose import pose_difference
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from synthetic import (
    ideal_image_renderer,
    image_simulation,
    random_true_machine_and_truth_file,
    recording_simulation,
    rig_meshes,
)
from synthetic.marker_drawing_sensor_and_occlusion import is_occluded
from tests.conftest import SHARED
from vision.marker_corner_prediction import marker_map
from vision.reading.corner_reading_from_recording_images import read_corners_of_all_images


@pytest.fixture(scope="module")
def done(design):
    rng = np.random.default_rng(4)
    return recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(
            design, rng, 1.0, (parse_effect("backlash:strut2:gap=5e-5"),)
        ),
        plan.build_plan(design, "sobol:8,moving:6"),
        rng,
    )


def test_what_is_written_is_read_back(done, tmp_path, rig_text):
    recording_simulation.write_recording(done, tmp_path / "rec", rig_text, np.random.default_rng(0), noise=0.0)
    found = recording_folder.load_recording(tmp_path / "rec")
    simulated = motion_simulation.simulate_machine_run(
        done.world.true, found.commands, found.exposures.times()[1], done.world.effects, found.sensors
    )
    np.testing.assert_allclose(pose_difference(simulated.T_base_platform, done.run.T_base_platform), 0, atol=1e-9)
    assert {"ambient_temperature_C", "strut6_temperature_C", "payload_mass_kg"} <= set(found.sensors.channels)
    assert len(found.corners.uv) > 14 * 3 * 4 * 6
    recording_simulation.write_recording(done, tmp_path / "noisy", rig_text, np.random.default_rng(0), noise=0.1)
    gap = recording_folder.load_recording(tmp_path / "noisy").corners.uv - found.corners.uv
    assert np.std(gap) == pytest.approx(0.1, rel=0.05)


def test_truth_makes_the_same_machine_again(done, tmp_path, design):
    random_true_machine_and_truth_file.write_truth(tmp_path / "t.json", done.world, done.run.T_base_platform)
    reloaded = random_true_machine_and_truth_file.load_world_from_truth_file(tmp_path / "t.json", design)
    assert reloaded.effects == done.world.effects
    T = motion_simulation.simulate_machine_run(
        reloaded.true, done.plan.commands, done.plan.t, reloaded.effects, done.sensors
    ).T_base_platform
    np.testing.assert_allclose(pose_difference(T, done.run.T_base_platform), 0, atol=1e-12)
    tree = json.loads((tmp_path / "t.json").read_text())
    assert len(tree["poses"][0]) == 16 and tree["effects"][0] == {
        "effect": "backlash",
        "place": "strut 2",
        "parameters": {"gap": 5e-5},
    }
    (tmp_path / "half.json").write_text((tmp_path / "t.json").read_text()[:300])
    with pytest.raises(FileError, match="cut off"):
        random_true_machine_and_truth_file.load_world_from_truth_file(tmp_path / "half.json", design)


def test_same_seed_same_recording(design, tmp_path, rig_text):
    texts = []
    for name in "ab":
        rng = np.random.default_rng(9)
        s = recording_simulation.simulate_world(
            random_true_machine_and_truth_file.random_true_machine(design, rng),
            plan.build_plan(design, "sobol:3", 9),
            rng,
        )
        recording_simulation.write_recording(s, tmp_path / name, rig_text, rng, noise=0.05)
        texts.append([path.read_bytes() for path in sorted((tmp_path / name).iterdir())])
    assert texts[0] == texts[1]


def test_what_is_hidden_is_hidden_by_solids(design):
    home = RigidTransform.concatenate([design.mechanism.home])
    m, zero = design.mechanism, np.zeros(1, int)
    middle = (m.base_joints[0] + m.home.apply(m.platform_joints[0])) / 2
    away = np.cross(m.home.apply(m.platform_joints[0]) - m.base_joints[0], [0, 0, 1.0])
    away /= np.linalg.norm(away)

    def blocked(eye, point):
        return bool(is_occluded(design, [home], zero, np.array([eye], float), np.array([point], float))[0])

    assert blocked(middle + 0.5 * away, middle - 0.05 * away)  # through the strut
    assert not blocked(middle + 0.5 * away, middle + 0.05 * away)
    assert blocked([0, 0, 2.0], [0, 0, 0.2]) and not blocked([0, 0, 2.0], [0, 0, 0.6])  # through the platform's plate
    cube = design.targets[0]
    centre = (m.home * cube.pose).translation
    assert blocked(centre + [0, 0, 0.5], centre) and not blocked(centre + [0, 0, 0.5], centre + [0, 0, cube.edge / 2])
    assert blocked([0, 0, -0.5], [0.1, 0, 0.1])  # through the base


@pytest.mark.slow
def test_corners_of_a_picture_are_those_of_the_simulation(design, rig_text, tmp_path, opengl):
    rng = np.random.default_rng(2)
    s = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng), plan.build_plan(design, "sobol:1"), rng
    )
    recording_simulation.write_recording(
        s,
        tmp_path / "rec",
        rig_text,
        rng,
        images=image_simulation.Images(Sensor(blur=0.5, read_noise=0.5), "cluttered", processes=1),
    )
    found = read_corners_of_all_images(recording_folder.load_recording(tmp_path / "rec"), marker_map(design)).corners
    true = {tuple(row[:4]): row[4:] for row in recording_simulation.true_corner_rows(s)}
    keys = list(zip(found.frame.tolist(), found.camera, found.marker.tolist(), found.corner.tolist()))
    errors = np.array([uv - true[key] for key, uv in zip(keys, found.uv) if key in true])
    assert len(errors) > 0.9 * len(true) and np.sqrt(np.mean(errors**2)) < 0.03
    assert (np.linalg.norm(errors, axis=1) > 0.5).mean() < 0.01


@pytest.mark.slow
def test_a_picture_in_motion_is_the_mean_of_its_moments(design, tmp_path, opengl):
    rng = np.random.default_rng(3)
    s = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng), plan.build_plan(design, "moving:1"), rng
    )
    images = image_simulation.Images(Sensor(exposure=0.1, exposures=3), processes=1)
    image_simulation._start(s, tmp_path, images, 5)
    image_simulation._prepare()
    try:
        exposures = image_simulation._state["exposures"]
        assert [round(shift, 4) for shift, _ in exposures] == [-0.0333, 0.0, 0.0333]
        moments = [image_simulation._picture(design.cameras[0], 0, 0, shift, T[0]) for shift, T in exposures]
        assert np.abs(moments[0] - moments[2]).max() > 0.05
        rolling = replace(design.cameras[0], shutter="rolling", row_time=3e-5)
        image_simulation._state["design"] = replace(
            image_simulation._state["design"], cameras=(rolling, *image_simulation._state["design"].cameras[1:])
        )
        T = [exposures[1][1][0][0]]
        rolled = image_simulation._picture(rolling, 0, 0, 0.0, T)
        for row in (0, 512, 1023):  # every row is that of a picture taken at its own moment
            late = (row - 512) * 3e-5
            then = [T[0] for T in s.at_times(np.array([s.plan.t[0] + late]))]
            fine = row * ideal_image_renderer.SAMPLES
            np.testing.assert_allclose(
                rolled[fine], image_simulation._view(rolling, s.plan.t[0] + late, then)[fine], atol=0.02
            )
        assert np.abs(rolled - image_simulation._view(rolling, s.plan.t[0], T)).max() > 0.01
    finally:
        image_simulation._state.pop("renderer").close()


def test_effects_that_cannot_be_drawn_are_refused():
    with pytest.raises(RigError, match="edge_bias is not drawn"):
        image_simulation.require_renderable([parse_effect("edge_bias:cameras:bias=0.1")])
    with pytest.raises(RigError, match="marker_flatness is not drawn"):
        image_simulation.require_renderable([parse_effect("marker_flatness:4:height=1e-3")])
    image_simulation.require_renderable(
        [parse_effect("camera_bump:cam1:motion=1e-4/0/0/0/0/0,time=3"), parse_effect("backlash:1:gap=1e-5")]
    )


def test_scene_has_everything(design):
    parts = rig_meshes.rig_and_background_meshes(design)
    bodies = {part.body for part in parts}
    assert {"base", "platform", "world"} <= bodies and sum(body.startswith("strut") for body in bodies) == 12
    assert sum(part.ink is not None for part in parts) == 40
    with pytest.raises(ValueError, match="background"):
        rig_meshes.rig_and_background_meshes(design, "nice")


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the shared recordings beside the project")
@pytest.mark.parametrize("name", ["open-quiet", "open-backlash", "open-compliance", "open-two"])
def test_our_machine_moves_as_the_shared_recordings_did(name):
    """The conventions of signs, starts and forces are those of an independent simulator."""
    found = recording_folder.load_recording(SHARED / "recordings" / name)
    truth = json.loads((SHARED / "truth" / f"{name}.json").read_text())
    mechanism = replace(
        found.design.mechanism, **{key: truth[key] for key in ("base_joints", "platform_joints", "strut_zeros")}
    )
    effects = [
        parse_effect(f"{e['effect']}:{e['place']}:" + ",".join(f"{k}={v}" for k, v in e["parameters"].items()))
        for e in truth["effects"]
        if e["parameters"]
    ]
    T = motion_simulation.simulate_machine_run(
        replace(found.design, mechanism=mechanism), found.commands, found.exposures.times()[1], effects, found.sensors
    ).T_base_platform
    errors = pose_difference(T, RigidTransform.from_matrix(np.array(truth["poses"]).reshape(-1, 4, 4)))
    assert np.abs(errors[:, :3]).max() < 3e-7 and np.abs(errors[:, 3:]).max() < 1.5e-6  # commands are written to 1e-7 m
