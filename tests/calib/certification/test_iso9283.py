"""A test counts as ISO 9283's only where it is, and says what is not met."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.certification.held_out_pose_errors_and_distinct_configurations import held_out_poses
from calib.certification.iso230_and_iso9283_tests import Duty, iso9283_accuracy_and_repeatability
from calib.correction.machine_correction import fit_geometry_and_remainder_of_correction
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.model import machine_motion_simulation as motion_simulation
from rig.planning import recording_plan as plan

FULL = Duty(0.05, 0.05, (10.0, 10.0), 10.0)


def standard(design, cycles=30):
    """HeldPoses of the plan of the standard's five poses."""
    done = plan.build_plan(design, f"iso9283:{cycles}", 0)
    T = motion_simulation.simulate_machine_run(design, done.commands, done.t).T_base_platform
    n = len(done.t)
    samples = Samples(
        np.arange(n), done.t, done.commands.at(done.t), T, np.tile(np.eye(6) * 1e-12, (n, 1, 1)), np.zeros((n, 6, 1))
    )
    errors = 1e-6 * np.random.default_rng(0).normal(size=(n, 6))
    return held_out_poses(
        fit_geometry_and_remainder_of_correction(samples, design.mechanism, "none")[0],
        [(samples, done.commands, errors, errors)],
    )


@pytest.fixture(scope="module")
def full_test(design):
    return standard(design)


def met(poses, duty=FULL):
    found = iso9283_accuracy_and_repeatability(poses, duty)
    assert found.formal == (not found.not_met)
    return "; ".join(found.not_met)


def test_the_planned_test_is_the_standards(full_test):
    assert met(full_test) == ""


def test_visits_are_counted_by_moves(design):
    few = standard(design, 10)
    thrice = np.repeat(np.arange(len(few)), 3)
    poses = replace(
        few,
        **{
            name: getattr(few, name)[thrice]
            for name in ("recording", "frame", "t", "commanded", "before", "step", "errors", "plain", "own", "label")
        },
        T_base_platform=few.T_base_platform[thrice],
        common=tuple(c[thrice] for c in few.common),
    )
    assert "0 poses were visited 30 times" in met(poses), "three exposures of one visit are one visit"


def test_another_order_is_named(full_test):
    order = np.arange(len(full_test))
    order[[6, 7]] = 7, 6
    assert "not visited in a consistent order" in met(replace(full_test, t=full_test.t[order]))


def test_other_sides_are_named(full_test):
    before = full_test.before.copy()
    before[7] *= -1
    assert met(replace(full_test, before=before)) == "1 of them were approached from more than one side"


@pytest.mark.parametrize("stretch, name", [((1, 1, 1.6), "no diagonal plane"), ((1, 1, 1), "")])
def test_other_places_are_named(full_test, stretch, name):
    T = full_test.T_base_platform
    moved = RigidTransform.from_components(T.translation * stretch, T.rotation)
    assert name in met(replace(full_test, T_base_platform=moved))


def test_poses_off_a_rectangle_are_named(full_test):
    T, label = full_test.T_base_platform, full_test.label
    off = np.where((label == label[0])[:, None], 0.02, 0.0)
    moved = RigidTransform.from_components(T.translation + off, T.rotation)
    assert "corners of a rectangle" in met(replace(full_test, T_base_platform=moved))


@pytest.mark.parametrize(
    "duty, name",
    [
        (replace(FULL, rated_load=None), "rated load is not stated"),
        (replace(FULL, load=None), "not logged"),
        (replace(FULL, load=(0.0, 10.0)), "the load was 0 to 10 kg"),
        (replace(FULL, speed=0.02), "at 40% of it"),
        (replace(FULL, rated_speed=None), "rated speed is not stated"),
    ],
)
def test_load_and_speed_are_part_of_it(full_test, duty, name):
    assert name in met(full_test, duty)
