"""Plans that tell two effects apart: what the misfit is, and that the separating experiment beats the others."""

import numpy as np
import pytest

from calib.diagnosis.effect_signal_to_noise_and_distinguishability_by_plan import separation_of_two_effects_by_plan
from rig.cli import command_line
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.planning.recording_plan import build_plan, sensors_with_payload
from synthetic.random_true_machine_and_truth_file import random_true_and_logged_temperatures

SIGMA = (1e-5, 1e-4)


def is_separable(design, text, *effects):
    plan = build_plan(design, text, 3)
    sensors, _ = random_true_and_logged_temperatures(plan.commands.t[-1], np.random.default_rng(3))
    return separation_of_two_effects_by_plan(
        text,
        design,
        plan.commands,
        plan.t,
        sensors_with_payload(plan, sensors),
        [parse_effect(e) for e in effects],
        SIGMA,
    )


def test_an_effect_is_not_told_from_itself_and_size_adds_nothing(design):
    found = is_separable(design, "ladder:2", "backlash:strut3:gap=6e-5", "backlash:strut3:gap=6.001e-5")
    assert found.cosine == pytest.approx(1, abs=1e-3) and found.misfit < 0.5


def test_another_load_shows_what_joints_swallow_at_one_load(design):
    effects = "compliance:rig:stiffness=3e6", "screw_coupling:rig:gain=0.3"
    constant, loaded = (is_separable(design, text, *effects) for text in ("sobol:36", "payload:12"))
    assert loaded.frames == constant.frames
    assert loaded.misfit > 1.5 * constant.misfit


@pytest.mark.slow
def test_the_command_writes_the_best_plan_or_says_that_none_does(tmp_path, capsys):
    from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml

    (tmp_path / "rig.toml").write_text(hexapod_layout_rig_toml(0.3))
    out = tmp_path / "plan.csv"
    argv = [
        "plan",
        str(tmp_path / "rig.toml"),
        "--separate",
        "backlash:strut3:gap=4e-5",
        "hysteresis:strut3:range=4e-4,weight=0.1",
    ]
    assert command_line.main([*argv, "--out", str(out)]) == 0
    assert "best: zigzag" in capsys.readouterr().out and out.read_text().startswith("t,l1,l2,l3,l4,l5,l6\n")
    assert command_line.main([*argv[:3], "edge_bias:cameras:bias=0.1", argv[4], "--out", str(out)]) == 1
    assert "changes the images" in capsys.readouterr().err


def test_reversals_at_speed_tell_a_lag_from_a_clock(design):
    effects = "servo_lag:rig:time_constant=0.01", "time_offset:clock:offset=-0.01"
    smooth, sharp = (is_separable(design, text, *effects) for text in ("moving:40", "zigzag:40"))
    assert smooth.misfit < 3 < 20 < sharp.misfit
