"""A hexapod's closed loop through the command line: simulated with images or corners, calibrated, corrected, driven,
verified.
"""

import pytest

from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.planning.configuration_generators import sobol_configurations
from tests.closed_loops import holds, lines, rig, simulate_with_truth, verified


@pytest.mark.slow
@pytest.mark.parametrize("drawn", [(), ("--images",)], ids=["corners", "images"])
def test_a_loop_closes(tmp_path, capfd, drawn):
    rig(
        "design",
        "--radius",
        "0.3",
        "--cubes",
        "3",
        "--cameras",
        "2",
        "--size",
        "800x640" if drawn else "1280x1024",
        "--out",
        tmp_path / "rig.toml",
    )
    simulate_with_truth(tmp_path, "sobol:24" if drawn else "sobol:60", 2, *drawn)
    m = design_from_rig_toml.load_design(tmp_path / "rig.toml").mechanism
    found = verified(
        tmp_path,
        capfd,
        lines(hexapod.forward(sobol_configurations(m.strut_range, 4 if drawn else 8, 0.5, 5), m)),
        drawn,
    )
    holds(found)
    assert found["before"]["position"]["rms"] > 10 * found["after"]["position"]["rms"]
