"""A recording measured as it grows: poses at once, cameras adjusted beside, and what that came to from the next frame on."""

import threading
from concurrent.futures import wait

import numpy as np
import pytest

from rig import recording
from vision.reading import live as module
from vision.reading.collect import read_image
from vision.reading.live import TAUGHT, Live

ALL = "tests/data/bench/fit"


@pytest.fixture(scope="module")
def frames():
    """Design, and {camera: image} of a recording's first frames."""
    read = recording.load(ALL)
    e = read.exposures
    return read.design, [{camera: read_image(read.folder / image) for f, camera, image in zip(e.frame.tolist(), e.camera, e.image) if f == frame}
                         for frame in range(TAUGHT[0] + 3)]


def test_frames_do_not_wait_for_the_cameras_to_be_adjusted(frames, monkeypatch):
    design, images = frames
    gate, measure = threading.Event(), module.measure
    monkeypatch.setattr(module, "measure", lambda *arguments: gate.wait(60) and measure(*arguments))
    live, sights = Live(design), []

    def take(frame):
        sights.append(live.take(frame, images[frame], sights[-1].T_base_platform if sights else None))
        live.adjust()

    for frame in range(TAUGHT[0] + 2):  # the last two while they are being adjusted
        take(frame)
    assert all(sight.T_base_platform is not None and sight.covariance is None for sight in sights) and live.noise is None
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
    monkeypatch.setattr(module, "measure", lambda *arguments: 1 / 0)
    live = Live(design)
    for frame in range(TAUGHT[0]):
        live.take(frame, images[0])
        live.adjust()
    wait([live._adjusting])
    with pytest.raises(ZeroDivisionError):
        live.take(TAUGHT[0], images[0])
    assert live.take(TAUGHT[0], images[0]).T_base_platform is not None  # said once; the cameras stay as they were
    live.close()
