"""Exposures of a GStreamer pipeline as JSON, for an interpreter whose OpenCV has GStreamer: PIPELINE WIDTH HEIGHT."""

import json
import sys

import numpy as np

from rig.driving.cameras import CameraError, open_camera
from rig.driving.driving_clock import SystemClock
from rig.model.design import Camera
from rig.model.pose import pose


def exposures(pipeline, size, count=4, pause=0.33):
    clock, rows = SystemClock(), []
    camera = Camera("cam0", *size, np.eye(3), np.zeros(5), pose([0, 0, 0], [0, 0, 0]), source=f"gstreamer:{pipeline}")
    began = clock.now()
    try:
        source = open_camera(camera, clock)
        for _ in range(count):
            clock.sleep(pause)
            asked = clock.now()
            frame = source.grab()
            row = {"asked": asked, "t": frame.t, "sigma": frame.t_sigma, "came": clock.now()}
            colour = frame.image.reshape(*size[::-1], -1).mean((0, 1)).tolist()
            rows.append({**row, "dtype": str(frame.image.dtype), "shape": frame.image.shape, "colour": colour})
        source.close()
    except CameraError as error:
        return {"error": str(error), "took": clock.now() - began, "rows": rows}
    return {"settable": source.can_set_exposure, "rows": rows}


print(json.dumps(exposures(sys.argv[1], (int(sys.argv[2]), int(sys.argv[3])))))
