"""Radiance -> grey levels: blur, exposure, shot and read noise, quantisation."""

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True, slots=True)
class Sensor:
    """blur : px, standard deviation of the optics' spot; white : grey level of radiance 1; black : of radiance 0
    read_noise : grey levels; electrons : per grey level, for shot noise (0 for none); bits : 8 or 12"""

    blur: float = 0.5
    white: float = 230.0
    black: float = 4.0
    read_noise: float = 0.5
    electrons: float = 0.0
    bits: int = 8


def expose(radiance, sensor, rng):
    """(height, width) uint8 or uint16 image of a radiance (height, width) 0..1. rng : numpy Generator."""
    if sensor.blur:
        radiance = cv2.GaussianBlur(radiance, (0, 0), sensor.blur)
    grey = sensor.black + (sensor.white - sensor.black) * radiance
    variance = sensor.read_noise**2 + (np.maximum(grey - sensor.black, 0) / sensor.electrons if sensor.electrons else 0.0)
    noisy = grey + np.sqrt(variance) * rng.standard_normal(grey.shape, dtype=np.float32)
    top = 2**sensor.bits - 1
    scaled = noisy * (top / 255)
    return np.clip(np.rint(scaled), 0, top).astype(np.uint8 if sensor.bits == 8 else np.uint16)
