"""Cubes on sheets: what hangs together folds to a cube, every edge is glued once, nothing leaves the paper, papers too
small are refused.
"""

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from rig.cli.command_line import main
from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from synthetic import cube_nets_stl_rulers_and_assembly_page
from synthetic import printable_target_sheets as print_sheets
from synthetic.cube_nets_stl_rulers_and_assembly_page import (
    FRAMES,
    NET,
    PARTITIONS,
    SIDES,
    Size,
    arrange_cube_net_on_sheets,
    cube_net_pieces,
    printable_paper_area,
    target_outline_from_above,
)


@pytest.mark.parametrize("groups", PARTITIONS)
def test_every_edge_of_a_cube_is_folded_or_glued_once(groups):
    found = cube_net_pieces(groups)
    flaps, folds = (list(chain(*(getattr(piece, kind) for piece in found))) for kind in ("flaps", "folds"))
    assert len(flaps) + len(folds) == 12 and len(folds) == 6 - len(groups) and len(set(flaps)) == len(flaps)
    assert sorted(chain(*(piece.faces for piece in found))) == sorted(NET)


def test_neighbours_in_the_net_are_neighbours_on_the_cube():
    for face, (normal, right, up) in FRAMES.items():
        for other, place in NET.items():
            step = tuple(np.subtract(place, NET[face]))
            flipped = {"+": "-", "-": "+"}
            towards = {
                SIDES["r"]: right,
                SIDES["t"]: up,
                SIDES["l"]: flipped[right[0]] + right[1],
                SIDES["b"]: flipped[up[0]] + up[1],
            }
            if step in towards:
                assert towards[step] == other
        x, y, z = ((1 if name[0] == "+" else -1) * np.eye(3)["xyz".index(name[1])] for name in (right, up, normal))
        np.testing.assert_array_equal(np.cross(x, y), z)  # seen from outside, not mirrored


@pytest.mark.parametrize("paper", ["A4", "Letter", "A3"])
@pytest.mark.parametrize("edge", [20.0, 51.0, 66.0, 93.0, 131.0, 170.0])
def test_nothing_leaves_the_paper_or_lies_on_another(paper, edge):
    size, found = arrange_cube_net_on_sheets(
        edge, printable_paper_area(print_sheets.PAPER[paper]), printable_paper_area(print_sheets.PAPER[paper][::-1])
    )
    for sheet in found:
        room = printable_paper_area(print_sheets.PAPER[paper][::-1] if sheet.turned else print_sheets.PAPER[paper])
        boxes = [np.array(one.piece.box(size)) + np.array([one.x, one.y] * 2) for one in sheet.placed]
        assert all((box >= -1e-9).all() and box[2] <= room[0] + 1e-9 and box[3] <= room[1] + 1e-9 for box in boxes)
        assert not any(
            a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for k, a in enumerate(boxes) for b in boxes[:k]
        )
    assert sorted(chain(*(one.piece.faces for sheet in found for one in sheet.placed))) == sorted(NET)


def test_flaps_are_in_the_box_and_large_faces_go_without():
    left, bottom, right, top = cube_net_pieces(PARTITIONS[0])[0].box(Size(50.0, 7.0))
    assert (left, bottom, right, top) == (-7.0, 0.0, 200.0, 150.0)
    assert arrange_cube_net_on_sheets(176.0, (183.0, 257.0), (270.0, 170.0))[0].flap == 0.0
    with pytest.raises(RigError, match="larger than the 183 x 257 mm"):
        arrange_cube_net_on_sheets(184.0, (183.0, 257.0), (270.0, 170.0))


@pytest.fixture
def two_cubes(tmp_path, capsys):
    assert main(["design", "--radius", "0.3", "--cubes", "2", "--out", str(tmp_path / "rig.toml")]) == 0
    capsys.readouterr()
    return tmp_path / "rig.toml"


@pytest.mark.slow
def test_sheets_of_a_rig_are_on_the_paper_asked_for(two_cubes, tmp_path, capsys):
    assert (
        main(
            [
                "print",
                str(two_cubes),
                "--out",
                str(tmp_path / "s.pdf"),
                "--paper",
                "Letter",
                "--stl",
                str(tmp_path / "stl"),
            ]
        )
        == 0
    )
    output = capsys.readouterr().out
    assert "sheet 6 of 6: Letter" in output and "A3" not in output and "4 bodies" in output
    assert sorted(path.name for path in (tmp_path / "stl").glob("*.stl")) == ["B1.stl", "B2.stl", "P1.stl", "P2.stl"]
    for words, says in (
        (["--paper", "B5"], "takes A4, Letter"),
        (["--paper-thickness", "80mm", "--stl", str(tmp_path / "no")], "nothing of its"),
    ):
        assert main(["print", str(two_cubes), "--out", str(tmp_path / "t.pdf"), *words]) == 1
        assert says in capsys.readouterr().err and not (tmp_path / "t.pdf").exists()


def test_a_face_too_large_names_the_paper_that_would_do(two_cubes):
    target = replace(design_from_rig_toml.load_design(two_cubes).targets[0], edge=0.25, marker=0.2)
    with pytest.raises(RigError, match="it fits --paper A3"):
        print_sheets.sheets_of_target(target, "A4")


def test_bodies_are_smaller_by_the_paper(two_cubes):
    import io

    import trimesh

    design = design_from_rig_toml.load_design(two_cubes)
    body = trimesh.load_mesh(
        io.BytesIO(cube_nets_stl_rulers_and_assembly_page.cube_stl_bytes_by_target(design, 2e-4)["P1"]), file_type="stl"
    )
    np.testing.assert_allclose(body.extents, (design.targets[0].edge - 4e-4) * 1e3, rtol=1e-6)
    assert body.is_watertight


def test_a_cube_from_above_has_its_edge_and_place(two_cubes):
    target = design_from_rig_toml.load_design(two_cubes).targets[0]
    shape = target_outline_from_above(target)
    np.testing.assert_allclose(np.linalg.norm(np.roll(shape, -1, axis=0) - shape, axis=1), target.edge, rtol=1e-9)
    np.testing.assert_allclose(shape.mean(axis=0), target.pose.translation[:2], atol=1e-12)
