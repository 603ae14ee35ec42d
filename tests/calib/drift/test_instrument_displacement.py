"""An instrument that moved between two recordings is noticed and its place found; one that did not, and says so,
stays.
"""

from dataclasses import replace

import numpy as np

from calib.api.recording_check_combination_and_view import undisplaced_recording_and_displaced_places
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model.design import Instrument
from rig.model.pose import exp
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from rig.recording.combined_recordings import first_recording_by_camera, join_recordings
from synthetic import random_true_machine_and_truth_file, recording_simulation

MOVED = np.array([1e-3, -5e-4, 2e-3, 1e-3, 0, -2e-3])


def test_a_place_is_found_and_a_still_one_kept(tmp_path, design):
    text = (
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3)
        + '\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-5\nrotation_sigma = 2e-5\n'
    )
    rng = np.random.default_rng(3)
    stated = replace(design, instrument=Instrument("rig", "rig", 1e-5, 2e-5))
    secret = random_true_machine_and_truth_file.random_true_machine(stated, rng)
    parts = []
    for k in range(2):
        done = recording_simulation.simulate_world(secret, plan.build_plan(stated, "sobol:40", seed=k), rng)
        recording_simulation.write_recording(done, tmp_path / f"rec{k}", text, rng, noise=0.04)
        parts.append(recording_folder.load_recording(tmp_path / f"rec{k}"))
    moved = replace(
        parts[1], poses=replace(parts[1].poses, T_base_platform=exp(MOVED) * parts[1].poses.T_base_platform)
    )
    assert undisplaced_recording_and_displaced_places(join_recordings(parts, first_recording_by_camera(parts)))[1] == []
    lags = replace(
        secret, effects=(parse_effect("servo_lag:rig:time_constant=0.04"),)
    )  # what one plan shows of the model is no place
    turning = []
    for route in ("sobol:24", "moving:16"):
        recording_simulation.write_recording(
            recording_simulation.simulate_world(lags, plan.build_plan(stated, route, seed=1), rng),
            tmp_path / route,
            text,
            rng,
            noise=0.04,
        )
        turning.append(recording_folder.load_recording(tmp_path / route))
    assert (
        undisplaced_recording_and_displaced_places(join_recordings(turning, first_recording_by_camera(turning)))[1]
        == []
    )
    found, (place,) = undisplaced_recording_and_displaced_places(
        join_recordings([parts[0], moved], first_recording_by_camera(parts))
    )
    assert place.recording == 1 and "rec1" in place.line("rec1")
    np.testing.assert_allclose(place.motion, MOVED, atol=3e-5)
    np.testing.assert_allclose(
        found.poses.T_base_platform[40:].translation, parts[1].poses.T_base_platform.translation, atol=5e-5
    )
