"""Files that commands write and read again: those of older commits are read as they were meant, those of a newer rig or
of another kind are refused.

tests/data/written holds files as older commits wrote them. Of the formats only these changed: calibration.json has
schemas of its own for physics (2) and for maps in pose space (3), which a program that knows none would leave out;
limbs.json got `chosen` and `checks`, and means the six limbs alone where it has neither.
"""

import ast
import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from calib.api.workspace_change_by_calibration import load_certificate
from calib.diagnosis import geometry_refitted_with_diagnosed_effects
from calib.drift import visit_history
from calib.experiment import investigation_folder_and_report
from calib.files import calibration_file
from calib.online import accepted_measuring_limbs_file, information_filter_state_steps_and_json_file
from calib.online import forgetting_least_squares_kalman_and_gradient_learners as learners
from rig.cli.command_line import main
from rig.effects.texts.effect_file_from_formula import load_place_and_suggested_formula
from rig.errors import FileError
from rig.formats.importers import foreign_file_import_recipe as import_recipe
from rig.formats.local_and_remote_input_files import NAMED
from rig.formats.output_files import MANIFEST
from rig.formats.output_files.staged_folder_and_manifest import load_manifest
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.recording import recording_folder
from rig.report import verdict_refutations_and_result_display
from tests.conftest import ROOT
from tests.source_trees import nodes

DATA = ROOT / "tests" / "data"
ELSEWHERE = {
    "rig/1",
    "import/1",
    "investigation/1",
    "workspace/1",
    "geometry/1",
}  # below, in the tests of what holds it, or not read again


def looked_at(path: Path) -> None:
    """An investigation the first look of which proposed this."""
    folder = path.parent / "asked"
    (folder / "diagnosis1").mkdir(parents=True)
    (folder / "diagnosis1" / "diagnosis.json").write_text('{"schema": "diagnosis/1"}')
    path.rename(folder / "diagnosis1" / "next.json")
    investigation_folder_and_report.read_investigation_rounds(folder)


def listed(path: Path) -> None:
    """What was made in a folder."""
    path.rename(path.parent / MANIFEST)
    load_manifest(path.parent)


def held(path: Path) -> None:
    """A diagnosis that is to be taken into a calibration."""
    path.rename(path.parent / "diagnosis.json")
    geometry_refitted_with_diagnosed_effects.load_findings(
        path.parent, recording_folder.load_recording(DATA / "bench" / "check")
    )


def suggesting(path: Path) -> None:
    """A diagnosis that suggests a formula."""
    path.rename(path.parent / "diagnosis.json")
    load_place_and_suggested_formula(path.parent, None)


def refuted(path: Path) -> None:
    """What was refuted in a folder whose list this is."""
    verdict_refutations_and_result_display.load_refutations(
        path.rename(path.with_name(verdict_refutations_and_result_display.NAME)).parent
    )


READERS = {  # schema: what reads such files
    "calibration/3": (calibration_file.load,),
    "limbs/1": (accepted_measuring_limbs_file.load_limbs_of_any_verdict,),
    "online/1": (information_filter_state_steps_and_json_file.load_filter_state,),
    "learner/1": (learners.load_learner,),
    "watch/1": (lambda path: visit_history.read_history(path, ""),),
    "diagnosis/1": (held, suggesting),
    "next/1": (looked_at,),
    "made/1": (listed,),
    "refutations/1": (refuted,),
    "certificate/1": (lambda path: load_certificate(path, path),),
}
CASES = [(schema, reader) for schema, readers in READERS.items() for reader in readers]


@pytest.mark.parametrize("schema, reader", CASES, ids=lambda part: part if isinstance(part, str) else "")
def test_a_newer_file_and_one_of_another_kind_are_refused_with_their_place(schema, reader, tmp_path):
    kind, version = schema.split("/")
    newer = f"{kind}/{int(version) + 1}"
    for found, says in (
        (newer, f"was written by a newer rig: its schema is '{newer}', and this one reads .*\"{schema}\""),
        ("thermometer/1", f"its schema is 'thermometer/1', not .*\"{schema}\""),
        (None, f'its schema is None, not .*"{schema}"'),
    ):
        folder = tmp_path / str(found).replace("/", "-")
        folder.mkdir()
        (folder / "file.json").write_text(json.dumps({"schema": found, "files": {}, "origin": None}, indent=1))
        with pytest.raises(FileError, match=says) as refused:
            reader(folder / "file.json")
        assert str(folder) in str(refused.value) and (
            schema in ("made/1", "refutations/1") or ".json:2:12: " in str(refused.value)
        )


