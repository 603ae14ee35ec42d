"""Cubes that are not even are told in figures; a rig that is laid out as `rig new design` does it is left in peace."""

import re
import tomllib

import numpy as np
import pytest

from rig.cli.command_line import main
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Target, markers_of_target
from rig.model.pose import pose, pose_to_vector
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.calib.checks.good import make
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import unevenly_placed_cubes_remarks

TEXT = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=3, width=1280, height=1024, cubes=4)


def remarks_of(tmp_path, text):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return "\n".join(unevenly_placed_cubes_remarks(design_from_rig_toml.load_design(path)))


def moved(name, by):
    """The text with a cube moved by (3,) m."""
    head, tail = TEXT.split(f'name = "{name}"', 1)
    before, rest = tail.split("position = [", 1)
    numbers, rest = rest.split("]", 1)
    place = np.array(numbers.split(","), float) + by
    return f'{head}name = "{name}"{before}position = [{", ".join(f"{x:.9f}" for x in place)}]{rest}'


def test_a_rig_laid_out_evenly_is_left_in_peace(tmp_path):
    assert remarks_of(tmp_path, TEXT) == ""
    for cubes in (3, 5, 6):
        assert "circle" not in remarks_of(
            tmp_path, hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cubes=cubes)
        )


def test_a_cube_off_its_circle_is_told_with_radii_and_gaps(tmp_path):
    remarks = remarks_of(tmp_path, moved("P2", [0.02, 0.03, 0.0]))
    assert (
        remarks.startswith("rig.toml: the cubes on the platform are not evenly on a circle about its centre: radii ")
        and "(P2 is farthest" in remarks
    )
    assert "where 90.0 are even" in remarks and "heights" not in remarks
    high = remarks_of(tmp_path, moved("B1", [0, 0, 0.05]))
    assert "the cubes on the base are at heights from" in high and "circle" not in high


def listed(name, aside):
    """The text with a cube's faces listed as markers, the first one moved along its own axes by (2,) m."""
    target = next(entry for entry in tomllib.loads(TEXT)["target"] if entry["name"] == name)
    cube = Target(
        name,
        target["body"],
        target["dictionary"],
        target["edge"],
        target["marker"],
        tuple(target["faces"].items()),
        pose(target["pose"]["position"], target["pose"]["rotvec"]),
    )
    rows = [f'\n[[target]]\nname = "{name}"\nbody = "{cube.body}"\ndictionary = "{cube.dictionary}"\n']
    for k, marker in enumerate(markers_of_target(cube)):
        v = pose_to_vector(marker.pose * pose([*aside, 0] if k == 0 else [0, 0, 0], [0, 0, 0]))
        rows.append(
            f"[[target.marker]]\nid = {marker.id}\nside = {marker.side}\n"
            f"pose = {{ position = {v[:3].tolist()}, rotvec = {v[3:].tolist()} }}\n"
        )
    blocks = TEXT.split("[[target]]")
    return "[[target]]".join(block for block in blocks if f'name = "{name}"' not in block).rstrip() + "\n" + "".join(
        rows
    ), markers_of_target(cube)[0].id


def test_a_face_that_is_not_centred_is_told_with_its_marker(tmp_path):
    assert remarks_of(tmp_path, listed("P3", [0, 0])[0]) == ""
    text, number = listed("P3", [0.003, -0.002])
    remarks = remarks_of(tmp_path, text)
    assert f"faces of P3 are not centred: marker {number} by +" in remarks and "mm (right, up)" in remarks


def test_directions_and_cameras_that_see_nothing_are_told(tmp_path):
    blind = re.sub(r'faces = \{[^}]*"\+x" = (\d+)[^}]*\}', r'faces = { "+x" = \1 }', TEXT)
    one = "[[target]]".join(block for block in blind.split("[[target]]") if not re.search('name = "P[234]"', block))
    remarks = remarks_of(tmp_path, one)
    found = re.search(
        r"the platform shows no face towards (\d+) degrees \(level\): the nearest face there looks (\d+) "
        r"degrees away, (\d+)% of",
        remarks,
    )
    assert found and 175 <= int(found[2]) <= 180 and 60 <= int(found[3]) <= 68, (
        "a single face, seen within 65 degrees on either side"
    )
    assert (
        re.search(r"camera cam\d sees [01] of 1 markers of the platform", remarks) and "the base shows" not in remarks
    )


def test_the_command_remarks_and_does_not_refuse(tmp_path, capsys):
    rec = make("poses", tmp_path / "rec", 0)
    text = (rec / "rig.toml").read_text()
    head, tail = text.split('name = "P1"', 1)
    number = tail.split("position = [", 1)[1].split(",", 1)[0]
    (rec / "rig.toml").write_text(head + 'name = "P1"' + tail.replace(number, f"{float(number) + 0.006:.6f}", 1))
    assert main(["check", str(rec)]) == 0
    output = capsys.readouterr().out
    assert output.startswith(
        "nothing wrong or unlikely was found\nremark: rig.toml: the cubes on the platform are not evenly on a circle"
    )


@pytest.mark.parametrize("mechanism", ["arm", "free"])
def test_rigs_without_a_home_are_looked_at_too(tmp_path, mechanism):
    kind = 'kind = "free"' if mechanism == "free" else 'kind = "arm"\njoints = [[0, 0, 1, 0]]\nlimits = [[-1, 1]]'
    head, tail = TEXT.split("[mechanism]", 1)
    assert remarks_of(tmp_path, f"{head}[mechanism]\n{kind}\n\n[actuator]{tail.split('[actuator]', 1)[1]}") == ""
