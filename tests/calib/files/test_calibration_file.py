"""calibration.json: what goes in comes out, and what is none is refused with its place."""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.platform_certification import certify_platform, platform_workspace_claim
from calib.files import calibration_file
from calib.models import machine_parameters_and_file_entries as machine_models
from rig.errors import FileError
from rig.formats.json_toml_and_yaml_loading import Places, first_repeated_key_and_position
from rig.model.mechanisms import hexapod
from tests.calib.correction.test_machine_correction import wavy
from tests.calib.noisy_samples import sampled, workspace


@pytest.fixture(scope="module")
def calibration(design):
    samples, _ = sampled(design, 5, count=150, deviation=wavy)
    done = certify_platform(samples, design.mechanism, np.random.default_rng(0))
    claim = platform_workspace_claim(samples, done, np.random.default_rng(0))
    return Calibration(
        done.correction, done.found.covariance, done.found.scatter, (1, 2), (3,), done.held_out, {"seed": 0}, claim
    )


def test_what_is_saved_corrects_as_before(calibration, design, tmp_path):
    calibration_file.save(tmp_path / "c.json", calibration)
    loaded = calibration_file.load(tmp_path / "c.json")
    wanted = workspace(design, 20)
    np.testing.assert_allclose(loaded.correction.inverse(wanted), calibration.correction.inverse(wanted), atol=1e-12)
    assert (
        loaded.held_out == calibration.held_out
        and loaded.claim == calibration.claim
        and loaded.frames == (1, 2)
        and loaded.left_out == (3,)
    )
    np.testing.assert_allclose(loaded.covariance, calibration.covariance)
    tree = json.loads((tmp_path / "c.json").read_text())
    assert tree["schema"] == "calibration/1" and "m, rad" in tree["units"] and "T_base_platform" in tree["frames"]
    assert not list(tmp_path.glob("*.part"))
    assert hexapod.inverse(wanted, loaded.correction.fitted).shape == (20, 6)


def test_few_configurations_keep_the_files_shape(calibration, design, tmp_path):
    samples, _ = sampled(design, 6, count=5)
    done = certify_platform(samples, design.mechanism, np.random.default_rng(0))
    few = replace(
        calibration,
        correction=done.correction,
        held_out=done.held_out,
        claim=platform_workspace_claim(samples, done, np.random.default_rng(0)),
    )
    calibration_file.save(tmp_path / "c.json", few)
    tree, reloaded = json.loads((tmp_path / "c.json").read_text()), calibration_file.load(tmp_path / "c.json")
    assert tree["held_out"]["after"] == {
        "n": 0,
        "position": [None] * 3,
        "rotation": [None] * 3,
        "bias": [None] * 6,
        "mean": [None] * 2,
    }
    assert reloaded.held_out is None and reloaded.claim == few.claim and "takes 8" in reloaded.claim.reason


def test_a_file_of_before_there_was_a_claim_is_read(calibration, tmp_path):
    calibration_file.save(tmp_path / "c.json", calibration)
    tree = json.loads((tmp_path / "c.json").read_text())
    del tree["claim"], tree["held_out"]["configurations"]
    (tmp_path / "c.json").write_text(json.dumps(tree))
    assert (
        calibration_file.load(tmp_path / "c.json").claim is None
        and calibration_file.load(tmp_path / "c.json").held_out.configurations == 150
    )


def test_what_struts_do_together_is_read_as_it_was_written(calibration, tmp_path):
    together = np.diag([4e-12] * 6) + 1e-12
    known = replace(calibration, scatter=np.sqrt(np.diag(together)), strut_covariance=together)
    calibration_file.save(tmp_path / "c.json", known)
    np.testing.assert_allclose(calibration_file.load(tmp_path / "c.json").strut_covariance, together)
    edited(tmp_path / "c.json", strut_scatter__0=5e-6)
    with pytest.raises(FileError, match="squares of strut_scatter on its diagonal"):
        calibration_file.load(tmp_path / "c.json")
    calibration_file.save(tmp_path / "c.json", calibration)
    assert (
        "strut_covariance" not in (tmp_path / "c.json").read_text()
        and calibration_file.load(tmp_path / "c.json").strut_covariance is None
    )


