"""ROS image messages encoded as image files: raw ones as PNG, compressed ones unchanged.

Source: ROS, sensor_msgs/Image, CompressedImage and image_encodings.hpp
"""

from typing import Any

import numpy as np

from rig.arrays import Pixels
from rig.errors import RigError
from rig.formats.input_files import short_repr
from rig.recording.image_file_check import JPEG, PNG

CHANNELS = {
    "mono8": 1,
    "8UC1": 1,
    "mono16": 1,
    "16UC1": 1,
    "bgr8": 3,
    "8UC3": 3,
    "rgb8": 3,
    "bgra8": 4,
    "rgba8": 4,
    "bayer_rggb8": 1,
    "bayer_bggr8": 1,
    "bayer_gbrg8": 1,
    "bayer_grbg8": 1,
}
CONVERTED = {
    "rgb8": "COLOR_RGB2BGR",
    "bgra8": "COLOR_BGRA2BGR",
    "rgba8": "COLOR_RGBA2BGR",
    # OpenCV calls a pattern by the second row's second and third pixel, ROS by the first row's first two
    "bayer_rggb8": "COLOR_BayerBG2GRAY",
    "bayer_bggr8": "COLOR_BayerRG2GRAY",
    "bayer_gbrg8": "COLOR_BayerGR2GRAY",
    "bayer_grbg8": "COLOR_BayerGB2GRAY",
}


def encode_image_message(message: Any, compressed: bool, place: str) -> tuple[str, bytes]:
    """Encode a ROS image message as an image file: (suffix, bytes).
    place : of it, for complaints. Raises RigError for what is not taken, and for half an image.
    """
    if compressed:
        whole = bytes(message.data)
        suffix = next((suffix for mark, suffix in ((PNG, ".png"), (JPEG, ".jpg")) if whole.startswith(mark)), None)
        if suffix is None:
            raise RigError(
                f"{place}: a compressed image of format {short_repr(message.format)}; JPEG and PNG are taken"
            )
        return suffix, whole
    import cv2

    channels, deep = CHANNELS.get(message.encoding), "16" in message.encoding
    if channels is None:
        raise RigError(f"{place}: an image of encoding {short_repr(message.encoding)}; {', '.join(CHANNELS)} are taken")
    wide = message.width * channels * (2 if deep else 1)
    data = np.frombuffer(bytes(message.data), np.uint8)
    if message.step < wide or len(data) < message.step * message.height or not message.height or not wide:
        raise RigError(
            f"{place}: an image of {message.width} x {message.height} px has {len(data)} bytes, in rows of "
            f"{message.step}"
        )
    rows = np.ascontiguousarray(data[: message.step * message.height].reshape(message.height, message.step)[:, :wide])
    pixels: Pixels = rows.reshape(message.height, -1, 1 if deep else channels)
    if deep:
        pixels = rows.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    if message.encoding in CONVERTED:
        pixels = cv2.cvtColor(pixels, getattr(cv2, CONVERTED[message.encoding]))
    done, content = cv2.imencode(".png", pixels)
    if not done:
        raise RigError(f"{place}: an image of {message.width} x {message.height} px cannot be written as PNG")
    return ".png", content.tobytes()