def test_a_newer_file_of_toml_and_a_newer_investigation_are_refused_with_their_place(tmp_path, capsys):
    text = (DATA / "bench" / "check" / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text.replace('"rig/1"', '"rig/2"'))
    with pytest.raises(
        FileError,
        match=r"rig.toml:1:\d+: was written by a newer rig: its schema is 'rig/2', and this one reads \"rig/1\"",
    ):
        design_from_rig_toml.load_design(tmp_path / "rig.toml")
    (tmp_path / "import.toml").write_text('\nschema = "import/2"\n')
    with pytest.raises(FileError, match=r"import.toml:2:\d+: was written by a newer rig: its schema is 'import/2'"):
        import_recipe.load_recipe(tmp_path / "import.toml")
    (tmp_path / "asked").mkdir()
    (tmp_path / "asked" / "investigation.json").write_text('{"schema": "investigation/2"}')
    (tmp_path / "rig.toml").write_text(text)
    assert (
        main(["investigate", str(tmp_path / "rig.toml"), "--by-hand", "--out", str(tmp_path / "asked"), "--resume"])
        == 1
    )
    assert (
        "investigation.json:1:12: was written by a newer rig: its schema is 'investigation/2'"
        in capsys.readouterr().err
    )


def test_every_schema_that_the_code_knows_is_held_here():
    files = [path for package in ("rig", "calib", "vision", "synthetic") for path in (ROOT / package).rglob("*.py")]
    values = [node.value for path in files for node in nodes(path) if isinstance(node, ast.Assign)]
    named = {
        node.value
        for node in values
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and NAMED.fullmatch(node.value)
    }
    held_here = {schema.split("/")[0] for schema in (*READERS, *ELSEWHERE)}
    assert (
        len(named) > 8 and {schema.split("/")[0] for schema in named} - {"struts"} <= held_here
    )  # the struts protocol is no file


def written(name: str, folder: Path) -> Path:
    """A file of an older commit, in a folder."""
    path = folder / name
    path.write_bytes(gzip.decompress((DATA / "written" / f"{name}.gz").read_bytes()))
    return path


def test_limbs_of_before_there_were_more_than_six_are_the_six(tmp_path):
    path = written("limbs-1.json", tmp_path)
    tree = json.loads(path.read_text())
    assert "chosen" not in tree and "checks" not in tree
    found = accepted_measuring_limbs_file.load_limbs_of_any_verdict(path)
    assert (
        found.verdict == "accepted" and found.limbs.checks is None and found.limbs.chosen.tolist() == [0, 1, 2, 3, 4, 5]
    )
    np.testing.assert_array_equal(found.limbs.hexapod.base_joints, tree["limbs"]["base_joints"])
    accepted_measuring_limbs_file.save_limbs(tmp_path / "again.json", found)
    result = json.loads((tmp_path / "again.json").read_text())
    assert result.pop("chosen") == [1, 2, 3, 4, 5, 6] and result.pop("checks") == [] and result == tree


@pytest.mark.parametrize(
    "name, schema", [("calibration-1.json", "calibration/1"), ("calibration-2.json", "calibration/2")]
)
def test_older_calibrations_correct_as_they_did(name, schema, tmp_path):
    path = written(name, tmp_path)
    tree = json.loads(path.read_text())
    assert tree["schema"] == schema
    found = calibration_file.load(path)
    np.testing.assert_array_equal(found.correction.fitted.base_joints, tree["fitted"]["base_joints"])
    assert (found.physics is not None) is (schema == "calibration/2")
    if found.physics is not None:
        (effect,) = found.physics.effects
        assert (effect.name, effect.place) == ("backlash", "strut 3") and effect.gap == pytest.approx(2e-4, rel=0.1)
    home = found.correction.nominal.home
    assert (
        1e-6 < np.abs(found.correction.uncorrected(home) - hexapod.inverse(home, found.correction.fitted)).max() < 5e-3
    )
    calibration_file.save(tmp_path / "again.json", found)
    result = json.loads((tmp_path / "again.json").read_text())
    result["claim"] = {key: result["claim"][key] for key in tree["claim"]}  # keys may be added, none changed
    assert {
        key: result[key]
        for key in ("schema", "nominal", "fitted", "parameter_covariance", "remainder", "held_out", "claim")
    } == {
        key: tree[key]
        for key in ("schema", "nominal", "fitted", "parameter_covariance", "remainder", "held_out", "claim")
    }


def test_a_diagnosis_of_before_there_were_suggestions_is_taken(tmp_path):
    written("diagnosis-1.json", tmp_path).rename(tmp_path / "diagnosis.json")
    written("machine-1.json", tmp_path).rename(tmp_path / "machine.json")
    assert "suggestions" not in json.loads((tmp_path / "diagnosis.json").read_text())
    (tmp_path / "rig.toml").write_bytes(gzip.decompress((DATA / "written" / "rig.toml.gz").read_bytes()))
    found = geometry_refitted_with_diagnosed_effects.load_findings(tmp_path, recording_of(tmp_path))
    assert [(effect.name, effect.place) for effect in found.effects] == [("backlash", "strut 3")]


def recording_of(folder: Path) -> recording_folder.Recording:
    """A recording of the rig that the diagnosis is of, without a frame that it knew."""
    (folder / "frames.csv").write_text("frame,t,camera,image\n0,1,,\n")
    (folder / "poses.csv").write_text("frame,x,y,z,rx,ry,rz\n0,0,0,0.45,0,0,0\n")
    return recording_folder.load_recording(folder)
