"""Image sensor: grey levels from radiance by optics, vignetting, shot and read noise, quantisation (EMVA 1288)."""

from functools import lru_cache
from typing import cast

import cv2
import numpy as np

from rig.array_types import Floats
from rig.model.design import Sensor

KEPT = 4  # of what the last cameras' optics do; a falloff is as large as a picture
BLACK = 4.0  # grey level of no light, so that noise is not cut off


def expose_image(radiance: Floats, sensor: Sensor, rng: np.random.Generator, samples: int = 1) -> Floats:
    """Image (height, width) uint8 or uint16 exposed by a sensor to a radiance 0..1.

    sensor : rig.model.design.Sensor; rng : numpy Generator; samples : of the radiance to the pixel each way. Optics act
    on the finer picture, before pixels take their means: a blur that steps from pixel to pixel has corners of its own.
        The variance of a
    pixel is read_noise^2 + light / electrons, in grey levels of 255, before it is rounded (EMVA Standard 1288, the
    linear camera model).
    """
    if sensor.defocus:
        radiance = cast(
            Floats, cv2.filter2D(radiance, cv2.CV_32F, _disc(sensor.defocus * samples), borderType=cv2.BORDER_REPLICATE)
        )
    if sensor.blur:
        radiance = cast(Floats, cv2.GaussianBlur(radiance, (0, 0), sensor.blur * samples))
    if samples > 1:
        radiance = cast(
            Floats, cv2.resize(radiance, None, fx=1 / samples, fy=1 / samples, interpolation=cv2.INTER_AREA)
        )
    light = sensor.gain * radiance
    if sensor.vignetting:
        light = light * _falloff(radiance.shape, sensor.vignetting)
    grey = light + np.float32(BLACK)
    if sensor.read_noise or sensor.electrons:
        noise = rng.standard_normal(grey.shape, dtype=np.float32)
        if sensor.electrons:
            noise *= np.sqrt(np.float32(sensor.read_noise**2) + light / np.float32(sensor.electrons))
        else:
            noise *= np.float32(sensor.read_noise)
        grey = grey + noise
    top = 2**sensor.bits - 1
    return np.clip(np.rint(grey * np.float32(top / 255)), 0, top).astype(np.uint8 if sensor.bits == 8 else np.uint16)


@lru_cache(KEPT)
def _disc(radius: float) -> Floats:
    """A uniform disc of a radius (px), each pixel weighted by the part of it that the disc covers: one pixel alone
    where it is a point.
    """
    reach, fine = int(np.ceil(radius + 0.5)), 17  # odd, so that the middle is looked at: the smallest disc covers that
    at = (np.arange((2 * reach + 1) * fine) + 0.5) / fine - reach - 0.5
    inside = (at[:, None] ** 2 + at**2 <= radius**2).astype(np.float32)
    kernel = inside.reshape(2 * reach + 1, fine, 2 * reach + 1, fine).mean(axis=(1, 3))
    return kernel / kernel.sum()


@lru_cache(KEPT)
def _falloff(shape: tuple[int, ...], lost: float) -> Floats:
    """(height, width) share of the light that arrives: 1 in the middle, 1 - lost in the corners, with the square of the
    radius.
    """
    v, u = (np.linspace(-1, 1, n, dtype=np.float32) for n in shape)
    return cast(Floats, 1 - np.float32(lost / 2) * (v[:, None] ** 2 + u**2))
