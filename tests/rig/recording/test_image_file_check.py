"""Image files are looked at before they are decoded: size, kind, place; all that cannot be used are named at once."""

import os
import struct
import zlib

import cv2
import numpy as np
import pytest

from rig.errors import FileError
from rig.model.design import Camera
from rig.model.pose import pose
from rig.recording import exposures_and_image_files
from rig.recording import recording_folder as recording
from rig.recording.exposures_and_image_files import read_grey_or_colour_image

CAMERA = Camera("cam0", 64, 48, np.diag([50.0, 50.0, 1.0]), np.zeros(5), pose([0, 0, 0], [0, 0, 0]))
PICTURE = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
HUGE_JPEG = (
    b"\xff\xd8\xff\xe0\x00\x04ab\xff\xc0\x00\x0b\x08" + struct.pack(">HH", 30000, 30000) + b"\x01\x01\x11\x00\xff\xd9"
)
HUGE_PNG = (
    exposures_and_image_files.PNG + b"\0\0\0\rIHDR" + struct.pack(">II", 30000, 30000) + bytes(40) + b"IEND\xaeB`\x82"
)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tiff", "a.bmp", "a.pgm"])
def test_the_size_of_every_format_is_seen_without_decoding(tmp_path, name):
    path = tmp_path / name
    cv2.imwrite(str(path), PICTURE)
    assert exposures_and_image_files.image_file_problem(path, CAMERA) is None
    cv2.imwrite(str(path), PICTURE.T.copy())
    assert "is 48 x 64 px, but camera 'cam0' has 64 x 48" in exposures_and_image_files.image_file_problem(path, CAMERA)


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("a.jpg", HUGE_JPEG, "claims 30000 x 30000"),
        ("a.png", HUGE_PNG, "claims 30000 x 30000"),
        ("a.webp", b"RIFF" + bytes(60), "no image"),
        ("a.pgm", b"P5 999999999 999999999 255\n", "claims"),
        ("a.bmp", b"BM" + bytes(12), "no image"),
        ("a.tif", b"II*\0" + b"\xff" * 4, "no image"),
        ("a.jpg", b"\xff\xd8\xff" + b"\xff" * 200 + b"\xff\xd9", "no image"),
        ("a.png", b"", "empty"),
        ("a.jpg", HUGE_JPEG[:20], "cut off"),
    ],
)
def test_what_an_image_claims_is_looked_at_first(tmp_path, name, data, says):
    path = tmp_path / name
    path.write_bytes(data)
    assert says in exposures_and_image_files.image_file_problem(path)
    with pytest.raises(FileError, match=says):
        read_grey_or_colour_image(path)


@pytest.fixture
def seen(recording_folder):
    """A recording with an image for its first three exposures."""
    path = recording_folder / "frames.csv"
    lines = path.read_text().splitlines()
    for i in (1, 2, 3):
        cells = lines[i].split(",")
        (recording_folder / "images" / cells[2]).mkdir(parents=True, exist_ok=True)
        cells[3] = f"images/{cells[2]}/{i}.png"
        cv2.imwrite(str(recording_folder / cells[3]), np.zeros((1024, 1280), np.uint8))
        lines[i] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    return recording_folder


def renamed(folder, line, name):
    path = folder / "frames.csv"
    lines = path.read_text().splitlines()
    lines[line - 1] = ",".join([*lines[line - 1].split(",")[:3], name])
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("name", ["../x.png", "/etc/passwd", "images/../../x.png", "images/link.png", "/dev/zero"])
def test_images_stay_inside_the_recording(seen, name):
    os.symlink("/etc/passwd", seen / "images" / "link.png")
    renamed(seen, 2, name)
    with pytest.raises(FileError, match=r"lies outside the recording.*frames.csv, line 2"):
        recording.load_recording(seen)


def test_a_pipe_is_not_waited_for(seen):
    os.mkfifo(seen / "images" / "pipe.png")
    renamed(seen, 2, "images/pipe.png")
    with pytest.raises(FileError, match="is a pipe, not a file"):
        recording.load_recording(seen)


def test_all_bad_images_are_named_at_once_and_left_out_where_asked(seen):
    first, second = (line.split(",")[3] for line in (seen / "frames.csv").read_text().splitlines()[1:3])
    (seen / first).write_bytes(b"")
    (seen / second).write_bytes((seen / second).read_bytes()[:100])
    with pytest.raises(FileError) as error:
        recording.load_recording(seen)
    assert first in str(error.value) and second in str(error.value) and "2 images" in str(error.value)
    found = recording.load_recording(seen, skip_unreadable=True)
    assert [s.path for s in found.skipped] == [seen / first, seen / second] and sum(
        map(bool, found.exposures.image)
    ) == 1
    assert len(found.exposures.frame) == len(recording.load_recording(seen, skip_unreadable=True).exposures.frame)


def test_what_only_decoding_shows_is_left_out_as_well(seen):
    name = (seen / "frames.csv").read_text().splitlines()[1].split(",")[3]
    data = b"\0\0\0\rIHDR" + struct.pack(">IIBBBBB", 1280, 1024, 8, 0, 0, 0, 0)
    (seen / name).write_bytes(
        exposures_and_image_files.PNG
        + data
        + struct.pack(">I", zlib.crc32(data[4:]))
        + b"\0\0\0\x04IDATxxxx\0\0\0\0"
        + b"\0\0\0\0IEND\xaeB`\x82"
    )
    assert recording.load_recording(seen).has_images  # whole, and of the right size
    assert len(recording.load_recording(seen, skip_unreadable=True).skipped) == 1


def test_none_left_is_an_error_all_the_same(seen):
    for line in (seen / "frames.csv").read_text().splitlines()[1:4]:
        (seen / line.split(",")[3]).write_bytes(b"")
    with pytest.raises(FileError, match="3 images cannot be used"):
        recording.load_recording(seen, skip_unreadable=True)