@pytest.mark.parametrize(
    "spoil, says",
    [
        (lambda text: text[: len(text) // 2], "not valid JSON.*cut off"),
        (lambda text: text.replace("calibration/1", "calibration/9"), "calibration/9"),
        (lambda text: "[]", "no calibration"),
        (lambda text: text.replace('"fitted"', '"futted"'), "fitted is missing; is 'futted' meant"),
        (
            lambda text: text.replace('"base_joints": [', '"base_joints": [[1, 2, 3],', 1),
            "base_joints must have 6x3 numbers, got 7 entries",
        ),
    ],
)
def test_what_is_no_calibration_is_refused(calibration, tmp_path, spoil, says):
    calibration_file.save(tmp_path / "c.json", calibration)
    (tmp_path / "c.json").write_text(spoil((tmp_path / "c.json").read_text()))
    with pytest.raises(FileError, match=says):
        calibration_file.load(tmp_path / "c.json")


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        calibration_file.load(tmp_path / "typo.json")


def edited(path, **changes):
    """A saved calibration with values put elsewhere; the keys of changes are paths joined by two underscores."""
    tree = json.loads(path.read_text())
    for name, value in changes.items():
        *above, last = (int(part) if part.isdigit() else part for part in name.split("__"))
        at = tree
        for part in above:
            at = at[part]
        at[last] = value
    path.write_text(json.dumps(tree, indent=1))


@pytest.mark.parametrize(
    "changes, says, key",
    [
        (
            {"units": "mm, deg, s; covariances in their products"},
            "units is 'mm, deg.* where this version expects 'm, rad",
            "units",
        ),
        (
            {"frames": machine_models.FRAMES.replace("on the right", "on the left")},
            "frames is .*on the left.*nothing is converted",
            "frames",
        ),
        (
            {"parameter_order": "platform joints 1..6 (x y z), base joints 1..6 (x y z), strut zeros 1..6"},
            "parameter_order is 'plat",
            "parameter_order",
        ),
        ({"schema": "calibration/2"}, "physics is missing, and a file of schema 'calibration/2' has it", "schema"),
        ({"schema": "calibration/3"}, "pose_maps is missing", "schema"),
        ({"physics": {}}, "physics is there, and a file of schema 'calibration/1' has none", "physics"),
        ({"pose_maps": []}, "pose_maps is there", "pose_maps"),
        (
            {"nominal__strut_range__2": [-3.0, 40.0]},
            r"nominal.strut_range\[3\] must be positive and run from small.*, not -3 .. 40 m",
            "strut_range",
        ),
        ({"nominal__strut_range__2": [0.6, 0.4]}, r"strut_range\[3\] must be positive", "strut_range"),
        (
            {"nominal__strut_range__2": [20.0, 40.0]},
            "home needs strut 3 at .* outside its strut_range 20 .. 40",
            "home",
        ),
        (
            {"fitted__strut_range__2": [0.1, 40.0]},
            r"fitted.strut_range\[3\] is \[0.1, 40.0\] m and nominal.strut_range\[3\]",
            "strut_range",
        ),
        (
            {"fitted__strut_zeros__1": 30.0},
            r"fitted.strut_zeros\[2\] = 30 m is more than the strut's greatest length",
            "strut_zeros",
        ),
        ({"nominal__base_joints__0": [291.0, 72.0, 0.0]}, "metres", "base_joints"),
    ],
)
def test_a_file_that_means_something_else_is_refused_with_its_line(calibration, tmp_path, changes, says, key):
    path = tmp_path / "c.json"
    calibration_file.save(path, calibration)
    edited(path, **changes)
    with pytest.raises(FileError, match=says) as caught:
        calibration_file.load(path)
    lines = path.read_text().splitlines()
    assert any(f'"{key}"' in line for line in lines[max(caught.value.line - 20, 0) : caught.value.line])


def test_a_key_that_is_there_twice_is_refused_with_the_line_of_the_second(calibration, tmp_path):
    path = tmp_path / "c.json"
    calibration_file.save(path, calibration)
    text = path.read_text()
    path.write_text(text.replace('"strut_zeros": [', '"strut_zeros": [0, 0, 0, 0, 0, 0],\n  "strut_zeros": [', 1))
    with pytest.raises(FileError, match="key 'strut_zeros' occurs twice in one table") as caught:
        calibration_file.load(path)
    assert (
        path.read_text().splitlines()[caught.value.line - 1].startswith('  "strut_zeros": [') and caught.value.line > 1
    )


def test_places_of_a_json_text_are_those_of_its_values():
    text = '{"a": [1, {"b\\n": "x,]}"},\n  [], -2.5e3], "c": null}'
    found = Places(text)
    assert (
        found[("a",)] == (1, 7)
        and found[("a", 1, "b\n")] == (1, 19)
        and found[("a", 2)] == (2, 3)
        and found[("a", 3)] == (2, 7)
    )
    assert found[("c",)] == (2, 21) and found[()] == (None, None) and len(found) == 8
    assert (
        first_repeated_key_and_position('{"a": {"b": 1}, "c": {"b": 1,\n "b": [1]}}') == ("b", (2, 7))
        and first_repeated_key_and_position(text) is None
    )
