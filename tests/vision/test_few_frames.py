"""Recordings of one to six frames: what they can tell is told, with a covariance that holds; what they cannot is
said.
"""

import numpy as np
import pytest

from rig.errors import NotEnoughData
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation
from vision.bundle import bundle_adjustment as adjusting
from vision.bundle.adjustment_cross_validation_and_determined_unknowns import (
    crossvalidate_adjustment,
    determinacy_of_adjusted_unknowns,
)
from vision.recording_measurement import measure_recording


def seen(design, text, folder, seed, count, home, noise=0.04):
    """(Recording of `count` settled frames, the first at home where `home` says so; true poses)."""
    rng = np.random.default_rng(seed)
    strokes = design.mechanism.strut_range
    commands = configuration_generators.sobol_configurations(strokes, max(count, 2), seed=seed)[:count]
    if home:
        commands[0] = hexapod.inverse(design.mechanism.home, design.mechanism)
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng),
        plan.plan_of_configurations(commands, strokes.mean(axis=1), plan.planned_axis_speeds(design)),
        rng,
    )
    recording_simulation.write_recording(done, folder, text, rng, noise)
    return recording_folder.load_recording(folder), done.run.T_base_platform


def agrees(design, text, folder, seed, count, home, noise):
    """Measure a small recording; its normalised squared error per frame, own and shared errors together one draw."""
    read, true = seen(design, text, folder, seed, count, home, noise)
    measured, _ = measure_recording(read, places="auto")
    assert len(measured.frames) == count and not measured.unsolved
    assert determinacy_of_adjusted_unknowns(measured.adjustment).lines()
    held = crossvalidate_adjustment(measured.used(), measured.adjustment)
    assert bool(held) == (count > 1) and (held or "one frame" in held.reason)
    error = pose_difference(measured.T_base_platform, true)
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(measured.covariance), error).mean()


@pytest.mark.parametrize("noise", [0.04, 0.004])
@pytest.mark.parametrize("home", [False, True], ids=["", "home"])
@pytest.mark.slow
def test_few_frames_are_measured(design, rig_text, tmp_path, home, noise):
    scores = [agrees(design, rig_text, tmp_path / str(count), 40 + count, count, home, noise) for count in (1, 2, 4)]
    assert max(scores) < 25  # of 6 on average


@pytest.mark.slow
@pytest.mark.parametrize("count", range(1, 7))
@pytest.mark.parametrize("home", [False, True], ids=["", "home"])
def test_few_frames_are_measured_whatever_the_draw(design, rig_text, tmp_path, count, home):
    scores = [
        agrees(design, rig_text, tmp_path / str(seed), seed, count, home, (0.04, 0.004)[seed % 2]) for seed in range(20)
    ]
    assert 3.5 < np.mean(scores) < 9


def test_an_optimum_is_found_although_its_cost_is_rounded(design, rig_text, tmp_path, monkeypatch):
    """At the bottom a step promises less than the cost's last digits: that is the optimum, not a way that is lost."""
    exact = adjusting.adjustment_cost
    monkeypatch.setattr(adjusting, "adjustment_cost", lambda *arguments: exact(*arguments) * (1 + 1e-10))
    measured, _ = measure_recording(seen(design, rig_text, tmp_path / "rec", 3, 4, True)[0])
    assert len(measured.frames) == 4


def test_a_camera_that_shows_no_base_stands_where_it_is_stated(tmp_path):
    """Two cubes hide each other from some camera; its stated pose is then worth 10 mm, and what it alone sees is no
    better. What others see as well says where it stands."""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=3, cubes=2)
    (tmp_path / "rig.toml").write_text(text)
    design = design_from_rig_toml.load_design(tmp_path / "rig.toml")
    read, true = seen(design, text, tmp_path / "rec", 6, 1, True)
    on_base = [number for target in design.targets if target.body == "base" for number in target.ids]
    alone = only_rows(read, (np.array(read.corners.camera) == "cam2") | np.isin(read.corners.marker, on_base))
    for some, least, most in ((alone, 5e-3, 1.0), (read, 0.0, 5e-4)):
        measured, _ = measure_recording(some)
        statement = " ".join(determinacy_of_adjusted_unknowns(measured.adjustment).lines())
        assert "shows too little of the base" in statement and "worth 10 mm" in statement
        stated = np.sqrt(np.trace(measured.covariance[0, :3, :3]))
        assert (
            least < stated < most
            and np.linalg.norm(pose_difference(measured.T_base_platform, true)[0, :3]) < 3 * stated
        )


def test_what_nothing_determines_is_named(tmp_path):
    """Without targets on the base two cameras that never see the platform together are not tied to each other."""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=3, cubes=2)
    head, *targets = text.split("[[target]]")
    text = "[[target]]".join([head, *(t for t in targets if 'body = "platform"' in t)])
    (tmp_path / "rig.toml").write_text(text)
    design = design_from_rig_toml.load_design(tmp_path / "rig.toml")
    read, _ = seen(design, text, tmp_path / "rec", 6, 4, False)
    apart = read.corners
    keep = np.array([(name == "cam2") == (frame % 2 == 0) for frame, name in zip(apart.frame, apart.camera)])
    with pytest.raises(NotEnoughData, match="do not determine: cam"):
        measure_recording(only_rows(read, keep))


def only_rows(read, keep):
    """The Recording with the corners of a mask (n,) alone."""
    from dataclasses import replace

    c = read.corners
    some = replace(
        c,
        frame=c.frame[keep],
        camera=[name for name, is_retained in zip(c.camera, keep) if is_retained],
        marker=c.marker[keep],
        corner=c.corner[keep],
        uv=c.uv[keep],
        covariance=None if c.covariance is None else c.covariance[keep],
    )
    return replace(read, corners=some)
