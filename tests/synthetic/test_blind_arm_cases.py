"""Blind cases of arms: each hardship is in the recording, an effect's strength is known, and a campaign of arms runs as
any other.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.effect_signal_to_noise_and_distinguishability_by_plan import arm_effect_signal_to_noise
from rig.cli import command_line
from rig.recording import recording_folder
from synthetic import random_blind_arm_cases_with_truth


@pytest.fixture(scope="module")
def case():
    return random_blind_arm_cases_with_truth.draw_arm_case(5, 1, 60, ["one"], ["scale_error"])


def written(case, folder, *hard):
    random_blind_arm_cases_with_truth.write_recording(replace(case, hard=hard, rng=np.random.default_rng(1)), folder)
    return recording_folder.load_recording(folder)


def test_the_same_case_is_drawn_again_and_a_third_is_hard(case):
    redrawn = random_blind_arm_cases_with_truth.draw_arm_case(5, 1, 60, ["one"], ["scale_error"])
    assert (
        redrawn.simulation.world.effects == case.simulation.world.effects
        and redrawn.text == case.text
        and redrawn.hard == ()
    )
    assert all(
        bool(random_blind_arm_cases_with_truth.draw_arm_case(5, i, 30, ["nothing"]).hard)
        == (i % random_blind_arm_cases_with_truth.HARD == 0)
        for i in range(1, 7)
    )


def test_hardships_are_in_the_recording(case, tmp_path):
    plain = written(case, tmp_path / "plain")
    T = case.simulation.run.T_base_platform
    error = np.linalg.norm(plain.poses.T_base_platform.translation - T.translation, axis=1)
    assert np.median(error) == pytest.approx(1.54 * case.sigma[0], rel=0.2) and error.max() < 5 * case.sigma[0]
    wild = written(case, tmp_path / "wild", "wild").poses.T_base_platform.translation
    assert 1 <= (np.linalg.norm(wild - T.translation, axis=1) > 10 * case.sigma[0]).sum() <= 5
    assert len(written(case, tmp_path / "missing", "missing").poses.frame) < 0.9 * len(plain.poses.frame)
    untimed = written(case, tmp_path / "untimed", "untimed")
    assert np.allclose(np.diff(np.union1d(untimed.commands.t, untimed.exposures.times()[1])), 1)
    assert (np.sign(np.diff(untimed.commands.values[:, 0])) == np.sign(np.diff(plain.commands.values[:, 0]))).all()


def test_an_effects_strength_grows_with_it_and_shrinks_with_the_noise(case):
    done = case.simulation
    (effect,) = done.world.effects

    def strength(factor, sigma):
        return arm_effect_signal_to_noise(
            done.world.true,
            done.plan.commands,
            done.plan.t,
            sigma,
            (replace(effect, scale=factor * effect.scale),),
            done.sensors,
        )[0]

    assert strength(2, case.sigma) == pytest.approx(2 * strength(1, case.sigma), rel=1e-2)
    assert strength(1, 3 * case.sigma) == pytest.approx(strength(1, case.sigma) / 3, rel=1e-6)
    assert strength(1, case.sigma[:1]) < strength(1, case.sigma)


@pytest.mark.slow
def test_a_campaign_of_arms_is_blinded_diagnosed_and_scored(tmp_path, capsys):
    ask = ["blind", "--season", "1", "--mechanism", "arm", "--frames", "90", "--out", str(tmp_path / "campaign")]
    assert command_line.main([*ask, "--hide", "foreign"]) == 1 and "nothing, one, two" in capsys.readouterr().err
    assert command_line.main([*ask, "--hide", "one", "--effects", "scale_error", "--seed", "3"]) == 0
    truth = json.loads((tmp_path / "campaign/truth/0001.json").read_text())
    tree = json.loads((tmp_path / "campaign/diagnoses/0001/diagnosis.json").read_text())
    assert truth["kind"] == "one" and truth["strengths"][0] > 7
    assert (tree["findings"][0]["effect"], tree["findings"][0]["place"]) == (
        "scale_error",
        truth["effects"][0]["place"],
    )
