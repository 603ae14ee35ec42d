"""What frames before and after say of a pose in doubt."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from vision.pose.pose_refinement_and_choice_by_neighbour_frames import (
    choose_poses_by_neighbours,
    neighbour_pose_and_turn_bound,
    neighbour_rotation_scatter,
    rotation_angle_between_poses,
    rotation_outlier_reasons_by_frame,
)


def track(count=60, rate=0.6, jitter=0.002, seed=0):
    t = np.arange(count) * 0.05
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(np.outer(np.sin(rate * t), [1.0, 0.5, 0.2])) * Rotation.from_rotvec(
        jitter * rng.normal(size=(count, 3))
    )
    T = RigidTransform.from_components(np.outer(t, [0.1, 0, 0]), turn).as_matrix()
    return t, dict(enumerate(T))


def flipped(T):
    out = T.copy()
    out[:3, :3] = T[:3, :3] @ Rotation.from_rotvec([1.2, 0, 0]).as_matrix()
    return out


def test_the_pose_that_its_neighbours_lead_to_is_chosen():
    t, found = track()
    truth = {f: found.pop(f) for f in (20, 21, 22, 40)}
    chosen = choose_poses_by_neighbours(found, {f: [flipped(T), T] for f, T in truth.items()}, t)
    assert set(chosen) == set(truth) and all((chosen[f] == truth[f]).all() for f in truth)


def test_no_candidate_is_taken_that_neighbours_do_not_lead_to():
    t, found = track()
    wrong = flipped(found.pop(20))
    near = wrong.copy()
    near[:3, :3] = near[:3, :3] @ Rotation.from_rotvec([0, 0, 0.4]).as_matrix()
    assert (
        choose_poses_by_neighbours(found, {20: [wrong, near]}, t) == {}
        and choose_poses_by_neighbours(found, {20: [wrong]}, t) == {}
    )


def test_a_body_that_leaps_vouches_for_nothing():
    rng = np.random.default_rng(1)
    found = dict(enumerate(RigidTransform.from_rotation(Rotation.random(40, rng=rng)).as_matrix()))
    t = np.arange(40) * 0.05
    T = found.pop(20)
    assert (
        choose_poses_by_neighbours(found, {20: [T, flipped(T)]}, t) == {}
        and rotation_outlier_reasons_by_frame(found, t) == {}
    )


def test_frames_far_apart_in_time_say_nothing():
    t, found = track()
    reach = neighbour_rotation_scatter(found, t)
    late = t.copy()
    late[30:] += 60
    assert (
        neighbour_pose_and_turn_bound({29: found[29]}, 30, late, reach)[0] is None
        and neighbour_pose_and_turn_bound({29: found[29]}, 30, t, reach)[0] is not None
    )
    assert neighbour_rotation_scatter(found, t * 100) is None


def test_a_flip_among_solved_frames_stands_out():
    t, found = track()
    found[33] = flipped(found[33])
    odd = rotation_outlier_reasons_by_frame(found, t)
    assert set(odd) == {33} and "69 degrees" in odd[33]
    assert rotation_angle_between_poses(found[33], track()[1][33]) > 1.1
