"""Recordings of machines with effects at work, some of whose rows are wild: displaced, exchanged, of another command;
markers misread.
"""

from dataclasses import replace

import numpy as np

from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model.pose import exp
from rig.planning import recording_plan as plan
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording import recording_folder
from rig.recording.corner_and_pose_csv_tables import Poses
from synthetic import random_true_machine_and_truth_file, recording_simulation

POSE = np.array([5e-6] * 3 + [3e-5] * 3)  # m, rad; noise of a pose, as stated
ROUTE = "sobol:60,ladder:4,moving:12"


def posed(folder, design, effects, seed, route=ROUTE):
    """Recording of a secret hexapod whose poses an instrument measured."""
    rng = np.random.default_rng(seed)
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, tuple(map(parse_effect, effects))),
        plan.build_plan(design, route, seed),
        rng,
    )
    recording_simulation.write_recording(done, folder, hexapod_layout_rig_toml(0.3), rng, 0.04)
    rec, T = recording_folder.load_recording(folder), done.run.T_base_platform
    frames = rec.exposures.times()[0]
    poses = Poses(
        frames, T * exp(POSE * rng.normal(size=(len(frames), 6))), np.tile(np.diag(POSE**2), (len(frames), 1, 1))
    )
    return replace(rec, corners=None, poses=poses)


def spoilt_poses(rec, rng, share=0.05):
    """(Recording, frames) with a share of its poses displaced by 20 to 300 standard deviations, exchanged with
    another's, or copied from another.
    """
    poses, n = rec.poses, len(rec.poses.frame)
    rows = rng.permutation(n)[: max(round(share * n), 2)]
    matrix = poses.T_base_platform.as_matrix()
    displaced = (
        poses.T_base_platform * exp(POSE * rng.uniform(20, 300, (n, 1)) * rng.choice([-1, 1], (n, 6)))
    ).as_matrix()
    out, done = matrix.copy(), []
    for number, i in enumerate(rows.tolist()):
        if i in done:
            continue
        done.append(i)
        kind = number % 3
        if kind == 0 or (kind == 1 and number + 1 == len(rows)):
            out[i] = displaced[i]
        elif kind == 1:
            j = int(rows[number + 1])
            out[i], out[j] = matrix[j], matrix[i]
            done.append(j)
        else:
            out[i] = matrix[(i + 7) % n]
    T = type(poses.T_base_platform).from_matrix(out)
    return replace(rec, poses=replace(poses, T_base_platform=T)), np.sort(poses.frame[done])


def spoilt_corners(rec, rng, share=0.05):
    """(Recording, frames) with a share of its frames in which a marker was misread: its corners in another order,
    displaced, or one displaced.
    """
    corners = rec.corners
    frames, uv = np.unique(corners.frame), corners.uv.copy()
    chosen = np.sort(rng.permutation(frames)[: max(round(share * len(frames)), 1)])
    for number, frame in enumerate(chosen.tolist()):
        own = np.flatnonzero(corners.frame == frame)
        first = int(rng.choice(own[corners.corner[own] == 0]))
        quad = own[
            (corners.marker[own] == corners.marker[first]) & (np.array(corners.camera)[own] == corners.camera[first])
        ]
        if number % 3 == 0:
            uv[quad] = np.roll(uv[quad], 1, axis=0)
        elif number % 3 == 1:
            uv[quad] += rng.uniform(2, 30) * np.array([np.cos(a := rng.uniform(0, 6.3)), np.sin(a)])
        else:
            uv[quad[0]] += rng.uniform(2, 30)
    return replace(rec, corners=replace(corners, uv=uv)), chosen
