"""How many poses a lookup table's uncertainty takes, by what of it falls with their number."""

import re

import numpy as np
import pytest

from calib.api.corrected_command_lookup_table_over_sensor_channels import LookupTable
from calib.api.export_calibration_or_recording import ExportOptions, export
from rig.errors import RigError


def table(rest, unlogged):
    sizes = (5e-6, 2e-5), (rest, 0.0), (unlogged, 0.0)
    return LookupTable({"elevation_deg": np.zeros(1)}, ("frame",), np.zeros((1, 1)), 0.0, *sizes, 60, "m")


@pytest.mark.parametrize(
    "kind, wanted, says",
    [
        ("position", 5e-6, "5 µm of position takes 60 poses, spread as the 60 that were fitted"),
        ("position", 13**0.5 * 1e-6, "takes 116 to 240 poses"),
        ("position", 2.5e-6, "at least 240 poses, .* none suffice where the scatter of 3 µm stays"),
        ("rotation", 1e-5, "10 µrad of rotation takes 240 poses"),
    ],
)
def test_poses_fall_with_the_square_of_what_they_determine(kind, wanted, says):
    assert re.search(says, table(3e-6, 0.0).poses_for(kind, wanted))


def test_what_nobody_logged_stays():
    assert "no number of poses gives 2 µm of position: 2 µm come of what" in table(3e-6, 2e-6).poses_for(
        "position", 2e-6
    )


def test_a_wanted_uncertainty_is_of_lookup_tables_alone(tmp_path):
    with pytest.raises(RigError, match="--uncertainty counts poses for a table of --format lut"):
        export(tmp_path / "calibration.json", "grid", ExportOptions(uncertainty={"position": 1e-5}))
