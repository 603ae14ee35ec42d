"""Play of a machine stands out in what is held out of a balanced plan; in a Sobol sequence's own order it looked like a
map.
"""

from pathlib import Path

import numpy as np
import pytest

from calib.certification.held_out_pose_error_statistics import errors_before_and_after_correction
from calib.certification.platform_certification import certify_platform, platform_workspace_claim
from calib.samples.commanded_and_measured_pose_samples import Samples, sample_recording
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import (
    effect_with_existing_place,
    parse_effect,
    require_nonzero_effect,
)
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.conftest import BENCH

INSTRUMENT = '\n[instrument]\nkind = "pose"\nbase = "rig"\ntool = "rig"\nposition_sigma = 5e-6\nrotation_sigma = 2e-5\n'


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_random_play_stands_out_on_a_balanced_plan(tmp_path: Path, seed: int) -> None:
    text = (BENCH / "fit" / "rig.toml").read_text() + INSTRUMENT
    (tmp_path / "rig.toml").write_text(text)
    design = design_from_rig_toml.load_design(tmp_path / "rig.toml")
    gaps = np.random.default_rng(seed).uniform(20e-6, 80e-6, 6)
    secret = random_true_machine_and_truth_file.random_true_machine(
        design,
        np.random.default_rng(100 + seed),
        1.0,
        [
            require_nonzero_effect(effect_with_existing_place(parse_effect(f"backlash:strut{i + 1}:gap={gap}"), design))
            for i, gap in enumerate(gaps)
        ],
    )

    def recorded(route: plan.Plan, name: str) -> Samples:
        rng = np.random.default_rng(seed)
        recording_simulation.write_recording(
            recording_simulation.simulate_world(secret, route, rng), tmp_path / name, text, rng
        )
        return sample_recording(recording_folder.load_recording(tmp_path / name)).samples

    done = certify_platform(
        fitted := recorded(plan.build_plan(design, "sobol:40", seed), "fit"), design.mechanism, np.random.default_rng(0)
    )
    other = recorded(plan.build_plan(design, "sobol:60", 900 + seed), "other")
    true = float(
        np.sqrt((errors_before_and_after_correction(done.correction, other)[1][:, :3] ** 2).sum(axis=1).mean())
    )  # m, measuring included
    assert done.held_out is not None
    assert (
        done.held_out.after.position[0] > 5 * done.held_out.floor[0] and done.held_out.after.position[0] > 0.95 * true
    )
    claim = platform_workspace_claim(fitted, done, np.random.default_rng(0))
    assert claim.after is not None and claim.after[0][2] > 0.95 * true
