"""Two different machines do not give the same recording: no two effects coincide under the standard plan.

An effect's signature is what it does to all corners, less what calibration can swallow: the 42 parameters of the
geometry, the cameras' poses and their lenses. Two effects whose signatures are parallel cannot be told apart from that
recording.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.models.platform.platform_identification import pose_parameter_jacobian
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.base_and_link_tilt_sensors import BaseTilt
from rig.model.pose import exp
from rig.planning import recording_plan as plan
from rig.recording.recording_folder import sensors_with_gravity
from synthetic import random_true_machine_and_truth_file, recording_simulation
from vision import opencv_lens_model as lens
from vision.marker_corner_prediction import (
    State,
    is_inside_image,
    marker_map,
    predict_sightings,
    sightings_facing_cameras_anywhere,
)

EFFECTS = [
    "scale_error:strut3:scale=2e-4",
    "cyclic_error:strut3:amplitude=1e-5",
    "transmission_error:strut3:profile=0/1e-5/-1e-5/2e-5/0/1e-5/-2e-5",
    "backlash:strut3:gap=4e-5",
    "hysteresis:strut3:range=5e-3,weight=5e-3",
    "missed_steps:strut3:jump=4e-5,time=900",
    "servo_lag:strut3:time_constant=0.01",
    "servo_lag:rig:time_constant=0.01",
    "creep:strut3:fraction=3e-3,time_constant=20",
    "creep:rig:fraction=3e-3,time_constant=20",
    "thermal_expansion:strut3:coefficient=2e-5",
    "thermal_expansion:rig:coefficient=2e-5",
    "warm_up:strut3:amplitude=5e-5,time_constant=1500",
    "warm_up:rig:amplitude=5e-5,time_constant=1500",
    "screw_coupling:rig:gain=0.5",
    "compliance:rig:stiffness=5e6",
    "compliance:strut3:stiffness=5e6",
    "joint_clearance:strut3:gap=4e-5",
    "base_expansion:rig:coefficient=5e-5",
    "vibration:rig:amplitude=2e-5,frequency=3.3",
    "time_offset:clock:offset=0.01",
    "clock_drift:clock:rate=2e-5",
    "lens_distortion:cam1:terms=0/0/0/0/0/0/0/0/5e-4/0/5e-4/0",
    "focal_drift:cameras:per_kelvin=1e-4",
    "focal_drift:cam1:per_kelvin=1e-4",
    "camera_drift:cam1:motion=1e-4/0/0/0/0/0,time_constant=1500",
    "camera_sag:cam1:yields=" + "/".join(["1e-4", "0", "0"] * 6),
    "camera_bump:cam1:motion=1e-4/0/0/0/0/0,time=900",
    "rolling_shutter:cameras:row_time=2e-5",
    "rolling_shutter:cam1:row_time=2e-5",
    "refraction:cam1:thickness=5e-3",
    "edge_bias:cameras:bias=0.1",
    "edge_bias:cam1:bias=0.1",
    "print_scale:markers:scale=1e-3",
    "face_misplacement:8:offset=2e-4/0/0",
    "cube_misplacement:P2:motion=2e-4/0/0/0/0/0",
    "marker_swap:8:turn=1",
    "axis_coupling:strut3:scale=1e-3,other=5",
    "settling_error:strut3:fraction=1e-3",
    "joint_offset:strut3:offset=3e-3,end=0",
    "travel_heating:strut3:per_metre=5e-5,time_constant=600",
    "marker_flatness:8:height=5e-4,corner=2",
    "encoder_interpolation:strut3:amplitude=4e-6,periods=3003",
    "base_lean:rig:compliance=2e-5,depth=0.4",
]
PARALLEL = 0.99  # cosine from which signatures count as the same
SEEN = 0.02  # share of the raw effect that calibration must leave for it to be visible at all
SWALLOWED = {
    "refraction cam1",
    "lens_distortion cam1",
}  # a lens swallows a window and its own terms over one range of depths


@pytest.fixture(scope="module")
def signatures(design):
    rng = np.random.default_rng(0)
    route = plan.build_plan(design, "standard", 1)
    s = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng, 0.0), route, rng
    )
    markers, T = marker_map(design), s.run.T_base_platform
    found = sightings_facing_cameras_anywhere(State(design.cameras, T, {}), markers, np.cos(np.radians(70)))
    found = found.take(
        is_inside_image(found, predict_sightings(found, State(design.cameras, T, {}), markers), design.cameras)
    )
    found = found.take(np.sort(rng.choice(len(found.frame), 6000, replace=False)))

    def look(cameras=design.cameras, poses=T):
        return predict_sightings(found, State(tuple(cameras), poses, {}), markers).ravel()

    clean = look()
    columns = [
        (look(poses=T * exp(1e-6 * J)) - clean) / 1e-6
        for J in np.moveaxis(pose_parameter_jacobian(T, design.mechanism), -1, 0)
    ]
    for i, camera in enumerate(design.cameras):
        for k in range(6 + len(lens.lens_parameter_names(camera.distortion))):
            columns.append(
                (look([_nudged(c, k) if j == i else c for j, c in enumerate(design.cameras)]) - clean) / 1e-6
            )
    columns = np.stack(columns, axis=1)
    Q = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)[0]
    elevation = 30 + 30 * np.sin(s.sensors.t / 300)  # degrees
    logged = replace(s.sensors, channels={**s.sensors.channels, "elevation_deg": elevation})
    tilting = sensors_with_gravity(design.gravity, (BaseTilt("elevation_deg", np.array([0.0, 1.0, 0.0])),), logged)
    left = {}
    for text in EFFECTS:
        effect = parse_effect(text)
        rolls = effect.name == "rolling_shutter"
        sensors = tilting if effect.name == "camera_sag" else s.sensors
        run = motion_simulation.simulate_machine_run(design, route.commands, route.t, [effect], sensors, rates=rolls)
        seen = predict_sightings(
            found,
            State(design.cameras, run.T_base_platform, {}),
            markers,
            route.t,
            [effect],
            sensors,
            run if rolls else None,
        )
        raw = seen.ravel() - clean
        rest = raw - Q @ (Q.T @ raw)
        left[" ".join(text.split(":")[:2])] = (np.linalg.norm(rest) / np.linalg.norm(raw), rest / np.linalg.norm(rest))
    return left


def _nudged(camera, k, h=1e-6):
    if k < 6:
        return replace(camera, pose=camera.pose * exp(h * np.eye(6)[k]))
    k -= 6
    if k < 4:
        matrix = camera.matrix.copy()
        matrix[[0, 1, 0, 1][k], [0, 1, 2, 2][k]] += h
        return replace(camera, matrix=matrix)
    return replace(camera, distortion=camera.distortion + h * np.eye(len(camera.distortion))[k - 4])


def test_every_effect_is_looked_at():
    of_arms = {name for name, kind in BY_NAME.items() if kind.of_links}  # which no hexapod has
    assert {text.split(":")[0] for text in EFFECTS} == set(BY_NAME) - of_arms


def test_no_two_effects_coincide(signatures):
    visible = {name: unit for name, (share, unit) in signatures.items() if share > SEEN}
    names = list(visible)
    same = {
        frozenset({a, b}) for i, a in enumerate(names) for b in names[:i] if abs(visible[a] @ visible[b]) > PARALLEL
    }
    assert not same


def test_calibration_swallows_only_what_it_must(signatures):
    assert {name for name, (share, _) in signatures.items() if share <= SEEN} <= SWALLOWED
