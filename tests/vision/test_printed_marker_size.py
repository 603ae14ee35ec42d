"""The true side of printed markers from a photograph: a sheet drawn, printed too small, photographed aslant."""

import json
import resource
import struct
import zlib

import cv2
import numpy as np
import pytest

from rig.cli.command_line import main
from rig.recording.exposures_and_image_files import PNG
from vision.marker_corner_prediction import marker_cells

PIXEL, WIDTH, HEIGHT = 5.0, 210.0, 297.0  # px per mm of the flat drawing; mm
RIG = """schema = "rig/1"
[mechanism]
kind = "free"
[[target]]
name = "B1"
body = "base"
dictionary = "DICT_4X4_50"
edge = 0.06
marker = 0.05
faces = { "+x" = 0, "+y" = 1, "-x" = 2, "-y" = 3 }
pose = { position = [0.0, 0.0, 0.0], rotvec = [0.0, 0.0, 0.0] }
"""


def test_a_picture_that_claims_more_than_a_photograph_has_is_never_decoded(tmp_path, capsys):
    row = zlib.compress(bytes(9000))
    (tmp_path / "rig.toml").write_text(RIG)
    bomb = b"\0\0\0\rIHDR" + struct.pack(">IIBBBBB", 30000, 30000, 16, 2, 0, 0, 0)
    bomb += struct.pack(">I", zlib.crc32(bomb[4:])) + struct.pack(">I", len(row)) + b"IDAT" + row
    (tmp_path / "bomb.png").write_bytes(
        PNG + bomb + struct.pack(">I", zlib.crc32(b"IDAT" + row)) + b"\0\0\0\0IEND\xaeB`\x82"
    )
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert main(["check-print", str(tmp_path / "bomb.png"), str(tmp_path / "rig.toml")]) == 1
    assert (
        "bomb.png: is not a readable picture (truncated?): claims 30000 x 30000 px; an image has at most 67108864"
        in capsys.readouterr().err
    )
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 17  # KiB


def photograph(path, scale, folder):
    """A photograph, aslant, of an A4 sheet with four markers of 50 mm printed `scale` times as large, (across, along);
    px of a ruler of 100 mm.
    """
    flat = np.full((int((HEIGHT + 80) * PIXEL), int((WIDTH + 80) * PIXEL)), 60, np.uint8)
    flat[int(40 * PIXEL) : int((40 + HEIGHT) * PIXEL), int(40 * PIXEL) : int((40 + WIDTH) * PIXEL)] = 235
    for number, (x, y) in enumerate(((70, 80), (150, 80), (70, 200), (150, 200))):
        wide, high = (round(50 * s * PIXEL) for s in scale)
        cells = marker_cells("DICT_4X4_50", number)[1:-1, 1:-1]
        drawn = cv2.resize((20 + 215 * cells).astype(np.uint8), (wide, high), interpolation=cv2.INTER_NEAREST)
        top, left = int((y) * PIXEL), int((x) * PIXEL)
        flat[top : top + high, left : left + wide] = drawn
    a = np.array([[0, 0], [flat.shape[1], 0], [flat.shape[1], flat.shape[0]], [0, flat.shape[0]]], np.float32)
    H = cv2.getPerspectiveTransform(a, np.array([[120, 60], [1500, 110], [1440, 1930], [60, 1880]], np.float32))
    image = cv2.GaussianBlur(
        cv2.warpPerspective(flat, H, (1600, 2000), flags=cv2.INTER_AREA, borderValue=60), (0, 0), 0.8
    )
    cv2.imwrite(
        str(path), np.clip(image + np.random.default_rng(0).normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)
    )
    (folder / "rig.toml").write_text(RIG)
    return cv2.perspectiveTransform(np.array([[[50 * PIXEL, 300 * PIXEL], [150 * PIXEL, 300 * PIXEL]]]), H)[0]


def check_print(capsys, *words):
    assert main(["check-print", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("scale", [(0.964, 0.964), (1.0, 1.0), (0.98, 1.02)])
def test_scale_is_found_both_ways(tmp_path, capsys, scale):
    photograph(tmp_path / "p.png", scale, tmp_path)
    found = check_print(capsys, tmp_path / "p.png", tmp_path / "rig.toml", "--sheet", "210mmx297mm")
    assert found["markers"] == 4
    np.testing.assert_allclose(found["scale"], scale, atol=2e-3)
    assert np.all(np.abs(np.subtract(found["scale"], scale)) < 3 * np.array(found["standard_uncertainty"]) + 5e-4)
    main(["check-print", str(tmp_path / "p.png"), str(tmp_path / "rig.toml"), "--sheet", "210mmx297mm"])
    assert (
        capsys.readouterr()
        .out.splitlines()[-1]
        .startswith({0.964: "check: write", 1.0: "good", 0.98: "bad: the printer scales"}[scale[0]])
    )


def test_a_ruler_tells_the_scale(tmp_path, capsys):
    ends = photograph(tmp_path / "p.png", (0.964, 0.964), tmp_path)
    given = ",".join(f"{value:.1f}" for value in ends.ravel()) + "=100mm"
    found = check_print(capsys, tmp_path / "p.png", tmp_path / "rig.toml", "--ruler", given)
    assert abs(found["scale"][0] - 0.964) < 3e-3 and found["standard_uncertainty"][0] < 5e-3
    assert abs(found["side"]["B1"] - 0.0482) < 2e-4


def test_what_cannot_be_told_is_refused(tmp_path, capsys):
    photograph(tmp_path / "p.png", (1.0, 1.0), tmp_path)
    image = cv2.imread(str(tmp_path / "p.png"))
    cv2.imwrite(str(tmp_path / "part.png"), image[:, 300:])
    cv2.imwrite(str(tmp_path / "none.png"), np.full((400, 400), 200, np.uint8))
    (tmp_path / "half.png").write_bytes((tmp_path / "p.png").read_bytes()[:200])
    for name, says in (
        ("part.png", "no full sheet"),
        ("none.png", "no marker of the rig"),
        ("typo.png", "no such file"),
        ("half.png", "truncated?"),
    ):
        assert main(["check-print", str(tmp_path / name), str(tmp_path / "rig.toml")]) == 1
        assert says in capsys.readouterr().err
    for words in (["--sheet", "B9"], ["--ruler", "1,2,3"], ["--ruler", "1,2,1,2=100mm"]):
        with pytest.raises(SystemExit):
            main(["check-print", str(tmp_path / "p.png"), str(tmp_path / "rig.toml"), *words])
