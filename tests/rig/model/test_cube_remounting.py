"""Cubes that are put back turned: what a rig.toml and a plan may say of them, where their faces look, and which
recordings share a seat.
"""

from dataclasses import replace

import numpy as np
import pytest

from rig.errors import FileError, RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import quarter_turns_of_cubes
from rig.model.design_contradictions_and_cube_quarter_turns import design_with_turned_cubes, rig_toml_with_turns
from rig.planning.recording_plan import build_plan
from rig.planning.timed_plan_and_visiting_order import write_plan_table
from rig.recording import combined_recordings
from vision.marker_corner_prediction import marker_map


def refused(path, text, added):
    """(line, value, message) with which a rig.toml is refused."""
    path.write_text(text + added)
    with pytest.raises(FileError) as caught:
        design_from_rig_toml.load_design(path)
    return caught.value.line, caught.value.value, str(caught.value)


def test_what_a_rig_toml_says_of_cubes(rig_text, tmp_path):
    path, lines = tmp_path / "rig.toml", len(rig_text.splitlines())
    path.write_text(rig_text + '\n[experiment]\nmay = ["wait", "turn cube 2", "turn cube B1"]\n[turned]\nP1 = 1\n')
    design = design_from_rig_toml.load_design(path)
    assert design.experiment.may == ("wait", "turn cube P2", "turn cube B1") and design.experiment.cubes == ("P2", "B1")
    assert quarter_turns_of_cubes(design) == {"P1": 1}
    line, value, says = refused(path, rig_text, '[experiment]\nmay = ["turn cube P9"]\n')
    assert (line, value) == (
        lines + 2,
        "turn cube P9",
    ) and "there is no cube 'P9'; there are P1, P2, P3, P4, B1" in says
    assert refused(path, rig_text, '[experiment]\nmay = ["turn cube 9"]\n')[1] == "turn cube 9"
    line, value, says = refused(path, rig_text, "[turned]\nP2 = 1\nQ1 = 1\n")
    assert (line, value) == (lines + 3, "Q1") and "no cube 'Q1'" in says
    assert (
        "turned.P1 must be a whole number of at least 0 and at most 3, not 4"
        in refused(path, rig_text, "[turned]\nP1 = 4\n")[2]
    )
    assert "nothing defines its frame" in refused(path, rig_text, "[turned]\nP1 = 1\nP2 = 1\nP3 = 0\nP4 = 2\n")[2]


def test_a_turned_cube_looks_the_other_way_and_stays_where_it_is(design):
    before, after = marker_map(design), marker_map(design_with_turned_cubes(design, {"P1": 1}))
    ids = dict(next(t for t in design.targets if t.name == "P1").faces)
    row = {face: int(np.flatnonzero(before.id == number)[0]) for face, number in ids.items()}
    np.testing.assert_allclose(
        after.corners[row["+x"]].mean(axis=0), before.corners[row["+y"]].mean(axis=0), atol=1e-12
    )
    np.testing.assert_allclose(
        after.T_body_marker[row["-y"]].as_matrix(), before.T_body_marker[row["+x"]].as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(
        after.corners[row["+z"]].mean(axis=0), before.corners[row["+z"]].mean(axis=0), atol=1e-12
    )
    others = ~np.isin(before.id, list(ids.values()))
    assert (after.corners[others] == before.corners[others]).all()
    with pytest.raises(RigError, match="no cube 'P7'"):
        design_with_turned_cubes(design, {"P7": 1})


def test_a_plan_says_how_cubes_stand(design, tmp_path):
    path, axes = tmp_path / "plan.csv", design.mechanism.axes
    write_plan_table(path, build_plan(design, "turn:P1,turn:B2,sobol:3"), axes)
    assert path.read_text().startswith("frame,t,payload_mass_kg,turned_P1,turned_B2,l1")
    assert build_plan(design, f"commands:{path}").turned == (("P1", 1), ("B2", 1))
    assert build_plan(design_with_turned_cubes(design, {"P1": 3}), "turn:P1,sobol:3").turned == (("P1", 1),)
    with pytest.raises(RigError, match="is turned before a plan begins"):
        build_plan(design, "sobol:3,turn:P1")
    with pytest.raises(RigError, match="no cube 'P8'"):
        build_plan(design, "turn:P8,sobol:3")
    text = path.read_text()
    path.write_text(text.replace("turned_P1", "turned_P8"))
    with pytest.raises(FileError, match="no cube 'P8'") as caught:
        build_plan(design, f"commands:{path}")
    assert (caught.value.line, caught.value.column) == (1, 4)
    rows = text.splitlines()
    cells = rows[3].split(",")
    path.write_text("\n".join([*rows[:3], ",".join([*cells[:3], "2", *cells[4:]]), *rows[4:]]) + "\n")
    with pytest.raises(FileError, match="stands so for the whole plan, not by 2") as caught:
        build_plan(design, f"commands:{path}")
    assert caught.value.line == 4


def test_the_text_of_a_rig_says_it_and_keeps_its_comments(rig_text, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(rig_toml_with_turns("# ours\n" + rig_text, {"P1": 2}))
    assert quarter_turns_of_cubes(design_from_rig_toml.load_design(path)) == {"P1": 2} and path.read_text().startswith(
        "# ours\n"
    )
    assert rig_toml_with_turns(rig_text, {}) == rig_text


def test_recordings_share_a_seat_until_the_cube_is_turned_again(design):
    stood = [
        design_with_turned_cubes(design, {} if quarter is None else {"P1": quarter})
        for quarter in (None, 1, 1, 0, 0, None, 1)
    ]
    assert [own["P1"] for own in combined_recordings.last_remount_recording_by_target(stood)] == [0, 1, 1, 3, 3, 0, 6]
    assert all(own["P2"] == 0 for own in combined_recordings.last_remount_recording_by_target(stood))


def test_a_cube_that_is_alone_on_its_body_stays(design):
    alone = replace(design, targets=tuple(t for t in design.targets if t.name in ("P1", "B1", "B2")))
    with pytest.raises(RigError, match="only target of the platform"):
        design_with_turned_cubes(alone, {"P1": 1})
