"""Tries the cameras of a rig.toml, and moves nothing: three images of each with their times; the last one is kept."""

import sys

import cv2

from rig.driving.cameras import open_camera
from rig.driving.driving_clock import SystemClock
from rig.formats.rig_toml.design_from_rig_toml import load_design

clock = SystemClock()
for camera in load_design(sys.argv[1]).cameras:
    source = open_camera(camera, clock)
    try:
        for _ in range(3):
            before = clock.now()
            frame = source.grab()
            came, exposed, known = 1e3 * (clock.now() - before), 1e3 * (frame.t - before), 1e3 * frame.t_sigma
            print(f"{camera.name}: {frame.image.shape} {frame.image.dtype}, mean {frame.image.mean():.0f}, ", end="")
            print(f"exposed {exposed:.1f} +- {known:.1f} ms after the request, there after {came:.1f} ms")
        cv2.imwrite(f"{camera.name}.png", frame.image)
    finally:
        source.close()
