"""The sensor: nothing by default, noise of the stated variance, light where it belongs."""

import tracemalloc

import numpy as np
import pytest

from rig.model.design import Sensor
from synthetic.marker_drawing_sensor_and_occlusion import BLACK, simulate_sensor_exposure

FLAT = np.full((200, 300), 0.5, np.float32)


def test_by_default_it_only_quantises():
    image = simulate_sensor_exposure(FLAT, Sensor(), np.random.default_rng(0))
    assert image.dtype == np.uint8 and (image == round(BLACK + 115)).all()


def test_twelve_bits_are_sixteen_times_finer():
    image = simulate_sensor_exposure(FLAT, Sensor(bits=12), np.random.default_rng(0))
    assert image.dtype == np.uint16 and image.max() < 4096 and image[0, 0] == round((BLACK + 115) * 4095 / 255)


@pytest.mark.parametrize("read, electrons", [(2.0, 0.0), (0.0, 20.0), (1.5, 40.0)])
def test_noise_has_the_stated_variance(read, electrons):
    rng = np.random.default_rng(1)
    for light in (0.1, 0.8):
        image = simulate_sensor_exposure(
            np.full((400, 400), light, np.float32), Sensor(read_noise=read, electrons=electrons, bits=12), rng
        ) * (255 / 4095)
        expected = read**2 + (230 * light / electrons if electrons else 0)
        assert image.var() == pytest.approx(expected, rel=0.03) and image.mean() == pytest.approx(
            BLACK + 230 * light, abs=0.05
        )


def test_blur_and_defocus_spread_a_point_and_keep_its_light():
    point = np.zeros((61, 61), np.float32)
    point[30, 30] = 1.0
    for sensor in (Sensor(blur=1.5, bits=12, gain=3000), Sensor(defocus=3.0, bits=12, gain=3000)):
        image = simulate_sensor_exposure(point, sensor, np.random.default_rng(0)) * (255 / 4095) - BLACK
        v, u = np.mgrid[:61, :61] - 30
        light = np.clip(image, 0.5, None) - 0.5
        spread = np.sqrt((light * (u**2 + v**2)).sum() / light.sum() / 2)
        assert spread == pytest.approx(1.5, rel=0.12)  # a disc of radius 3 has the same second moment as a spot of 1.5
        assert image.sum() == pytest.approx(3000, rel=0.05)


def test_next_to_no_defocus_is_none():
    """A disc smaller than the grid that it is laid out on is a point."""
    picture = np.random.default_rng(2).random((40, 50), dtype=np.float32)
    for radius in (1e-6, 0.005, 0.02, 0.1):
        image = simulate_sensor_exposure(picture, Sensor(defocus=radius), np.random.default_rng(0), samples=2)
        assert (
            np.abs(
                image.astype(int) - simulate_sensor_exposure(picture, Sensor(), np.random.default_rng(0), samples=2)
            ).max()
            <= 1
        )


def test_vignetting_takes_its_share_from_the_corners():
    image = (
        simulate_sensor_exposure(
            np.ones((401, 401), np.float32), Sensor(vignetting=0.4, bits=12), np.random.default_rng(0)
        )
        * (255 / 4095)
        - BLACK
    )
    assert image[200, 200] == pytest.approx(230, abs=0.1) and image[0, 0] == pytest.approx(230 * 0.6, abs=0.1)


def test_of_many_cameras_no_pictures_are_kept():
    """A campaign has a vignetting of its own for every recording: what is kept of it does not grow with their
    number.
    """
    picture = np.full((400, 500), 0.5, np.float32)
    tracemalloc.start()
    try:
        for lost in np.linspace(0.1, 0.3, 40):
            simulate_sensor_exposure(picture, Sensor(vignetting=float(lost)), np.random.default_rng(0))
        allocated, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert allocated < 8 * picture.nbytes
