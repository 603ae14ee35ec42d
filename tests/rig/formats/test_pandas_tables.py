"""Results as tables of pandas: columns with their units, and what to install where pandas is missing."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.api.diagnose import FINDING_COLUMNS, DiagnosisResult
from calib.api.verify_and_watch import VerificationResult
from calib.certification.uncertainty_budget import BUDGET_COLUMNS, Budget, Contribution
from calib.diagnosis.problems.evidence_interface_and_requested_effects import Value
from calib.diagnosis.report.diagnosis_json_entries import FindingEntry
from rig.errors import MissingLibrary
from rig.formats.pandas_tables_of_poses_and_errors import POSE_COLUMNS_WITH_UNITS, pandas_table
from rig.model.pose import pose
from rig.recording.corner_and_pose_csv_tables import Poses

POSES = Poses(np.arange(2), pose(np.eye(3)[:2], np.zeros((2, 3))), np.broadcast_to(4e-6 * np.eye(6), (2, 6, 6)))


@pytest.fixture
def plain_tables(monkeypatch):
    """pandas replaced by a table that is a dictionary of columns."""
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))


def test_poses_are_a_table_with_units_in_its_columns(plain_tables):
    table = POSES.to_pandas()
    assert list(table) == ["frame", *POSE_COLUMNS_WITH_UNITS, *(f"sigma_{name}" for name in POSE_COLUMNS_WITH_UNITS)]
    assert table["x_m"].tolist() == [1, 0] and table["sigma_rz_rad"].tolist() == pytest.approx([2e-3, 2e-3])
    assert list(replace(POSES, covariance=None).to_pandas()) == ["frame", *POSE_COLUMNS_WITH_UNITS]


def test_a_verification_is_a_table_of_errors(plain_tables):
    before, after = np.arange(12.0).reshape(2, 6), np.ones((2, 6))
    figures = SimpleNamespace(before=before, after=after, samples=SimpleNamespace(frame=np.array([3, 5])))
    table = VerificationResult(None, None, figures).to_pandas()
    assert list(table) == [
        "frame",
        *(f"{side}_{name}" for side in ("nominal", "corrected") for name in POSE_COLUMNS_WITH_UNITS),
    ]
    assert table["nominal_rz_rad"].tolist() == [5, 11] and table["frame"].tolist() == [3, 5]


def test_findings_are_a_table_with_a_row_for_each_parameter(plain_tables):
    parameters = {"width": Value(2e-5, "m", [1e-5, 3e-5]), "axes": Value(["strut 1"], "")}
    report = SimpleNamespace(findings=[FindingEntry("backlash", "strut 1", parameters)])
    table = DiagnosisResult(None, report, None).to_pandas()
    assert tuple(table) == FINDING_COLUMNS and table["parameter"] == ("width", "axes")
    assert table["low_95"] == (1e-5, None) and table["unit"] == ("m", "")
    assert DiagnosisResult(None, SimpleNamespace(findings=[]), None).to_pandas() == {
        name: () for name in FINDING_COLUMNS
    }


def test_a_budget_is_a_table(plain_tables):
    row = Contribution("thermometers", "machine", 1e-6, None, None, "B", "as stated")
    table = Budget((row,), None, None).to_pandas()
    assert tuple(table) == BUDGET_COLUMNS and table["position_m"] == (1e-6,) and table["rotation_rad"] == (None,)


def test_without_pandas_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingLibrary, match=r"to_pandas\(\) needs the package pandas: pip install 'rig\[pandas\]'"):
        POSES.to_pandas()


def test_pandas_itself_takes_the_tables():
    pandas = pytest.importorskip("pandas")
    table = POSES.to_pandas()
    assert isinstance(table, pandas.DataFrame) and table.shape == (2, 13) and table["x_m"].mean() == 0.5
    assert pandas_table(("a", "b"), []).shape == (0, 2) and pandas_table(("a", "b"), [(1, "x")]).at[0, "b"] == "x"
