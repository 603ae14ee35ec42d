"""What is done with cameras' frames: a grab that failed is retried, exposure is set, rest is waited for."""

import numpy as np
import pytest

from rig.driving import driver_opening_and_settling
from rig.driving.cameras import CameraError
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    Frame,
    SynchronisedCameras,
    set_marker_exposure_and_measure_white,
)
from rig.driving.driver_opening_and_settling import NotSettled, image_difference_relative_to_noise, parse_settling
from rig.errors import RigError
from tests.rig.simulated_clock import SIZE, Ticking


class Flaky:
    name, can_set_exposure = "cam0", True

    def __init__(self, clock, fails, white=40.0):
        self.clock, self.fails, self.white, self.exposure, self.closed = clock, fails, white, 1e-3, False

    def grab(self):
        self.clock.sleep(0.01)
        if self.fails:
            self.fails -= 1
            raise CameraError("camera 'cam0' gives no frame")
        return Frame(np.full(SIZE[::-1], min(255, self.white * self.exposure / 1e-3), np.uint8), self.clock.now(), 1e-3)

    def set_exposure(self, seconds):
        self.exposure = max(round(seconds, 4), 1e-4)
        return self.exposure

    def close(self):
        self.closed = True


def test_a_grab_that_failed_is_tried_again_and_then_named():
    clock = Ticking()
    shutter = SynchronisedCameras((Flaky(clock, 2),), clock)
    assert set(shutter.grab()) == {"cam0"} and len(shutter.retried) == 2
    shutter.close()
    assert shutter.sources[0].closed
    with pytest.raises(CameraError, match="gives no frame"):
        SynchronisedCameras((Flaky(clock, 3),), clock).grab()


@pytest.mark.parametrize("white", [3.0, 40.0, 400.0, 2000.0])
def test_exposure_brings_white_up_and_never_clips(white):
    source = Flaky(Ticking(), 0, white)
    exposure, level = set_marker_exposure_and_measure_white(
        source, lambda image: (float(image.max()), float((image >= 250).mean())), 1e-3
    )
    assert 150 <= level < 250 and exposure == source.exposure
    with pytest.raises(CameraError, match="change the light"):
        set_marker_exposure_and_measure_white(
            Flaky(Ticking(), 0, 1e5), lambda image: (float(image.max()), float((image >= 250).mean())), 1e-3
        )


def test_rest_is_told_by_images_from_motion_under_noise():
    rng = np.random.default_rng(5)
    scene = np.kron(rng.uniform(40, 210, (60, 80)), np.ones((8, 8)))

    def image(shift, noise=2.0):
        return np.clip(np.roll(scene, shift, axis=1) + noise * rng.normal(size=scene.shape), 0, 255).astype(np.uint8)

    assert all(image_difference_relative_to_noise(image(0), image(0)) < 1 for _ in range(20))
    moved = scene.copy()
    moved[200:240, 300:340] = np.roll(scene, 1, axis=1)[200:240, 300:340]  # a marker alone, by a pixel
    assert (
        image_difference_relative_to_noise(
            image(0), np.clip(moved + 2 * rng.normal(size=scene.shape), 0, 255).astype(np.uint8)
        )
        > 1
    )
    assert image_difference_relative_to_noise(image(0), image(3)) > 1
    clock, shifts = Ticking(), iter([9, 5, 2, 1] + [0] * 20)
    moments = []

    def look():
        clock.sleep(0.1)
        moments.append(next(shifts))
        return [image(moments[-1])]

    parse_settling("images").wait(clock, images=look)
    assert moments[-3:] == [0, 0, 0] and len(moments) == 7
    with pytest.raises(NotSettled, match="still change"):
        parse_settling("images").wait(clock, images=lambda: (clock.sleep(0.5), [image(int(rng.integers(1, 90)))])[1])


def test_rest_is_told_by_limbs_and_by_time():
    clock = Ticking()
    parse_settling("time:1.5").wait(clock)
    assert clock.now() == 1001.5
    parse_settling("limbs:1e-6").wait(
        clock, limbs=lambda: np.full(6, 0.4 + 1e-3 * np.exp(-(clock.now() - 1001.5) / 0.1))
    )
    assert 0.5 < clock.now() - 1001.5 < 1.5
    with pytest.raises(NotSettled, match="limb 3 still moves"):
        parse_settling("limbs:1e-6").wait(clock, limbs=lambda: 0.4 + 1e-4 * np.sin(clock.now() * 9) * np.eye(6)[2])
    for text in ("time:-1", "time:x", "images:3", "speed:1", "limbs:inf"):
        with pytest.raises(RigError, match="settling takes"):
            parse_settling(text)
    assert driver_opening_and_settling.MOST < 60
