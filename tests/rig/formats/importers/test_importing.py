"""What people have becomes the same recording, whatever their dialect; what can be read in two ways is refused with
both.
"""

import json

import numpy as np
import pytest

from rig.cli.command_line import main
from rig.errors import RigError
from rig.formats import importers
from rig.formats.importers import foreign_table_units_and_timestamps
from rig.formats.rig_toml import design_from_rig_toml
from rig.recording import recording_folder
from tests.calib.checks.test_mistakes import run_in_process
from tests.rig.formats.importers.foreign import DIALECTS, export


def words(folder, files, dialect=None, *more):
    settings = (*(dialect.settings if dialect else ()), *more)
    return (
        "import",
        "--rig",
        folder / "rig.toml",
        *(word for name, path in files.items() for word in (f"--{name}", path)),
        *(word for setting in settings for word in ("--set", setting)),
    )


@pytest.mark.parametrize("dialect", DIALECTS, ids=lambda dialect: dialect.name)
def test_a_dialect_imports_to_the_same_arrays(dialect, good, tmp_path):
    files = export(good, tmp_path / "theirs", dialect, design_from_rig_toml.load_design(good / "rig.toml"))
    status, text = run_in_process(*words(good, files, dialect), "--out", tmp_path / "rec")
    assert status == 0, text
    assert text.splitlines()[0].startswith("imported: 60 frames, ") and "60 poses" in text.splitlines()[0]
    same(recording_folder.load_recording(good), recording_folder.load_recording(tmp_path / "rec"))
    assert run_in_process("import", "--recipe", tmp_path / "rec.import.toml", "--out", tmp_path / "again")[0] == 0
    for name in ("commands", "poses", "sensors", "frames"):
        assert (tmp_path / "again" / f"{name}.csv").read_text() == (tmp_path / "rec" / f"{name}.csv").read_text()


def same(a, b):
    """Two recordings are the same, times from their origins to a nanosecond."""
    assert (
        np.abs(a.commands.t - b.commands.t).max() < 1e-9 and np.abs(a.commands.values - b.commands.values).max() < 1e-12
    )
    assert np.abs(a.exposures.times()[1] - b.exposures.times()[1]).max() < 1e-9
    assert np.abs(a.sensors.t - b.sensors.t).max() < 1e-9
    name = "ambient_temperature_C"
    assert np.abs(a.sensors.channels[name] - b.sensors.channels[name]).max() < 1e-9
    order = np.argsort(b.poses.frame)
    apart = a.poses.T_base_platform.inv() * b.poses.T_base_platform[order]
    assert np.abs(apart.translation).max() < 2e-9 and apart.rotation.magnitude().max() < 2e-9


AMBIGUOUS = {
    "thousands or decimals": (
        dict(
            header=("t [s]", "L{} [mm]"),
            values=lambda q: [f"{v * 1e3:.3f}".replace(".", ",") for v in q],
            separator=";",
            time=lambda t: f"{t:.0f}",
        ),
        ("commands.decimal=comma", "commands.decimal=point"),
    ),
    "several times": (
        dict(header=("t [s];timestamp", "L{}"), separator=";", time=lambda t: f"{t};{t}"),
        ("commands.columns.t=t [s]", "commands.columns.t=timestamp"),
    ),
    "which column": (dict(header=("t", "beam{}")), ("commands.columns.l1=beam1", "commands.columns.l6=beam6")),
    "steps": (
        dict(header=("t", "l{} [steps]"), values=lambda q: [f"{v * 1e6:.0f}" for v in q]),
        ("commands.steps_per_mm=N",),
    ),
    "no unit fits": (
        dict(header=("t", "l{}"), values=lambda q: [f"{v * 5e5:.6f}" for v in q]),
        ("commands.unit=mm", "commands.relative=zero"),
    ),
    "different units": (dict(header=("t", "l{} [mm]"), last="l6 [m]"), ("commands.unit=mm",)),
}


@pytest.mark.parametrize("name", AMBIGUOUS)
def test_what_is_ambiguous_is_refused_with_what_decides(name, good, tmp_path):
    how, settings = AMBIGUOUS[name]
    c = recording_folder.load_recording(good).commands
    sep, time, values = (
        how.get("separator", ","),
        how.get("time", str),
        how.get("values", lambda q: [str(v) for v in q]),
    )
    header = [how["header"][0], *(how["header"][1].format(i) for i in range(1, 7))]
    header[-1] = how.get("last", header[-1])
    (tmp_path / "c.csv").write_text(
        "\n".join([sep.join(header), *(sep.join([time(t), *values(q)]) for t, q in zip(c.t, c.values))])
    )
    (tmp_path / "p.csv").write_bytes((good / "poses.csv").read_bytes())
    status, text = run_in_process(
        *words(good, {"commands": tmp_path / "c.csv", "poses": tmp_path / "p.csv"}), "--out", tmp_path / "rec"
    )
    assert status == 1 and "Traceback" not in text and not (tmp_path / "rec").exists()
    assert all(setting in text for setting in settings), text


