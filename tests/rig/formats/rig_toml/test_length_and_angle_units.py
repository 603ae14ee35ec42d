"""rig.toml in millimetres and degrees: the same Design, messages in the owner's units, and writers that keep them."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomlkit

from docs.make import rig_toml
from docs.make.field_texts import texts_of_fields
from rig.errors import FileError
from rig.formats.json_toml_and_yaml_loading import json_data, toml_entries
from rig.formats.numbers_and_units import LengthAndAngleUnits, parse_length_and_angle_units
from rig.formats.rig_toml.arm_dynamics_entries import dynamics_of_table
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import (
    camera_toml,
    rig_toml_with_camera_values_replaced,
    rig_toml_with_target_markers_replaced,
)
from rig.formats.rig_toml.design_from_rig_toml import design_of_entries
from rig.formats.rig_toml.rig_toml_text_in_other_units import rig_toml_in_units
from rig.model.design import Marker
from rig.model.pose import pose
from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions, new_rig_toml
from tests.gantry_and_hexapod import GANTRY

DEG = 180 / np.pi
FACTORS = {"m": 1e3, "m/s": 1e3, "m/s^2": 1e3, "m per revolution": 1e3, "rad": DEG}
UNIT = re.compile(r"(?:\([^)]*\) )?(m per revolution|[A-Za-z]+(?:/[a-z]+(?:\^2)?)?)\b")
OF_POSE = {"position": 1e3, "look_at": 1e3, "rotvec": DEG, "up": 1, "degrees": 1}


def design_of(tree):
    return design_of_entries(toml_entries(tomlkit.dumps(tree), Path("rig.toml")))


def scaled(value, factor):
    return [scaled(one, factor) for one in value] if isinstance(value, list) else value * factor


def units_in_text(heading):
    """{key: unit} as the docstring of a table's dataclass states it."""
    kind = rig_toml.TABLES[heading][0]
    found = {key: UNIT.match(words) for key, words in texts_of_fields(kind).items()} if kind else {}
    return {key: match[1] for key, match in found.items() if match}


def row_in_mm(row):
    word, figures = (row[:1], row[1:]) if isinstance(row[0], str) else ([], row)
    return word + [v * f for v, f in zip(figures, (DEG, 1e3, 1e3, DEG, DEG))]


def in_mm(tree, path=()):
    """A table of rig.toml in mm and deg, by the units that the docstrings state."""
    kind = tree.get("kind", "")
    if path[:1] == ("mechanism",) and kind != "free":
        of_rows = path[-1] in ("joints", "branch", "hand", "coupling")
        heading = f"[[mechanism.{path[-1]}]]" if of_rows else f'[mechanism] kind = "{kind}"'
    else:
        heading = next((h for h in (f"[{'.'.join(path)}]", f"[[{'.'.join(path)}]]") if h in rig_toml.TABLES), None)
    heading = "name and [environment]" if path == ("environment",) else heading
    units, out = {} if heading is None or kind == "chain" else units_in_text(heading), {}
    slides = [isinstance(row[0], str) for row in tree.get("joints", []) if isinstance(row, list)]
    for key, value in tree.items():
        if isinstance(value, dict) and "position" in value:
            out[key] = {name: v if name == "euler" else scaled(v, OF_POSE[name]) for name, v in value.items()}
        elif isinstance(value, dict):
            out[key] = in_mm(value, (*path, key))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            out[key] = [in_mm(one, (*path, key)) for one in value]
        elif key == "limits":
            slide = tree.get("joint") == "prismatic"
            out[key] = (
                [scaled(pair, 1e3 if one else DEG) for pair, one in zip(value, slides)]
                if path[-1] != "joints"
                else scaled(value, 1e3 if slide else DEG)
            )
        elif key == "board":
            kind, size, *lengths, dictionary = value.split(":")
            out[key] = ":".join([kind, size, *(f"{float(one) * 1e3:.12g}" for one in lengths), dictionary])
        elif heading == '[mechanism] kind = "arm"' and key == "joints":
            out[key] = [row_in_mm(row) for row in value]
        else:
            out[key] = scaled(value, FACTORS[units[key]]) if units.get(key) in FACTORS else value
    return {"schema": tree["schema"], "units": "mm, deg", **out} if not path else out


def samples():
    chain = tomllib.loads('schema = "rig/1"\n' + GANTRY)
    chain["mechanism"]["stage"].append(rig_toml.samples()[0]["mechanism"])
    slide = {"schema": "rig/1", "mechanism": {"kind": "arm", "joints": [["prismatic", 0.1, 0.0, 0.2, 0.3]]}}
    slide["mechanism"]["limits"] = [[0.1, 0.4]]
    slide["instrument"] = {"base": "free", "tool": "free", "position_sigma": 1e-5, "rotation_sigma": 1e-4}
    looks = tomllib.loads(tomlkit.dumps(rig_toml.samples()[0]))
    looks["camera"][0]["pose"] = {"position": [1.0, 0.2, 0.5], "look_at": [0.0, 0.0, 0.3], "up": [0.0, 1.0, 0.2]}
    looks["target"][0]["pose"] = {"position": [0.1, 0.2, 0.0], "euler": "xyz", "degrees": [1.0, 2.0, 3.0]}
    looks["controller"] |= {
        "tolerance": 2e-5,
        "max_step": 0.02,
        "max_acceleration": 0.3,
        "zero": [0.1] * 6,
        "home": 0.5,
    }
    looks["controller"]["max_acceleration"] = 0.3
    looks["actuator"] = {"screw_lead": 0.002, "max_speed": 0.02}
    looks["platform"] = {"mass": 3.0, "centre_of_mass": [0.0, 0.01, 0.02]}
    return [*rig_toml.samples(), chain, slide, looks]


