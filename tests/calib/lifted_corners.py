"""Recordings in which one corner of a marker is lifted off its face: a point in space, projected by OpenCV."""

from dataclasses import replace

import cv2
import numpy as np

from rig.planning import recording_plan as plan
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation
from vision.marker_corner_prediction import marker_map


def lifted(simulation, corners, number, corner, height):
    """Corners with that corner (0..3) of a marker `height` m farther out than its face, in every image."""
    design, T = simulation.world.true, simulation.run.T_base_platform
    map_ = marker_map(design)
    row = int(np.flatnonzero(map_.id == number)[0])
    before, at, after = (map_.corners[row, (corner + step) % 4] for step in (3, 0, 1))
    out = np.cross(before - at, after - at)
    out /= np.linalg.norm(out)
    uv = corners.uv.copy()
    for k in np.flatnonzero((corners.marker == number) & (corners.corner == corner)):
        camera = next(camera for camera in design.cameras if camera.name == corners.camera[k])
        pixels = []
        for point in (at, at + height * out):
            base = T[int(corners.frame[k])].apply(point) if map_.on_platform[row] else point
            ahead = camera.pose.inv().apply(base)
            pixels.append(
                cv2.projectPoints(ahead[None], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0].ravel()
            )
        uv[k] += pixels[1] - pixels[0]
    return replace(corners, uv=uv)


def recording_with_lifted_corner(folder, design, number, corner, height, route, seed=5, noise=0.04):
    """Recording of a secret machine without effects, one corner lifted as above. noise : px"""
    rng = np.random.default_rng(seed)
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, ()),
        plan.build_plan(design, route, seed),
        rng,
    )
    recording_simulation.write_recording(
        done,
        folder,
        hexapod_layout_rig_toml(0.3),
        rng,
        noise,
        corrupt_corners=lambda corners: lifted(done, corners, number, corner, height),
    )
    return recording_folder.load_recording(folder)