def test_times_without_a_unit_are_told_by_what_can_be_or_refused():
    cells = [str(k * 20) for k in range(9)]
    assert (
        foreign_table_units_and_timestamps.read_times(
            cells, "commands", "x", None, None, 0.0, lambda t: t[-1] < 1 and t[-1] > 0.01
        ).unit
        == "ms"
    )
    with pytest.raises(
        RigError, match=r"160 s in all: --set 'commands.time_unit=s'(.|\n)*0.16 s in all: --set 'commands.time_unit=ms'"
    ):
        foreign_table_units_and_timestamps.read_times(cells, "commands", "x", None, None, 0.0)
    for unit, per in (("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)):
        cells = [str(1763800000 * per + k * per // 4) if per > 1 else f"{1763800000 + k / 4}" for k in range(3)]
        read = foreign_table_units_and_timestamps.read_times(cells, "commands", "x", None, None, 0.0)
        assert read.unit == unit and [float(t - read.seconds[0]) for t in read.seconds] == [0, 0.25, 0.5]


def test_iso_times_keep_nanoseconds_and_zones():
    read = foreign_table_units_and_timestamps.read_times(
        ["2026-01-31T12:00:00.000000001+01:00", "2026-01-31 11:00:00,5Z"], "x", "x", None, None, 0.0
    )
    assert [float(t - read.seconds[0]) for t in read.seconds] == [0, 0.499999999]
    with pytest.raises(RigError, match="some times state a time zone"):
        foreign_table_units_and_timestamps.read_times(
            ["2026-01-31T12:00:00Z", "2026-01-31T12:00:00"], "x", "x", None, None, 0.0
        )
    assert (
        "UTC"
        in foreign_table_units_and_timestamps.read_times(["2026-01-31T12:00:00"], "x", "x", None, None, 0.0).remarks[-1]
    )


def test_rotations_that_nothing_decides_are_refused(good, tmp_path):
    header, *rows = (good / "poses.csv").read_text().splitlines()
    (tmp_path / "p.csv").write_text(
        "\n".join([header.replace("rx,ry,rz", "rx [deg],ry [deg],rz [deg]").replace("frame", "t [s]"), *rows])
    )
    status, text = run_in_process(*words(good, {"poses": tmp_path / "p.csv"}), "--out", tmp_path / "rec")
    assert status == 1 and all(f"poses.rotation={notation}" in text for notation in ("rotvec", "zyx", "xyz")), text
    assert (
        run_in_process(
            *words(good, {"poses": tmp_path / "p.csv"}, None, "poses.rotation=zyx"), "--out", tmp_path / "rec"
        )[0]
        == 0
    )


def test_an_import_is_told_to_programs(good, tmp_path, capsys):
    files = export(good, tmp_path / "theirs", DIALECTS[0], design_from_rig_toml.load_design(good / "rig.toml"))
    assert main([str(word) for word in (*words(good, files), "--out", tmp_path / "rec", "--json")]) == 0
    out, remarks_on_it = capsys.readouterr()
    result = json.loads(out)
    assert (result["schema"], result["frames"], result["poses"]) == (
        "imported/1",
        60,
        60,
    ) and "imported: 60 frames" in remarks_on_it
    assert result["assumed"] and all(line in remarks_on_it for line in result["assumed"])


def test_settings_that_mean_nothing_are_refused(good, tmp_path):
    files = {"poses": good / "poses.csv"}
    for setting, says in (
        ("poses.unti=mm", "unknown key"),
        ("unit=mm", "KEY=VALUE"),
        ("poses.unit=yards", "must be one of"),
        ("commands.unit=mm", "not imported"),
        ("poses.shift=soon", "takes a number"),
        ("pozes.unit=mm", "unknown key 'pozes'"),
    ):
        status, text = run_in_process(*words(good, files, None, setting), "--out", tmp_path / "rec")
        assert status == 1 and says in text, (setting, text)


def test_what_is_imported_is_never_written_over(good, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "poses.csv").write_bytes((good / "poses.csv").read_bytes())
    recipe = tmp_path / "r.toml"
    recipe.write_text(
        f'schema = "import/1"\nrig = "{good}/rig.toml"\n[poses]\nfile = "in/poses.csv"\nrotation = '
        '"rotvec"\nunit = "m"\n'
    )
    status, text = run_in_process("import", "--recipe", recipe, "--out", tmp_path / "in", "--force")
    assert status == 1 and (tmp_path / "in" / "poses.csv").read_bytes() == (good / "poses.csv").read_bytes()
    assert importers.load_recipe(recipe).poses.rotation == "rotvec"
