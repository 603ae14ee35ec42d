"""Bags of ROS 1 and 2 and MCAP files, written by rosbags and by mcap's own writer, become the recording that they
hold.
"""

import builtins
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from mcap_ros2.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import RigidTransform, Rotation

from rig.errors import RigError
from rig.formats.importers.ros_messages_to_images_and_rows import image_file_bytes_and_suffix_of_message
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from tests.calib.checks.test_mistakes import run_in_process

START, WIDTH, HEIGHT = 1763800000 * 10**9, 64, 48
JOINTS = ("leg3", "leg1", "leg2", "leg6", "leg5", "leg4")  # a driver's order
N = 4  # frames


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=3, width=WIDTH, height=HEIGHT, cubes=3)
    )
    return path


def held(rng, low=0.46, high=0.48):
    """What was recorded: images of three cameras, joints, poses at ten times the images' rate, a temperature."""
    return SimpleNamespace(
        images=rng.integers(0, 256, (3, N, HEIGHT, WIDTH), np.uint8),
        q=rng.uniform(low, high, (N + 1, 6)),
        T=RigidTransform.from_components(rng.normal(size=(10 * N, 3)) * 0.01, Rotation.random(10 * N, rng=rng)),
    )


def header(n, tenth=0):
    return {"seq": 0, "stamp": {"sec": START // 10**9 + n, "nanosec": tenth * 10**8}, "frame_id": "base"}


def messages(what, stamped=True):
    """(topic, type, ns at which it was received, fields) in order of time."""
    empty = {"seq": 0, "stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    found = []
    for n in range(N + 1):
        t = START + n * 10**9
        names = {name: what.q[n][int(name[3]) - 1] for name in JOINTS}
        found.append(
            (
                "/joints",
                "sensor_msgs/msg/JointState",
                t + 5,
                {
                    "header": header(n) if stamped else empty,
                    "name": list(names),
                    "position": list(names.values()),
                    "velocity": [],
                    "effort": [],
                },
            )
        )
        found.append(
            (
                "/room",
                "sensor_msgs/msg/Temperature",
                t + 6,
                {"header": header(n), "temperature": 20.0 + n, "variance": 0.0},
            )
        )
        if n == N:
            break
        for c, (kind, encoding) in enumerate((("Image", "mono8"), ("Image", "rgb8"), ("CompressedImage", "png"))):
            pixels = what.images[c, n]
            if kind == "Image":
                data = (pixels if encoding == "mono8" else np.stack([pixels] * 3, -1)).tobytes()
                fields = {
                    "height": HEIGHT,
                    "width": WIDTH,
                    "encoding": encoding,
                    "is_bigendian": 0,
                    "step": len(data) // HEIGHT,
                    "data": data,
                }
            else:
                fields = {"format": "png", "data": cv2.imencode(".png", pixels)[1].tobytes()}
            found.append(
                (f"/rig/cam{c}/image_raw", f"sensor_msgs/msg/{kind}", t + 10 + c, {"header": header(n), **fields})
            )
        for k in range(10):
            T = what.T[10 * n + k]
            (x, y, z), (a, b, c, w) = T.translation, T.rotation.as_quat()
            found.append(
                (
                    "/tracker",
                    "geometry_msgs/msg/TransformStamped",
                    t + k * 10**8 + 30,
                    {
                        "header": header(n, k),
                        "child_frame_id": "platform",
                        "transform": {"translation": dict(x=x, y=y, z=z), "rotation": dict(x=a, y=b, z=c, w=w)},
                    },
                )
            )
    return sorted(found, key=lambda one: one[2])


def rosbags_writer(path, found, store, writer):
    """Write messages by rosbags."""
    types = get_typestore(store)

    def made(kind, fields):
        cls = types.types[kind]
        values = {}
        for name, value in fields.items():
            if name == "seq" and store != Stores.ROS1_NOETIC:
                continue
            of = dict(types.fielddefs[kind][1]).get(name)
            inner = {
                "header": "std_msgs/msg/Header",
                "stamp": "builtin_interfaces/msg/Time",
                "transform": "geometry_msgs/msg/Transform",
                "translation": "geometry_msgs/msg/Vector3",
                "rotation": "geometry_msgs/msg/Quaternion",
            }.get(name)
            assert of is not None
            values[name] = (
                made(inner, value)
                if inner
                else np.frombuffer(value, np.uint8)
                if isinstance(value, bytes)
                else (np.array(value, float) if name in ("position", "velocity", "effort") else value)
            )
        return cls(**values)

    with writer as bag:
        connections = {}
        for topic, kind, t, fields in found:
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=types)
            message = made(kind, fields)
            raw = (
                types.serialize_ros1(message, kind)
                if store == Stores.ROS1_NOETIC
                else types.serialize_cdr(message, kind)
            )
            bag.write(connections[topic], t, raw)
    return path


def ros1(path, found):
    return rosbags_writer(path.with_suffix(".bag"), found, Stores.ROS1_NOETIC, Writer1(path.with_suffix(".bag")))


def ros2(path, found):
    return rosbags_writer(path, found, Stores.ROS2_HUMBLE, Writer2(path, version=8))


def mcap(path, found):
    """Write messages by mcap's own writer."""
    types, path = get_typestore(Stores.ROS2_HUMBLE), path.with_suffix(".mcap")
    with open(path, "wb") as file:
        writer, schemas = McapWriter(file), {}
        for topic, kind, t, fields in found:
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind, types.generate_msgdef(kind, ros_version=2)[0])
            writer.write_message(topic, schemas[kind], fields, t, t)
        writer.finish()
    return path


@pytest.mark.parametrize("made", [ros1, ros2, mcap])
def test_a_bag_becomes_the_recording_that_it_holds(made, rig, tmp_path):
    what = held(np.random.default_rng(1))
    words = (
        "import",
        "--rig",
        rig,
        "--bag",
        made(tmp_path / "run", messages(what)),
        "--set",
        "bag.sensors.ambient_temperature_C=/room",
    )
    status, text = run_in_process(*words, "--out", tmp_path / "rec")
    assert status == 0 and "/joints is commands" in text and "/rig/cam2/image_raw is camera cam2" in text, text
    found = recording_folder.load_recording(tmp_path / "rec")
    assert np.abs(found.commands.values - what.q).max() < 1e-15 and found.commands.t.tolist() == list(range(N + 1))
    assert (
        found.exposures.times()[1].tolist() == list(range(N))
        and str(START // 10**9) in (tmp_path / "rec" / "frames.csv").read_text()
    )
    for c in range(3):
        for n in range(N):
            image = cv2.imread(str(tmp_path / "rec" / "images" / f"cam{c}" / f"{n:05d}.png"), cv2.IMREAD_UNCHANGED)
            assert np.array_equal(image if image.ndim == 2 else image[:, :, 1], what.images[c, n])
    apart = found.poses.T_base_platform.inv() * what.T[::10]
    assert np.abs(apart.translation).max() < 1e-9 and apart.rotation.magnitude().max() < 1e-9
    assert found.sensors.channels["ambient_temperature_C"].tolist() == [20.0 + n for n in range(N + 1)]
    assert run_in_process("import", "--recipe", tmp_path / "rec.import.toml", "--out", tmp_path / "again")[0] == 0
    for name in ("commands", "poses", "sensors", "frames"):
        assert (tmp_path / "again" / f"{name}.csv").read_text() == (tmp_path / "rec" / f"{name}.csv").read_text()


def test_what_is_not_stated_and_could_be_several_is_asked(rig, tmp_path):
    found = messages(held(np.random.default_rng(2)))
    others = [("/other" + topic, *rest) for topic, *rest in found if topic in ("/joints", "/rig/cam1/image_raw")]
    twice = sorted([*found, *others], key=lambda m: m[2])
    bag = mcap(tmp_path / "run", twice)
    status, text = run_in_process("import", "--rig", rig, "--bag", bag, "--out", tmp_path / "rec")
    assert status == 1 and all(
        f"--set 'bag.topics.commands={topic}'" in text for topic in ("/joints", "/other/joints")
    ), text
    setting = ("--set", "bag.topics.commands=/joints")
    status, text = run_in_process("import", "--rig", rig, "--bag", bag, *setting, "--out", tmp_path / "rec")
    assert status == 1 and "bag.cameras.cam1=/other/rig/cam1/image_raw" in text
    cameras = [word for c in range(2) for word in ("--set", f"bag.cameras.cam{c}=/rig/cam{c}/image_raw")]
    assert run_in_process("import", "--rig", rig, "--bag", bag, *setting, *cameras, "--out", tmp_path / "rec")[0] == 0
    assert {path.name for path in (tmp_path / "rec" / "images").iterdir()} == {"cam0", "cam1"}
    for key, topic, says in (
        ("cameras.cam0", "/nowhere", "has no topic '/nowhere' for camera cam0; it has /joints, "),
        ("topics.poses", "/joints", "and poses takes"),
        ("topics.poeses", "/joints", "unknown key 'bag.topics.poeses'"),
        ("sensors.x y", "/room", "cannot be a name"),
    ):
        status, text = run_in_process(
            "import",
            "--rig",
            rig,
            "--bag",
            bag,
            *setting,
            *cameras[2:],
            "--set",
            f"bag.{key}={topic}",
            "--out",
            tmp_path / "no",
        )
        assert status == 1 and says in text and "Traceback" not in text, text


def test_messages_without_stamps_have_the_times_at_which_they_were_received(rig, tmp_path):
    what = held(np.random.default_rng(3))
    bag = ros1(tmp_path / "run", messages(what, stamped=False))
    status, text = run_in_process(
        "import", "--rig", rig, "--bag", bag, "--set", "commands.shift=-5e-9", "--out", tmp_path / "rec"
    )
    assert status == 0 and "/joints: messages have no stamps" in text, text
    assert np.abs(recording_folder.load_recording(tmp_path / "rec").commands.t - np.arange(N + 1)).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("made", [ros1, ros2, mcap])
def test_a_damaged_bag_is_refused_by_its_name(made, rig, tmp_path):
    bag = made(tmp_path / "run", messages(held(np.random.default_rng(4))))
    file = bag if bag.is_file() else next(bag.glob("*.db3"))
    whole, rng = file.read_bytes(), np.random.default_rng(5)
    for trial in range(6):
        data = bytearray(whole)
        if trial < 3:
            del data[int(len(whole) * (0.1, 0.5, 0.97)[trial]) :]
        else:
            for at in rng.integers(0, len(whole), 200):
                data[at] = rng.integers(256)
        file.write_bytes(data)
        status, text = run_in_process("import", "--rig", rig, "--bag", bag, "--out", tmp_path / f"rec{trial}")
        assert "Traceback" not in text and (
            status == 0 or (bag.name in text and not (tmp_path / f"rec{trial}").exists())
        ), text
    status, text = run_in_process("import", "--rig", rig, "--bag", tmp_path / "none.bag", "--out", tmp_path / "rec")
    assert status == 1 and "none.bag: no such file" in text
    status, text = run_in_process("import", "--rig", rig, "--bag", rig, "--out", tmp_path / "rec")
    assert status == 1 and "rig.toml: is not a readable bag" in text


PATTERNS = {"bayer_rggb8": "RGGB", "bayer_bggr8": "BGGR", "bayer_gbrg8": "GBRG", "bayer_grbg8": "GRBG"}


@pytest.mark.parametrize("encoding", PATTERNS)
def test_a_mosaic_becomes_the_grey_of_its_colours(encoding):
    colours = {"R": 200, "G": 120, "B": 40}
    cell = np.array([colours[letter] for letter in PATTERNS[encoding]], np.uint8).reshape(2, 2)
    pixels = np.tile(cell, (8, 8))
    suffix, content = image_file_bytes_and_suffix_of_message(
        SimpleNamespace(encoding=encoding, width=16, height=16, step=16, is_bigendian=0, data=pixels.tobytes()),
        False,
        "x",
    )
    grey = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert (
        suffix == ".png"
        and np.abs(grey[2:-2, 2:-2].astype(float) - (0.299 * 200 + 0.587 * 120 + 0.114 * 40)).max() <= 1
    )


def test_deep_images_keep_their_depth_and_half_ones_are_refused():
    pixels = (np.arange(12).reshape(3, 4) * 5000).astype(">u2")
    message = SimpleNamespace(encoding="mono16", width=4, height=3, step=8, is_bigendian=1, data=pixels.tobytes())
    assert np.array_equal(
        cv2.imdecode(
            np.frombuffer(image_file_bytes_and_suffix_of_message(message, False, "x")[1], np.uint8),
            cv2.IMREAD_UNCHANGED,
        ),
        pixels,
    )
    for change, says in (
        (dict(data=b"123"), "has 3 bytes"),
        (dict(encoding="yuv422"), "encoding 'yuv422'"),
        (dict(height=0), "4 x 0 px"),
    ):
        with pytest.raises(RigError, match=says):
            image_file_bytes_and_suffix_of_message(SimpleNamespace(**{**vars(message), **change}), False, "x")


def test_a_missing_library_says_what_installs_it(rig, tmp_path, monkeypatch):
    whole = builtins.__import__

    def without(name, *rest, **more):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return whole(name, *rest, **more)

    (tmp_path / "x.bag").write_bytes(b"")
    monkeypatch.setattr(builtins, "__import__", without)
    status, text = run_in_process("import", "--rig", rig, "--bag", tmp_path / "x.bag", "--out", tmp_path / "rec")
    assert status == 1 and "pip install 'rig[ros]'" in text
