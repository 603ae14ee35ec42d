"""Poses and joints in one cell, tables in YAML and .mat files: the same recording, and errors with line and column."""

import json

import numpy as np
import pytest
import yaml
from scipy.io import savemat

from rig.model.mechanisms import arm_kinematics_limits_and_loads as serial
from rig.model.pose import pose_difference, pose_to_vector
from rig.recording.recording_folder import load_recording
from tests.cli import run

N = 8
FORMS = {
    "six": lambda T: pose_to_vector(T).tolist(),
    "seven": lambda T: [*T.translation.tolist(), *T.rotation.as_quat().tolist()],
    "matrix": lambda T: T.as_matrix().tolist(),
    "three rows": lambda T: T.as_matrix()[:3].tolist(),
    "by rows": lambda T: T.as_matrix().ravel().tolist(),
    "by columns": lambda T: T.as_matrix().T.ravel().tolist(),
}


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """(rig.toml, q (n, 6), T (n,)) of an arm."""
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    run("new", "design", "--arm", "ur10", "--out", path)
    from rig.formats.rig_toml.design_from_rig_toml import load_design

    q = np.random.default_rng(1).uniform(-1, 1, (N, 6)).round(6)
    return path, q, serial.forward(q, load_design(path).mechanism)


RADIANS = ("--set", "commands.unit=rad")


def imported(folder, arm, table, *more, ok=True, out="REC"):
    """`rig import` of one table of commands and poses."""
    return run("import", "--rig", arm[0], "--commands", table, "--poses", table, *more, "--out", folder / out, ok=ok)


def holds(folder, arm):
    found = load_recording(folder / "REC")
    np.testing.assert_allclose(found.commanded()[2], arm[1], atol=1e-12)
    assert np.abs(pose_difference(arm[2], found.poses.T_base_platform)).max() < 1e-9


def write_csv(folder, q, cells, header="pose"):
    rows = [f'{k},"{q_}","{cell}"' for k, (q_, cell) in enumerate(zip(q.tolist(), cells))]
    (folder / "data.csv").write_text("\n".join([f"t,joints,{header}", *rows]) + "\n")
    return folder / "data.csv"


@pytest.mark.parametrize("form", FORMS)
def test_a_pose_in_one_cell_is_read_in_every_form(tmp_path, arm, form):
    table = write_csv(tmp_path, arm[1], [FORMS[form](T) for T in arm[2]])
    stated = ("--set", "poses.rotation=quaternion-xyzw") if form == "seven" else ()
    done = imported(tmp_path, arm, table, *RADIANS, *stated)
    assert "data.csv: joints holds 6 numbers: axis1" in done.stdout and "data.csv: pose holds" in done.stdout
    holds(tmp_path, arm)
    recipe = tmp_path / "REC.import.toml"
    run("import", "--recipe", recipe, "--out", tmp_path / "AGAIN")
    assert (tmp_path / "AGAIN" / "poses.csv").read_text() == (tmp_path / "REC" / "poses.csv").read_text()


def test_numpy_and_matlab_write_lists_without_commas_and_units_stand_in_the_header(tmp_path, arm):
    _, q, T = arm
    rows = ["t;joints [deg];where [mm];rotation"]
    for k in range(N):
        angles, place = (" ".join(f"{x:.12f}" for x in v) for v in (np.degrees(q[k]), 1e3 * T[k].translation))
        turn = "; ".join(" ".join(f"{x:.12f}" for x in row) for row in T[k].rotation.as_matrix())
        rows.append(f'{k};[{angles}];[{place}];"[{turn}]"')
    (tmp_path / "data.csv").write_text("\n".join(rows) + "\n")
    imported(tmp_path, arm, tmp_path / "data.csv")
    holds(tmp_path, arm)


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_a_list_needs_no_quotation_marks(tmp_path, arm, separator):
    inside = separator if separator in ", " else ","
    rows = [separator.join(("t", "joints", "pose"))]
    for k in range(N):
        cells = [str(value).replace(",", inside) for value in (arm[1][k].tolist(), arm[2][k].as_matrix().tolist())]
        rows.append(separator.join((str(k), *cells)))
    (tmp_path / "data.csv").write_text("\n".join(rows) + "\n")
    imported(tmp_path, arm, tmp_path / "data.csv", *RADIANS)
    holds(tmp_path, arm)


GOOD = [[1.0, 0, 0, 0.5], [0, 1.0, 0, 0.1], [0, 0, 1.0, 0.2], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ([[1.0, 0, 0, 0.5], [0, 1.0, 0, 0.1], [0, 0, 1.1, 0.2], [0, 0, 0, 1]], "column 'pose' is no pose: a matrix of"),
        ([[1.0, 0, 0, 0.5], [0, 1.0, 0, 0.1], [0, 0, 1.0, 0.2], [0, 0, 0.5, 1]], "column 'pose' is no pose: a matrix"),
        ([[1.0, 0, 0], [0, 1.0, 0, 0.1]], "column 'pose' has rows of different lengths"),
        ([0.1, 0.2, 0.3, 0, 0, 0], "column 'pose' holds 6 numbers, and matrices of 4 x 4 in line 2"),
        ("[0.1, zero]", "column 'pose' is not a list of numbers, as of 'zero'"),
        ("none", "column 'pose' holds lists of numbers, and here none: 'none'"),
        ("[[1, 2], 3]", "column 'pose' is not a list of numbers"),
    ],
)
def test_a_cell_that_is_no_pose_is_named_with_line_and_column(tmp_path, arm, cell, message):
    cells = [GOOD] * N
    cells[4] = cell
    table = write_csv(tmp_path, arm[1], cells)
    error_text = imported(tmp_path, arm, table, *RADIANS, ok=False).stderr
    assert message in error_text and "data.csv:6:3:" in error_text


