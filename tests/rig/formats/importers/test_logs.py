"""Trajectories of TUM, samples of LinuxCNC's halsampler and Parquet tables become the same recording; poses and tables
go out and come back.
"""

import builtins
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rig.errors import FileError, MissingLibrary
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.importers import foreign_csv_dialect_detection as csv_dialect
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.recording import recording_folder
from tests.calib.checks.test_mistakes import run_in_process
from tests.rig.formats.importers.foreign import columns
from tests.rig.formats.importers.test_importing import same, words

EPOCH = 1763800000


def tum(folder, out, header):
    """A TUM trajectory of a recording's poses, written with SciPy's quaternions, real part last."""
    frames, p = columns(folder / "frames.csv"), columns(folder / "poses.csv")
    at = dict(zip(frames["frame"], frames["t"]))
    v = np.array([p[name] for name in ("x", "y", "z", "rx", "ry", "rz")], float).T
    q = Rotation.from_rotvec(v[:, 3:]).as_quat()
    rows = [
        " ".join([at[frame], *(repr(float(value)) for value in row)])
        for frame, row in zip(p["frame"], np.column_stack([v[:, :3], q]))
    ]
    out.write_text("\n".join([*(["# timestamp tx ty tz qx qy qz qw"] if header else []), *rows]) + "\n")
    return out


@pytest.mark.parametrize("header", [True, False])
def test_a_tum_trajectory_is_read_with_and_without_its_header(header, good, tmp_path):
    files = {
        "commands": good / "commands.csv",
        "poses": tum(good, tmp_path / "poses.tum", header),
        "sensors": good / "sensors.csv",
    }
    status, text = run_in_process(*words(good, files, None, "commands.unit=m"), "--out", tmp_path / "rec")
    assert status == 0 and ("a trajectory as TUM's" in text) != header, text
    same(recording_folder.load_recording(good), recording_folder.load_recording(tmp_path / "rec"))
    assert run_in_process("import", "--recipe", tmp_path / "rec.import.toml", "--out", tmp_path / "again")[0] == 0


def test_a_tum_trajectory_goes_out(good, tmp_path):
    assert run_in_process("export", good, "--format", "tum", "--out", tmp_path / "poses.tum")[0] == 0
    rows = np.loadtxt(tmp_path / "poses.tum")
    loaded = recording_folder.load_recording(good)
    T = RigidTransform.from_components(rows[:, 1:4], Rotation.from_quat(rows[:, 4:]))
    apart = loaded.poses.T_base_platform.inv() * T
    assert len(rows) == 60 and np.abs(apart.translation).max() < 1e-11 and apart.rotation.magnitude().max() < 1e-11
    assert np.array_equal(rows[:, 0], loaded.exposures.times()[1])
    shutil.copytree(good, tmp_path / "rec")
    (tmp_path / "rec" / "poses.csv").unlink()
    assert run_in_process("export", tmp_path / "rec", "--format", "tum", "--out", tmp_path / "x.tum")[0] == 1


def sampled(folder, out, tag, lost=()):
    """What halsampler prints of a recording's commands, in mm, a sample a second: `%d ` where tagged, then `%f `
    each.
    """
    c = columns(folder / "commands.csv")
    t, q = np.array(c["t"], float), np.array([c[f"l{i}"] for i in range(1, 7)], float).T * 1e3
    lines = []
    for n in range(int(t[-1]) + 2):
        if n in lost:
            if lines[-1] != "overrun":
                lines.append("overrun")
            continue
        lines.append((f"{n} " if tag else "") + "".join(f"{np.interp(n, t, column):f} " for column in q.T))
    out.write_text("\n".join(lines) + "\n")
    return out


def test_samples_of_linuxcnc_are_commands_at_their_times(good, tmp_path):
    log = sampled(good, tmp_path / "struts.log", True, lost=(7, 8, 20))
    files = {"commands": log, "poses": tum(good, tmp_path / "poses.tum", False)}
    settings = ("commands.header=sample l1 l2 l3 l4 l5 l6", "commands.period=1.0")
    status, text = run_in_process(*words(good, files, None, *settings), "--out", tmp_path / "rec")
    assert "samples were lost 2 times, first at line" in text, text
    assert status == 0, text
    found = recording_folder.load_recording(tmp_path / "rec").commands
    c = columns(good / "commands.csv")
    for t, row in zip(found.t, found.values):
        wanted = [np.interp(t, np.array(c["t"], float), np.array(c[f"l{i}"], float)) for i in range(1, 7)]
        assert np.abs(row - wanted).max() < 1e-9
    assert 7 not in found.t and 8 not in found.t and np.array_equal(found.t, np.round(found.t))


