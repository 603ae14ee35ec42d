"""Intrinsics of RealSense cameras see, once imported, what the formulas of their maker make of the same figures."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from rig.errors import FileError, RigError
from rig.formats.importers.camera_calibrations import read_calibration_program_and_cameras, rig_toml_with_cameras
from rig.formats.importers.foreign_file_import_recipe import Cameras
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml

TERMS = (-0.051, 0.0607, -0.00044, 0.00147, -0.0198)
BLOCK = """ Intrinsic of "{stream}" / {width}x{height} / {{YUYV/RGB8}}
  Width:      \t{width}
  Height:     \t{height}
  PPX:        \t{ppx}
  PPY:        \t363.5
  Fx:         \t645.5
  Fy:         \t644.7
  Distortion: \t{model}
  Coeffs:     \t{terms}
  FOV (deg):  \t89.5 x 58.36

"""


def listed(path, *changes):
    """A file with a block for each of the changes to a colour stream of 1280x720."""
    whole = {"stream": "Color", "width": 1280, "height": 720, "ppx": 651.25, "model": "Brown Conrady", "terms": TERMS}
    blocks = []
    for change in changes:
        figures = whole | change
        figures["terms"] = "  \t".join(map(str, figures["terms"]))
        blocks.append(BLOCK.format(**figures))
    path.write_text("Device info:\n    Name : Intel RealSense D405\n\n" + "".join(blocks) + "Extrinsic from ..\n")
    return path


def formula(terms, x, y, at_radial=False):
    """(n, 2) points that the maker's formula makes of points. at_radial : tangential terms at distorted ones"""
    k1, k2, p1, p2, k3 = terms
    r = x * x + y * y
    f = 1 + k1 * r + k2 * r**2 + k3 * r**3
    a, b = (x * f, y * f) if at_radial else (x, y)
    s = a * a + b * b if at_radial else r
    return np.stack(
        [x * f + 2 * p1 * a * b + p2 * (s + 2 * a * a), y * f + 2 * p2 * a * b + p1 * (s + 2 * b * b)], axis=1
    )


def projected(camera, ideal):
    points = np.column_stack([ideal, np.ones(len(ideal))])
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0][:, 0]


def test_each_model_is_seen_as_its_maker_states(tmp_path):
    kinds = ("Brown Conrady", "Inverse Brown Conrady", "Modified Brown Conrady", "None")
    for model in kinds:
        terms = TERMS if model != "None" else (0, 0, 0, 0, 0)
        program, (camera,) = read_calibration_program_and_cameras(
            listed(tmp_path / "c.txt", {"model": model, "terms": terms})
        )
        assert "rs-enumerate-devices" in program and camera.name == "color-1280x720" and camera.size == (1280, 720)
        rng, M = np.random.default_rng(0), camera.matrix
        if model.startswith("Inverse"):
            pixels = rng.uniform(0, 1, (500, 2)) * [1279, 719]
            ideal = formula(TERMS, *((pixels - M[:2, 2]) / [M[0, 0], M[1, 1]]).T)
        else:
            ideal = rng.uniform(-1, 1, (500, 2)) * [0.9, 0.5]
            pixels = formula(terms, *ideal.T, at_radial=model.startswith("Mod")) * [M[0, 0], M[1, 1]] + M[:2, 2]
        exact = model in ("Brown Conrady", "None")
        assert np.abs(projected(camera, ideal) - pixels).max() < (1e-9 if exact else 0.05), model
        assert exact == (camera.remarks == ())


def test_a_lens_that_opencv_cannot_follow_and_unknown_ones_are_refused(tmp_path):
    strong = (0.0981, 0.2033, 0.0031, 0.0026, -0.1124)
    with pytest.raises(FileError, match=r"c.txt:11.*OpenCV's lens follows it to [\d.]+ px only"):
        read_calibration_program_and_cameras(
            listed(tmp_path / "c.txt", {"model": "Inverse Brown Conrady", "terms": strong})
        )
    with pytest.raises(FileError, match="'Kannala Brandt4' is not supported; Brown Conrady"):
        read_calibration_program_and_cameras(listed(tmp_path / "c.txt", {"model": "Kannala Brandt4"}))
    with pytest.raises(FileError, match="ppx must be a number, not 'wide'"):
        read_calibration_program_and_cameras(listed(tmp_path / "c.txt", {"ppx": "wide"}))
    with pytest.raises(FileError, match="listed twice with different figures"):
        read_calibration_program_and_cameras(listed(tmp_path / "c.txt", {}, {"ppx": 600}))


def test_json_of_the_same_figures_is_read(tmp_path):
    figures = {"width": 640, "height": 480, "ppx": 320, "ppy": 240, "fx": 600, "fy": 601}
    (tmp_path / "left.json").write_text(json.dumps(figures | {"model": "distortion.brown_conrady", "coeffs": TERMS}))
    _, (camera,) = read_calibration_program_and_cameras(tmp_path / "left.json")
    assert camera.name == "left" and camera.distortion.tolist() == list(TERMS) and camera.matrix[1, 1] == 601


def test_the_stream_is_that_of_the_rigs_size_or_as_named(tmp_path):
    text = hexapod_layout_rig_toml(0.3, cameras=1, width=1280, height=720, cubes=3)
    (tmp_path / "rig.toml").write_text(text)
    ours = design_from_rig_toml.load_design(tmp_path / "rig.toml").cameras
    file = listed(
        tmp_path / "c.txt", {"width": 640, "height": 480, "ppx": 330}, {}, {"stream": "Infrared 1", "ppx": 640}
    )
    for names, ppx in (((), 651.25), ((("infrared-1-1280x720", ours[0].name),), 640)):
        changed, lines = rig_toml_with_cameras(Cameras((file,), names=names), text, ours)
        (tmp_path / "rig.toml").write_text(changed)
        assert design_from_rig_toml.load_design(tmp_path / "rig.toml").cameras[0].matrix[0, 2] == ppx
        assert "1 camera" in lines[0]
    with pytest.raises(RigError, match="lists color-640x480, color-1280x720, infrared-1-1280x720: --set cameras.names"):
        rig_toml_with_cameras(Cameras((file,)), text, [*ours, replace(ours[0], name="other")])
