"""ROS messages as image files and table rows.

Raw images are written as PNG, compressed ones unchanged.

Rows are of joints, poses and temperatures.

Source: ROS, sensor_msgs/Image, CompressedImage and image_encodings.hpp
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from rig.array_and_json_types import ImageBytes, Pixels
from rig.errors import FileError, RigError
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.output_files import write_bytes
from rig.recording.exposures_and_image_files import JPEG, PNG

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
JOINTS = ("sensor_msgs/msg/JointState",)
POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
)
TEMPERATURES = ("sensor_msgs/msg/Temperature",)
POSE_HEADER = ("x", "y", "z", "qx", "qy", "qz", "qw")
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


class Stamp(Protocol):
    """A time since 1970: s and ns."""

    sec: int
    nanosec: int


class Header(Protocol):
    """Header of a message."""

    stamp: Stamp


class Point(Protocol):
    """A point, m."""

    x: float
    y: float
    z: float


class Quaternion(Point, Protocol):
    """A rotation, its real part w."""

    w: float


class Body(Protocol):
    """A pose or a transform, each of which has two of these."""

    position: Point
    orientation: Quaternion
    translation: Point
    rotation: Quaternion


class ImageMessage(Protocol):
    """What is read of an Image or CompressedImage, each of which has a part of it.

    data : (bytes,); format : of a compressed one; encoding, width, height : px, step : bytes of a row, is_bigendian :
        of a raw one
    """

    data: ImageBytes
    format: str
    encoding: str
    width: int
    height: int
    step: int
    is_bigendian: bool


class Message(ImageMessage, Protocol):
    """What is read of messages, each type of which has a part of it.

    name, position : of joints, rad or m; temperature : degrees Celsius; transform, pose : of a body, which may stand
        one deeper
    """

    header: Header
    name: list[str]
    position: Sequence[float]
    temperature: float
    transform: Body
    pose: Body


@dataclass(slots=True)
class Topic:
    """What a topic gave. name; kind : message type; header : names of columns; t : ns; rows : texts; stamped : whether
    by its messages' headers.
    """

    name: str
    kind: str
    header: tuple[str, ...] = ()
    t: list[int] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)
    stamped: bool | None = None


def image_file_bytes_and_suffix_of_message(message: ImageMessage, compressed: bool, place: str) -> tuple[str, bytes]:
    """Encode a ROS image message as the bytes of an image file, with its suffix.

    place : of it, for complaints. Raises RigError for what is not taken, and for half an image.
    Returns (suffix, bytes)
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


def append_time_of_ros_message(topic: Topic, message: Message, received: int, file: Path) -> None:
    """Append the time of a ROS message, in ns, to its topic.

    Of its header, or of when it was received where headers are empty.
    Raises FileError where only some messages of a topic are stamped.
    """
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    if topic.stamped is None:
        topic.stamped = stamp != 0
    if topic.stamped != (stamp != 0):
        raise FileError(
            file, f"topic {topic.name}: some messages are stamped and some are not, from message {len(topic.t) + 1} on"
        )
    topic.t.append(stamp or received)


def write_image_message(folder: Path, topic: Topic, message: Message, file: Path) -> None:
    """Write the image of a ROS message into a folder.

    It is named by its time.
    Raises FileError for two of one time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    suffix, content = image_file_bytes_and_suffix_of_message(
        message, topic.kind.endswith("CompressedImage"), f"{file}: topic {topic.name}, message {len(topic.t)}"
    )
    place = folder / f"{topic.t[-1]:020d}{suffix}"
    if place.exists():
        raise FileError(file, f"topic {topic.name} has two images of {topic.t[-1]} ns")
    write_bytes(place, content)


def append_table_row_of_ros_message(topic: Topic, message: Message, file: Path) -> None:
    """Append the table row of a ROS message to its topic.

    Raises FileError for joints that are not those of the first message.
    """
    if topic.kind in JOINTS:
        names = tuple(message.name) or tuple(f"l{i + 1}" for i in range(len(message.position)))
        topic.header = topic.header or names
        if set(names) != set(topic.header) or len(names) != len(message.position):
            raise FileError(
                file,
                f"topic {topic.name}, message {len(topic.t)}: {len(message.position)} positions of "
                f"{short_repr(', '.join(names))}; the "
                f"first message has those of {short_repr(', '.join(topic.header))}",
            )
        at = dict(zip(names, message.position))
        topic.rows.append([float(at[name]) for name in topic.header])
    elif topic.kind in TEMPERATURES:
        topic.rows.append([float(message.temperature)])
    else:
        pose = message.transform if topic.kind.endswith("TransformStamped") else message.pose
        pose = getattr(pose, "pose", pose)
        p, q = (pose.translation, pose.rotation) if hasattr(pose, "translation") else (pose.position, pose.orientation)
        topic.header = POSE_HEADER
        topic.rows.append([float(v) for v in (p.x, p.y, p.z, q.x, q.y, q.z, q.w)])
