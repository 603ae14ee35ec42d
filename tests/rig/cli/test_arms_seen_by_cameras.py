"""Arms in the picture, through the command line: cubes in the hand before fixed cameras, and cameras in the hand before
cubes that stand.
"""

import json

import numpy as np
import pytest

from rig.errors import FileError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.mechanisms import arm_kinematics_limits_and_loads as arm
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import sobol_configurations
from rig.recording import recording_folder
from synthetic.random_true_machine_and_truth_file import load_world_from_truth_file
from tests.closed_loops import holds, lines, rig, simulate_with_truth, verified
from vision.recording_measurement import measure_recording


def recorded(folder, carried, *words, cameras=2, plan="sobol:40", size="1280x1024"):
    rig(
        "design", "--arm", "ur10", "--seen", carried, "--cameras", cameras, "--size", size, "--out", folder / "rig.toml"
    )
    simulate_with_truth(folder, plan, 4, *words)


def wanted(folder, count=8):
    m = design_from_rig_toml.load_design(folder / "rig.toml").mechanism
    return lines(arm.forward(sobol_configurations(m.limits, count, 0.6, 5), m))


@pytest.mark.slow
@pytest.mark.parametrize("carried, cameras", [("cubes", 2), ("hand", 1)])
def test_a_loop_closes_with_base_and_hand_solved_for(tmp_path, capfd, carried, cameras):
    recorded(tmp_path, carried, cameras=cameras)
    found = verified(tmp_path, capfd, wanted(tmp_path))
    holds(found)
    assert found["before"]["position"]["rms"] > 1.5 * found["after"]["position"]["rms"]
    tree, truth = (json.loads((tmp_path / name).read_text()) for name in ("calibration.json", "truth.json"))
    stands, real = (np.array(place[:2]) for place in (tree["fitted"]["base"]["position"], truth["base"]))
    sigma = np.sqrt(np.diag(tree["parameter_covariance"]))[
        :2
    ]  # its height is that of axis 1, which d of joint 1 moves along too
    assert (np.abs(stands - real) < 4 * sigma).all() and np.abs(
        real
    ).max() > 10 * sigma.max()  # of which rig.toml says nothing


def test_where_the_hand_is_is_the_inverse_of_where_the_base_is_seen(tmp_path):
    """Measured poses and their covariance, against the true ones: the camera stands in the hand elsewhere than stated,
    the same in every frame.
    """
    recorded(tmp_path, "hand", cameras=1, plan="sobol:24")
    rec = recording_folder.load_recording(tmp_path / "rec")
    poses, _ = measure_recording(rec)
    world = load_world_from_truth_file(tmp_path / "truth.json", rec.design)
    frames, t = rec.exposures.times()
    true = motion_simulation.simulate_machine_run(world.true, rec.commands, t, (), rec.sensors).T_base_platform[
        np.searchsorted(frames, poses.frames)
    ]
    held = (
        world.true.cameras[0].pose * rec.design.cameras[0].pose.inv()
    )  # the platform's frame is fixed by the camera's stated pose
    off = pose_difference(true * held, poses.T_base_platform)
    z = np.einsum("ni,nij,nj->n", off, np.linalg.inv(poses.covariance), off)
    assert np.abs(off[:, :3]).max() < 1e-3 and 0.5 * 6 < z.mean() < 2 * 6


@pytest.mark.parametrize(
    "change, says",
    [
        (('mount = "hand"', 'mount = "hnd"'), "must be one of 'fixed', 'moving', 'hand'"),
        (('shutter = "global"', 'shutter = "rolling"\nrow_time = 1e-5'), "rolling shutter cannot be distinguished"),
        (('body = "base"', 'body = "platform"'), "they see the base's targets alone"),
    ],
)
def test_what_a_camera_in_the_hand_cannot_be_is_told_by_line(tmp_path, change, says):
    rig("design", "--arm", "ur10", "--seen", "hand", "--cameras", "1", "--out", tmp_path / "rig.toml")
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text.replace(*change, 1))
    with pytest.raises(FileError, match=says) as error:
        design_from_rig_toml.load_design(tmp_path / "rig.toml")
    assert error.value.line is not None


def test_a_fixed_camera_beside_one_in_the_hand_is_refused(tmp_path):
    rig("design", "--arm", "ur10", "--seen", "hand", "--cameras", "2", "--out", tmp_path / "rig.toml")
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text.replace('mount = "hand"', 'mount = "fixed"', 1))
    with pytest.raises(FileError, match="all of its cameras there, or none"):
        design_from_rig_toml.load_design(tmp_path / "rig.toml")


