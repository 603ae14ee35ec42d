"""A recording measured as it grows: poses at once, cameras adjusted beside, and what that came to from the next frame
on.
"""

import threading
from concurrent.futures import wait

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.driving.cameras.camera_opening_with_folder_and_emulator_sources import USUAL
from rig.driving.driving_clock import SimulatedClock
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Sensor
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import sobol_configurations
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file
from synthetic.emulated_camera_images_sensors_and_server_process import EmulatedCameras
from synthetic.image_simulation import Images
from tests.vision import camera_on_platform
from vision.reading import live_measurement_and_corner_refit as module
from vision.reading.corner_reading_from_recording_images import read_grey_or_colour_image
from vision.reading.live_measurement_and_corner_refit import TAUGHT, Live

ALL = "tests/data/bench/fit"


@pytest.fixture(scope="module")
def frames():
    """Design, and {camera: image} of a recording's first frames."""
    read = recording_folder.load_recording(ALL)
    e = read.exposures
    return read.design, [
        {
            camera: read_grey_or_colour_image(read.folder / image)
            for f, camera, image in zip(e.frame.tolist(), e.camera, e.image)
            if f == frame
        }
        for frame in range(TAUGHT[0] + 3)
    ]


def test_frames_do_not_wait_for_the_cameras_to_be_adjusted(frames, monkeypatch):
    design, images = frames
    gate, measure = threading.Event(), module.measure_observations
    monkeypatch.setattr(module, "measure_observations", lambda *arguments: gate.wait(60) and measure(*arguments))
    live, sights = Live(design), []

    def take(frame):
        sights.append(live.take(frame, images[frame], sights[-1].T_base_platform if sights else None))
        live.adjust()

    for frame in range(TAUGHT[0] + 2):  # the last two while they are being adjusted
        take(frame)
    assert (
        all(sight.T_base_platform is not None and sight.covariance is None for sight in sights) and live.noise is None
    )
    stated = live.cameras
    gate.set()
    wait([live._adjusting])
    take(TAUGHT[0] + 2)
    live.close()
    last = sights[-1]
    assert last.covariance is not None and live.noise < 0.1 and live.cameras is not stated
    assert np.sqrt(np.nanmean(last.residuals[last.inliers] ** 2)) < 0.1


def test_a_mistake_made_while_adjusting_is_raised(frames, monkeypatch):
    design, images = frames
    monkeypatch.setattr(module, "measure_observations", lambda *arguments: 1 / 0)
    live = Live(design)
    for frame in range(TAUGHT[0]):
        live.take(frame, images[0])
        live.adjust()
    wait([live._adjusting])
    with pytest.raises(ZeroDivisionError):
        live.take(TAUGHT[0], images[0])
    assert live.take(TAUGHT[0], images[0]).T_base_platform is not None  # said once; the cameras stay as they were
    live.close()


@pytest.mark.slow
def test_the_base_is_seen_from_the_platform_while_a_run_goes_on(tmp_path, opengl):
    """Through the emulator's eyes: a camera that the platform carries, drawn as the struts stand, and where the
    platform is told by what it sees.
    """
    (tmp_path / "rig.toml").write_text(camera_on_platform.text())
    design = design_from_rig_toml.load_design(tmp_path / "rig.toml")
    secret, strokes = (
        random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(2)),
        design.mechanism.strut_range,
    )
    goals = sobol_configurations(strokes, TAUGHT[0] + 4, 0.5, 1)
    t = 10.0 * np.arange(len(goals) + 1)
    sensor = Sensor(blur=0.6, read_noise=1.5, electrons=8000.0)
    cameras = EmulatedCameras(
        secret,
        Images(sensor),
        1,
        lambda: (np.repeat(t, 2)[1:-1] + np.tile([0, 5.0], len(goals)), np.repeat(goals, 2, axis=0)),
        SimulatedClock(t[-1]),
    )
    live, sights, true = Live(design), [], []
    for k, goal in enumerate(goals):
        T = RigidTransform.from_matrix(cameras.pose(t[k] + 4.0))
        sights.append(
            live.take(k, {"cam0": cameras.image("cam0", t[k] + 4.0, USUAL)}, hexapod.forward(goal, design.mechanism))
        )
        live.adjust()
        true.append(T)
        if live._adjusting is not None:
            wait([live._adjusting])
    live.close()
    held = (
        secret.true.cameras[0].pose * design.cameras[0].pose.inv()
    )  # the platform's frame is fixed by the camera's stated pose
    last = slice(TAUGHT[0], None)
    off = np.array([pose_difference(a * held, b.T_base_platform) for a, b in zip(true[last], sights[last])])
    covariance = np.array([sight.covariance for sight in sights[last]])
    z = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)
    assert np.abs(off[:, :3]).max() < 1e-4 and np.abs(off[:, 3:]).max() < 2e-4 and z.mean() < 2 * 6
    shared = np.abs(off.mean(axis=0)) / np.sqrt(np.einsum("nii->ni", covariance)).mean(axis=0)
    assert (shared < 1).all()  # first images that stay as the stated lens placed them: 1.4
    for sight in sights[last]:  # markers that ought to be seen, struts aside, are
        ought, read = set(sight.expected["cam0"]), set(sight.detections["cam0"].marker.tolist())
        assert len(ought) >= 6 and len(ought & read) > 0.6 * len(ought)