def test_as_many_numbers_as_mean_nothing_are_named(tmp_path, arm):
    table = write_csv(tmp_path, arm[1], [[0.1, 0.2, 0.3, 0.4, 0.5]] * N)
    error_text = imported(tmp_path, arm, table, *RADIANS, ok=False).stderr
    assert "data.csv:2:3: column 'pose' holds 5 numbers; a pose is 3, 6 or 7 numbers or a 4x4 matrix" in error_text


def test_a_list_of_rows_and_lists_of_columns_are_read_from_yaml(tmp_path, arm):
    _, q, T = arm
    rows = [
        {
            "t": k,
            "joints": q[k].tolist(),
            "pose": {
                "position": dict(zip("xyz", T[k].translation.tolist())),
                "orientation": dict(zip("xyzw", T[k].rotation.as_quat().tolist())),
            },
        }
        for k in range(N)
    ]
    (tmp_path / "rows.yaml").write_text(yaml.safe_dump(rows))
    imported(tmp_path, arm, tmp_path / "rows.yaml", *RADIANS)
    holds(tmp_path, arm)
    columns = {"t": list(range(N)), "joints": q.tolist(), "pose": T.as_matrix().tolist()}
    (tmp_path / "columns.yaml").write_text(json.dumps(columns))
    imported(tmp_path, arm, tmp_path / "columns.yaml", *RADIANS, out="TWO")
    assert (tmp_path / "TWO" / "commands.csv").read_text() == (tmp_path / "REC" / "commands.csv").read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- {t: 0, x: 1}\n- {t: 1, y: 1}\n", "bad.yaml:2:3: row 2 lacks x, which the first row has"),
        ("- {t: 0, x: 1}\n- {t: 1, x: 1, z: 2}\n", "bad.yaml:2:3: row 2 has z, which the first lacks"),
        ("t: [0, 1]\nx: [1, 2, 3]\n", "bad.yaml:2:4: x has 3 rows and t 2"),
        ("a:\n- {t: 0}\nb:\n- {t: 1}\n", "has several lists of tables, a, b; name the one that is meant commands"),
        ("t: 3\n", "holds no table: a list of rows"),
        ("- {t: 0, x: 1\n", "not valid YAML"),
    ],
)
def test_yaml_that_is_no_table_is_named_with_its_line(tmp_path, arm, text, message):
    (tmp_path / "bad.yaml").write_text(text)
    assert message in imported(tmp_path, arm, tmp_path / "bad.yaml", *RADIANS, ok=False).stderr


def of_matlab(arm, kind):
    _, q, T = arm
    stack, t = np.moveaxis(T.as_matrix(), 0, -1), np.arange(N, dtype=float)
    return {
        "variables": {"t": t, "joints": q, "pose": stack, "robot": "ur10", "gain": 3.0},
        "rows along": {"t": t[None], "joints": q.T, "pose": stack},
        "structure": {"log": {"t": t[:, None], "joints": q, "pose": stack}},
        "structures": {"log": [{"t": t[k], "joints": q[k], "pose": T[k].as_matrix()} for k in range(N)]},
    }[kind]


@pytest.mark.parametrize("kind", ["variables", "rows along", "structure", "structures"])
def test_variables_and_structures_are_read_from_matlab(tmp_path, arm, kind):
    path = tmp_path / "log.mat"
    savemat(path, of_matlab(arm, kind))
    imported(tmp_path, arm, path, *RADIANS)
    holds(tmp_path, arm)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + b" " * 90 + b"IM",
            "is a file of MATLAB 7.3, which is HDF5: save it",
        ),
        (
            b"MATLAB 5.0 MAT-file" + b" " * 105 + b"\x00\x01IM" + b"\x0f\x00\x00",
            "is not a readable .mat file (cut off?)",
        ),
        (b"", "is not a readable .mat file (cut off?)"),
    ],
)
def test_a_file_of_matlab_that_cannot_be_read_is_named(tmp_path, arm, content, message):
    (tmp_path / "log.mat").write_bytes(content)
    assert message in imported(tmp_path, arm, tmp_path / "log.mat", *RADIANS, ok=False).stderr


def test_variables_of_matlab_without_rows_in_common_are_named(tmp_path, arm):
    savemat(tmp_path / "log.mat", {"t": np.arange(5.0), "x": np.arange(7.0)})
    error_text = imported(tmp_path, arm, tmp_path / "log.mat", *RADIANS, ok=False).stderr
    assert "has no variables with as many rows as each other: t (5)" in error_text


def test_the_order_of_a_quaternion_in_a_cell_is_asked_for(tmp_path, arm):
    """Turns between poses are the same in both orders, so that commands do not decide."""
    table = write_csv(tmp_path, arm[1], [FORMS["seven"](T) for T in arm[2]])
    error_text = imported(tmp_path, arm, table, *RADIANS, ok=False).stderr
    assert (
        "--set 'poses.rotation=quaternion-wxyz'" in error_text
        and "--set 'poses.rotation=quaternion-xyzw'" in error_text
    )