@pytest.mark.parametrize(
    "carried, cameras, images",
    [
        pytest.param("cubes", 2, False, marks=pytest.mark.slow),
        pytest.param("hand", 1, False, marks=pytest.mark.slow),
        pytest.param("cubes", 2, True, marks=pytest.mark.slow),
    ],
)
def test_a_loop_closes_of_an_arm_of_four_joints(tmp_path, capfd, carried, cameras, images):
    """A SCARA: its hand turns about one axis alone, so that its positions place it; what it cannot make up for is
    stated.
    """
    drawn = ("--images",) if images else ()
    few = {"plan": "sobol:16", "size": "640x512"} if images else {}
    rig(
        "design",
        "--arm",
        "scara",
        "--seen",
        carried,
        "--cameras",
        cameras,
        "--size",
        few.get("size", "1280x1024"),
        "--out",
        tmp_path / "rig.toml",
    )
    simulate_with_truth(tmp_path, few.get("plan", "sobol:40"), 4, *drawn)
    holds(verified(tmp_path, capfd, wanted(tmp_path, 4 if images else 8), drawn, reached="commands.poses.csv"))


@pytest.mark.parametrize("name", ["scara", "gantry"])
def test_arms_of_few_joints_are_laid_out_where_cameras_see_them(tmp_path, capfd, name):
    rig("design", "--arm", name, "--seen", "cubes", "--cameras", "2", "--out", tmp_path / "rig.toml")
    rig("plan", tmp_path / "rig.toml", "--for", "parameters", "--count", "8", "--out", tmp_path / "plan.csv")
    assert float(capfd.readouterr().out.split("seen in ")[1].split("%")[0]) > 95


def test_a_plan_of_an_arm_takes_what_is_seen_and_tells_most(tmp_path, capfd):
    rig("design", "--arm", "puma560", "--seen", "hand", "--cameras", "1", "--out", tmp_path / "rig.toml")
    text, limits = (
        (tmp_path / "rig.toml").read_text(),
        design_from_rig_toml.load_design(tmp_path / "rig.toml").mechanism.limits,
    )
    wide = limits + np.array([-0.5, 0.5])  # so that the cubes are out of sight in many configurations
    stated = text[text.index("limits = ") : text.index("#", text.index("limits = "))]
    (tmp_path / "rig.toml").write_text(text.replace(stated, f"limits = {wide.tolist()} "))
    rig("plan", tmp_path / "rig.toml", "--for", "parameters", "--count", "12", "--out", tmp_path / "plan.csv")
    output = capfd.readouterr().out
    assert 5 < float(output.split("seen in ")[1].split("%")[0]) < 95
    rig(
        "simulate",
        tmp_path / "rig.toml",
        "--plan",
        f"commands:{tmp_path / 'plan.csv'}",
        "--secret",
        "0",
        "--out",
        tmp_path / "rec",
    )
    corners = recording_folder.load_recording(tmp_path / "rec").corners
    assert set(corners.frame.tolist()) == set(range(12))
    rows = [line.split() for line in output.splitlines() if " um  " in line or " urad  " in line]
    assert len(rows) == 8 and all(float(row[0]) < float(row[1]) for row in rows[2:])


def test_reversals_at_speed_tell_an_arms_lag_from_a_clock():
    from calib.diagnosis.effect_signal_to_noise_and_distinguishability_by_plan import separation_of_two_effects_by_plan
    from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
    from rig.planning.layout import shipped_arms_and_layouts
    from rig.planning.recording_plan import build_plan

    design, found = shipped_arms_and_layouts.load_shipped_arm_design("puma560"), {}
    lag, late = parse_effect("servo_lag:rig:time_constant=0.02"), parse_effect("time_offset:clock:offset=-0.02")
    for text in ("moving:40", "zigzag:40"):
        plan = build_plan(design, text, 3)
        for name, pair in (("two", [lag, late]), ("one", [lag, lag])):
            found[text, name] = separation_of_two_effects_by_plan(
                text, design, plan.commands, plan.t, None, pair, (2e-5, 1e-4)
            ).misfit
    assert found["zigzag:40", "two"] > 20 and found["zigzag:40", "two"] > 3 * found["moving:40", "two"]
    assert found["zigzag:40", "one"] < 1e-3 * found["zigzag:40", "two"]


@pytest.mark.slow
def test_a_loop_closes_from_images_out_of_the_hand(tmp_path, capfd):
    recorded(tmp_path, "hand", "--images", cameras=1, plan="sobol:24", size="800x640")
    holds(verified(tmp_path, capfd, wanted(tmp_path, 4), ("--images",)))


@pytest.mark.slow
def test_what_holds_a_joint_back_is_found_from_the_hand(tmp_path):
    recorded(tmp_path, "cubes", "--effect", "backlash:joint3:gap=1e-3", plan="sobol:70,ladder:2")
    rig("diagnose", tmp_path / "rec", "--only", "backlash", "--out", tmp_path / "found")
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    assert [(f["effect"], f["place"]) for f in found] == [("backlash", "joint 3")]