def flat(data):
    if isinstance(data, dict):
        return [pair for key, value in data.items() for pair in [key, *flat(value)]]
    return [x for one in data for x in flat(one)] if isinstance(data, list) else [data]


@pytest.mark.parametrize("k", range(len(samples())))
def test_a_rig_in_mm_and_degrees_is_the_rig_in_m_and_rad(k):
    tree = {key: value for key, value in samples()[k].items() if value is not None}
    stated = in_mm(tree)
    assert tomlkit.dumps(stated) != tomlkit.dumps({**tree, "units": "mm, deg"}) or tree["mechanism"]["kind"] == "free"
    one, other = (flat(json_data(design_of(each))) for each in (tree, stated))
    assert len(one) == len(other) > 20
    for a, b in zip(one, other):
        assert b == pytest.approx(a, rel=1e-12, abs=1e-12) if isinstance(a, float) else a == b


def test_the_units_that_the_reader_asks_for_are_those_that_the_docstrings_state():
    checked = 0
    for (heading, key), what in rig_toml.requested_entries().items():
        kind = rig_toml.TABLES[heading][0]
        match = UNIT.match(texts_of_fields(kind).get(str(key), "")) if kind else None
        stated = {"m per revolution": "m"}.get(match[1], match[1]) if match else ""
        stated = "grey levels" if stated == "grey" else stated
        if key == "limits":  # "rad, of a slide m", where the page is made with a slide
            stated = "m"
        if isinstance(what.unit, str) and (what.unit or stated in ("m", "rad", "m/s", "m/s^2")):
            assert (heading, key, what.unit.split(" (")[0]) == (heading, key, stated)
            checked += 1
    assert checked > 30


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("edge = 93.0", "edge = 9300.0", "target.1.edge must be > 0 and <= 5000 mm, not 9300.0"),
        ("marker = 67.6", "marker = 120.0", "target.1.marker = 120 mm does not fit on a cube of edge 93 mm"),
        ("rotvec = [0, 0, 10]", "rotvec = [0, 0, 1000]", "turns more than once round"),
        ("[200, 0, 500]", "[200000, 0, 500]", "= 200000 mm is implausible (more than 50000 mm)"),
        ("[[300, 500]", "[[500, 300]", "strut_range[1] must run from small to large, not 500 mm .. 300 mm"),
        ("[[300, 500]", "[[0.3, 0.5]", "is this in metres?"),
        ("gravity = [0, 0, -9806.65]", "gravity = [0, 0, -9.80665]", "standard gravity is 9806.65 mm/s^2"),
        ('"mm, deg"', '"mm, degs"', "units must be a unit of lengths (m, mm, cm, um, in) and one of angles"),
        ('"mm, deg"', '"mm, cm"', "units must be"),
        ('"mm, deg"', '"mm"', "units must be"),
    ],
)
def test_a_message_has_the_figure_as_it_stands_in_the_file(old, new, says):
    assert old in PAIR
    text = PAIR.replace(old, new, 1)
    line = next(i for i, (a, b) in enumerate(zip(PAIR.splitlines(), text.splitlines()), 1) if a != b)
    with pytest.raises(FileError) as error:
        design_of_entries(toml_entries(text, Path("rig.toml")))
    assert says in str(error.value) and f"rig.toml:{line}" in str(error.value)


PAIR = """schema = "rig/1"
units = "mm, deg"
environment = { gravity = [0, 0, -9806.65] }
[mechanism]
kind = "planar2"
base_joints = [[-100, 0], [100, 0]]
strut_range = [[300, 500], [300, 500]]
[[camera]]
name = "cam0"
width = 640
height = 512
matrix = [[800.0, 0.0, 320.0], [0.0, 800.0, 256.0], [0.0, 0.0, 1.0]]
distortion = [0, 0, 0, 0]
pose = { position = [200, 0, 500], rotvec = [0, 0, 10] }
[[target]]
name = "B1"
body = "base"
dictionary = "DICT_4X4_50"
edge = 93.0
marker = 67.6
faces = { "+x" = 0 }
pose = { position = [0, 0, 0], rotvec = [0, 0, 90] }
"""