def test_samples_lost_that_nothing_counts_are_refused(good, tmp_path):
    log = sampled(good, tmp_path / "struts.log", False, lost=(7,))
    files = {"commands": log, "poses": tum(good, tmp_path / "poses.tum", False)}
    status, text = run_in_process(
        *words(good, files, None, "commands.header=l1 l2 l3 l4 l5 l6", "commands.period=1"), "--out", tmp_path / "rec"
    )
    assert status == 1 and "struts.log:8: samples were lost here" in text
    sampled(good, log, False)
    status, text = run_in_process(
        *words(good, files, None, "commands.header=l1 l2 l3", "commands.period=1"), "--out", tmp_path / "rec"
    )
    assert status == 1 and "struts.log:1: has 6 cells in a row, and commands.header names 3 columns" in text


@pytest.mark.parametrize(
    "header, says",
    [
        (None, "log:1: has no header line: name its 3 columns, --set 'commands.header=..'"),
        ("t l1", "log:1: has 3 cells in a row, and commands.header names 2"),
    ],
)
def test_names_that_columns_lack_are_asked_for(header, says, tmp_path):
    (tmp_path / "log").write_text("0 0.41 0.42\n1 0.43 0.44\n2 0.45 0.46\n")
    with pytest.raises(FileError) as refused:
        csv_dialect.read_foreign_table_header_and_cells(ForeignTable(tmp_path / "log", header=header), "commands")
    assert says in str(refused.value)


def test_parquet_tables_come_in_as_csv_does(good, tmp_path):
    frames, c, p = (columns(good / f"{name}.csv") for name in ("frames", "commands", "poses"))
    at = dict(zip(frames["frame"], frames["t"]))
    stamps = pa.array([round(float(t) * 1e9) + EPOCH * 10**9 for t in c["t"]], pa.timestamp("ns", "UTC"))
    pq.write_table(
        pa.table({"stamp": stamps, **{f"leg{i} [mm]": np.array(c[f"l{i}"], float) * 1e3 for i in range(1, 7)}}),
        tmp_path / "c.parquet",
    )
    pq.write_table(
        pa.table(
            {
                "t": pa.array([round(float(at[f]) * 1e9) + EPOCH * 10**9 for f in p["frame"]], pa.int64()),
                **{name: np.array(p[name], float) for name in ("x", "y", "z", "rx", "ry", "rz")},
            }
        ),
        tmp_path / "p.parquet",
    )
    files = {"commands": tmp_path / "c.parquet", "poses": tmp_path / "p.parquet"}
    status, text = run_in_process(
        *words(good, files, None, "poses.rotation=rotvec", "poses.unit=m"), "--out", tmp_path / "rec"
    )
    assert status == 0, text
    a, b = recording_folder.load_recording(good), recording_folder.load_recording(tmp_path / "rec")
    assert (
        np.abs(a.commands.values - b.commands.values).max() < 1e-12 and np.abs(a.commands.t - b.commands.t).max() < 2e-9
    )
    assert run_in_process("import", "--recipe", tmp_path / "rec.import.toml", "--out", tmp_path / "again")[0] == 0


def test_tables_go_out_as_parquet(good, tmp_path):
    assert run_in_process("export", good, "--format", "parquet", "--out", tmp_path / "tables")[0] == 0
    for name in ("commands", "frames", "poses", "sensors"):
        table, csv = pq.read_table(tmp_path / "tables" / f"{name}.parquet"), columns(good / f"{name}.csv")
        assert table.column_names == list(csv)
        for key, cells in csv.items():
            values = table[key].to_pylist()
            assert values == (cells if key in ("camera", "image") else [float(cell) for cell in cells])
    assert pq.read_schema(tmp_path / "tables" / "poses.parquet").field("frame").type == pa.int64()


def test_what_is_no_parquet_is_refused_and_a_missing_library_says_what_installs_it(good, tmp_path, monkeypatch):
    whole = csv_and_parquet_tables_and_time_origin.parquet_bytes({"t": [0.0, 1.0], "l1": [1.0, 2.0]})
    bad = {
        "text": b"t,l1\n",
        "half": whole[: len(whole) // 2],
        "empty": csv_and_parquet_tables_and_time_origin.parquet_bytes({"t": [], "l1": []}),
        "none": csv_and_parquet_tables_and_time_origin.parquet_bytes({"t": [0.0, None], "l1": [1.0, 2.0]}),
        "lists": csv_and_parquet_tables_and_time_origin.parquet_bytes({"t": [[0.0]], "l1": [1.0]}),
    }
    for name, data in bad.items():
        (tmp_path / f"{name}.parquet").write_bytes(data)
        status, text = run_in_process(
            *words(good, {"commands": tmp_path / f"{name}.parquet", "poses": good / "poses.csv"}),
            "--out",
            tmp_path / "rec",
        )
        assert status == 1 and f"{name}.parquet: " in text and "Traceback" not in text, text
    whole_import = builtins.__import__

    def without(name, *rest, **more):
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return whole_import(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingLibrary, match=r"pip install 'rig\[parquet\]'"):
        csv_and_parquet_tables_and_time_origin.read_parquet_cells(tmp_path / "half.parquet")
