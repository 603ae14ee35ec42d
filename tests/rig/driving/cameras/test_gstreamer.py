"""GStreamer pipelines through an OpenCV that has it: fresh frames and their times, formats, failures that are named.

GSTREAMER_PYTHON=PROGRAM names an interpreter whose OpenCV has GStreamer and that can import rig; by default it is the
one that runs the tests. docs/cameras.md states how to get one.
"""

import json
import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT

WIDTH, HEIGHT = 160, 120
LIVE = "videotestsrc is-live=true"
ROWS = f"width={WIDTH},height={HEIGHT},framerate=20/1"


PROGRAM = ROOT / "tests" / "rig" / "driving" / "cameras" / "gstreamer_exposures.py"


@pytest.fixture(scope="module")
def python():
    """An interpreter whose OpenCV has GStreamer."""
    program = os.environ.get("GSTREAMER_PYTHON", sys.executable)
    probe = "import cv2; print(cv2.__version__, cv2.videoio_registry.hasBackend(cv2.CAP_GSTREAMER))"
    done = subprocess.run([program, "-c", probe], capture_output=True, text=True)
    if not done.stdout.endswith(" True\n"):
        pytest.skip(
            f"OpenCV {done.stdout.split()[0]} of {program} has no GStreamer; GSTREAMER_PYTHON names one that has"
            if done.stdout
            else f"{program} has no OpenCV: {done.stderr.strip()[-200:]}"
        )
    return program


def exposures(python, pipeline, size=(WIDTH, HEIGHT)):
    done = subprocess.run(
        [python, PROGRAM, pipeline, *map(str, size)],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert not done.returncode, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pipeline", "dtype", "depth"),
    [
        (f"{LIVE} pattern=red ! video/x-raw,format=BGR,{ROWS} ! appsink", "uint8", 3),
        (f"{LIVE} pattern=red ! video/x-raw,format=NV12,{ROWS} ! videoconvert ! appsink drop=true", "uint8", 3),
        (f"{LIVE} pattern=red ! video/x-bayer,format=gbrg,{ROWS} ! bayer2rgb ! videoconvert ! appsink", "uint8", 3),
        (f"{LIVE} pattern=white ! video/x-raw,format=GRAY8,{ROWS} ! appsink", "uint8", 1),
        (f"{LIVE} pattern=white ! video/x-raw,format=GRAY16_LE,{ROWS} ! appsink", "uint16", 1),
        (f"videotestsrc pattern=red ! video/x-raw,format=BGR,{ROWS} ! appsink", "uint8", 3),
    ],
)
def test_frames_are_fresh_and_of_the_right_colour_in_every_format(python, pipeline, dtype, depth):
    found = exposures(python, pipeline)
    assert found.get("error") is None and not found["settable"]
    for row in found["rows"]:
        assert row["dtype"] == dtype and row["shape"] == [HEIGHT, WIDTH, 3][: 3 if depth == 3 else 2]
        assert row["asked"] <= row["t"] <= row["came"] and 0 < row["sigma"] < 0.1
        if depth == 3:
            blue, green, red = row["colour"]
            assert red > 240 and blue < 15 and green < 15
        else:
            assert row["colour"][0] > 0.9 * (255 if dtype == "uint8" else 65535)  # white of video is 235


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pipeline", "size", "says"),
    [
        ("nosuchsrc ! videoconvert ! appsink", (WIDTH, HEIGHT), "`gst-launch-1.0 nosuchsrc ! videoconvert ! fakesink`"),
        ("videotestsrc bogus=1 ! appsink", (WIDTH, HEIGHT), "cannot be opened; `gst-launch-1.0 videotestsrc bogus=1 !"),
        ("v4l2src device=/dev/video77 ! videoconvert ! appsink", (WIDTH, HEIGHT), "cannot be opened"),
        (f"{LIVE} ! video/x-raw,format=RGB,{ROWS} ! appsink", (WIDTH, HEIGHT), "cannot be opened"),
        (f"{LIVE} ! video/x-raw,format=YUY2,{ROWS} ! appsink", (WIDTH, HEIGHT), "gives 2 values for each pixel"),
        (f"{LIVE} ! video/x-bayer,format=rggb,{ROWS} ! appsink", (WIDTH, HEIGHT), "sends a mosaic of colours"),
        (f"{LIVE} ! video/x-raw,format=BGR,{ROWS} ! appsink", (64, 48), "gives 160 x 120 px, but rig.toml has 64 x 48"),
        (f"{LIVE} num-buffers=3 ! video/x-raw,format=BGR,{ROWS} ! appsink", (WIDTH, HEIGHT), "gives no frame"),
        ("udpsrc port=50123 ! jpegdec ! videoconvert ! appsink", (WIDTH, HEIGHT), "cannot be opened|gives no frame"),
    ],
)
def test_a_pipeline_that_gives_no_images_is_named_in_time(python, pipeline, size, says):
    found = exposures(python, pipeline, size)
    assert found["error"].startswith("camera 'cam0'") and found["took"] < 20
    assert any(one in found["error"] for one in says.split("|"))