def test_cameras_and_markers_are_written_in_the_files_own_units():
    design = design_of_entries(toml_entries(PAIR, Path("rig.toml")))
    moved = replace(design.cameras[0], pose=pose([0.1, 0.2, 0.3], [0.0, 0.0, np.pi / 2]))
    text = rig_toml_with_camera_values_replaced(PAIR, [moved])
    assert "[100.0, 200.0, 300.0]" in text and "90.0" in text
    found = design_of_entries(toml_entries(text, Path("rig.toml"))).cameras[0]
    assert np.allclose(found.pose.as_matrix(), moved.pose.as_matrix(), rtol=0, atol=1e-9)
    marker = Marker(0, 0.0676, pose([0.1, 0.0, 0.05], [0.0, 0.0, np.pi / 4]), 0.005)
    text = rig_toml_with_target_markers_replaced(text, {"B1": (marker,)})
    assert "side = 67.6" in text and "margin = 5.0" in text and "45.0" in text
    (back,) = design_of_entries(toml_entries(text, Path("rig.toml"))).targets[0].listed
    assert (back.side, back.margin) == pytest.approx((0.0676, 0.005), abs=1e-12)
    assert np.allclose(back.pose.as_matrix(), marker.pose.as_matrix(), rtol=0, atol=1e-9)
    assert camera_toml(moved, True, LengthAndAngleUnits("mm", "deg")).count("[100.0, 200.0, 300.0]") == 1


def test_an_arms_dynamics_turn_lengths_and_angles_alone():
    text = """units = "mm, deg"
angle_sigma = [0.1, 0.02]
torque_limits = [100.0, 200.0]
friction = [[1.0, 0.1], [2.0, 0.2]]
links = [[2.0, 10, 20, 30, 0.1, 0.1, 0.1, 0, 0, 0], [2.0, 10, 20, 30, 0.1, 0.1, 0.1, 0, 0, 0]]
"""
    root = toml_entries(text, Path("rig.toml")).in_stated_units()
    del root.tree["units"]
    found = dynamics_of_table(root, ("rad", "m"))
    np.testing.assert_allclose(found.angle_sigma, [np.radians(0.1), 2e-5], rtol=1e-12)
    np.testing.assert_allclose(found.links.centre[0], [0.01, 0.02, 0.03], rtol=1e-12)
    assert found.torque_limits.tolist() == [100, 200] and found.friction[1].tolist() == [2.0, 0.2]


def test_derived_units_are_converted_or_refused():
    units = parse_length_and_angle_units("deg, mm")
    assert units.per_si("1/m") == 1e-3 and units.per_si("m/K") == 1e3 and units.per_si("m^2") == 1e6
    assert units.per_si("N/m") == units.per_si("N m s/rad") == units.per_si("px") == 1
    assert units.name("m/s^2") == "mm/s^2" and units.per_si("rad/s") == pytest.approx(DEG)
    with pytest.raises(ValueError, match="furlong"):
        units.per_si("furlong/s")


LAYOUTS = [
    LayoutOptions(radius=0.3, cameras=1, cubes=1, limbs=6),
    LayoutOptions(mechanism="planar2", radius=0.2, cameras=1, cubes=1),
    *(LayoutOptions(arm=name) for name in ("panda", "scara", "ur10")),
    LayoutOptions(arm="ur10", seen="cubes", cameras=1, cubes=1),
]


@pytest.mark.parametrize("options", LAYOUTS, ids=lambda options: options.arm or options.mechanism or "hexapod")
@pytest.mark.parametrize("units", ["mm, deg", "in, mrad"])
def test_a_new_rig_in_the_owners_units_is_that_in_m_and_rad_by_the_docstrings_units(options, units):
    stated = parse_length_and_angle_units(units)
    plain = new_rig_toml(options)
    text = new_rig_toml(replace(options, units=stated))
    assert text.split("\n")[:2] == ['schema = "rig/1"', f'units = "{units}"']
    assert text.count("\n") == plain.count("\n") + 1
    one, other = flat(tomllib.loads(plain)), flat(tomllib.loads(text))
    assert len(other) == len(one) + 2  # the key and what it states
    if units == "mm, deg":  # by another way: the docstrings' units, not those that the reader asks for
        dynamics = tomllib.loads(text).pop("dynamics", {})
        expected = in_mm({key: value for key, value in tomllib.loads(plain).items() if key != "dynamics"})
        for a, b in zip(flat(expected), flat({k: v for k, v in tomllib.loads(text).items() if k != "dynamics"})):
            assert b == pytest.approx(a, rel=1e-8, abs=1e-12) if isinstance(a, float) else a == b
        for row, was in zip(dynamics.get("links", []), tomllib.loads(plain).get("dynamics", {}).get("links", [])):
            assert row == pytest.approx([was[0], *(1e3 * x for x in was[1:4]), *was[4:]], rel=1e-9)
    for a, b in zip(*(flat(json_data(design_of_entries(toml_entries(t, Path("rig.toml"))))) for t in (plain, text))):
        assert b == pytest.approx(a, rel=1e-8, abs=1e-12) if isinstance(a, float) else a == b
    assert not re.search(r"#\s+(m|rad)\b|\((m|rad)\)", text)


def test_a_text_that_states_units_or_a_board_is_not_rewritten():
    with pytest.raises(ValueError, match="m and rad without boards"):
        rig_toml_in_units(PAIR, parse_length_and_angle_units("cm, deg"))
