"""A world under a plan -> a recording folder, with images or with corners, and the truth apart."""

import json
from pathlib import Path

import cv2
import numpy as np

from rig import machine
from rig.recording import Corners, write_corners
from synthetic import scene
from synthetic.sensor import expose
from vision.predict import expected
from vision.targets import marker_map


def simulate(world, plan, out, rng, text, sensor=None, noise=None, background="plain", progress=None):
    """Write a recording of a world under a plan, as its owner would have it, and return the true poses.

    world : World; plan : Plan; out : folder to fill; rng : numpy Generator; text : the owner's rig.toml
    sensor : Sensor, to render images; noise : px, to write corners with that standard deviation (one of the two)
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    (out / "rig.toml").write_text(text, encoding="utf-8")
    T = machine.poses(world.true.mechanism, plan.commands, plan.t)
    _write_commands(out / "commands.csv", world.stated.mechanism.axes, plan.commands)
    rows = ["frame,t,camera,image"]
    for f, t in enumerate(plan.t):
        rows += [f"{f},{t:.4f},{camera.name}," + (f"images/{camera.name}/{f:05d}.png" if sensor else "") for camera in world.true.cameras]
    (out / "frames.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    if sensor is not None:
        _render(world, T, out, rng, sensor, background, progress)
    else:
        write_corners(out / "corners.csv", corners(world.true, T, noise, rng))
    return T


def corners(design, T_base_platform, noise, rng):
    """Corners of all markers that face a camera of a design, with noise (px) on each coordinate."""
    markers = marker_map(design)
    frame, camera_name, marker, uv = [], [], [], []
    for f, T in enumerate(T_base_platform):
        for camera in design.cameras:
            rows, places = expected(camera, T, markers)
            frame += [f] * 4 * len(rows)
            camera_name += [camera.name] * 4 * len(rows)
            marker.append(np.repeat(markers.id[rows], 4))
            uv.append(places.reshape(-1, 2))
    uv = np.concatenate(uv)
    return Corners(np.array(frame), camera_name, np.concatenate(marker), np.tile(np.arange(4), len(uv) // 4),
                   uv + noise * rng.normal(size=uv.shape), None)


def write_truth(path, world, T_base_platform):
    """Write the truth of a recording as JSON: effects, joints, zeros, and the poses as row-major 4 x 4."""
    m = world.true.mechanism
    tree = {"effects": [], "base_joints": m.base_joints.tolist(), "platform_joints": m.platform_joints.tolist(),
            "strut_zeros": m.strut_zeros.tolist(), "poses": T_base_platform.as_matrix().reshape(-1, 16).tolist()}
    Path(path).write_text(json.dumps(tree) + "\n", encoding="utf-8")


def _write_commands(path, axes, commands):
    rows = [",".join(("t", *axes))]
    rows += [f"{t:.4f}," + ",".join(f"{value:.7f}" for value in values) for t, values in zip(commands.t, commands.values)]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def _render(world, T, out, rng, sensor, background, progress):
    from synthetic.render import Renderer

    renderer = Renderer(scene.parts(world.true, background, rng), world.true)
    try:
        for camera in world.true.cameras:
            (out / "images" / camera.name).mkdir(parents=True, exist_ok=True)
        for f in range(len(T)):
            for camera in world.true.cameras:
                image = expose(renderer.draw(camera.name, T[f]), sensor, rng)
                cv2.imwrite(str(out / "images" / camera.name / f"{f:05d}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
            if progress:
                progress(f + 1, len(T))
    finally:
        renderer.close()
