"""A trunk with two arms whose springs yield and whose links bend: found, named once, and made up for.

The truth is no effect of the catalogue and no kinematics of the package: every pose minimises potential and elastic
energy together, frames are products of elementary matrices, links bend piece by piece.
"""

import json

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.model.pose import exp, pose_to_vector
from tests.cli import run
from tests.truth.bending import Beam, bent
from tests.two_armed import HUMANOID, NOISE, drawn, humanoid

G = np.array([0.0, 0.0, -9.80665])
SPRINGS = {2: 4e4, 3: 2e4, 4: 1e4, 5: 1.2e4, 10: 1e4}  # N m/rad, of joints from 1
BEAMS = {1: (2e4, 1.5e4), 5: (2e3, 1.54e3), 11: (3e3, 2.3e3)}  # N m^2, E I and G J of links that joints from 1 move
TRUNK, LEFT, RIGHT = range(1, 4), range(4, 10), range(10, 16)  # joints from 1
CARRIES = {**dict.fromkeys(TRUNK, (0, 1)), **dict.fromkeys(LEFT, (0,)), **dict.fromkeys(RIGHT, (1,))}
STEP = 1e-4


def elementary(axis, angle=None, shift=None):
    """(..., 4, 4) turn about, or shift along, an axis 0, 1 or 2."""
    M = np.zeros((*np.shape(angle if shift is None else shift), 4, 4))
    M[..., range(4), range(4)] = 1
    if shift is not None:
        M[..., axis, 3] = shift
        return M
    one, two = [k for k in range(3) if k != axis][:: -1 if axis == 1 else 1]
    M[..., one, one] = M[..., two, two] = np.cos(angle)
    M[..., two, one] = np.sin(angle)
    M[..., one, two] = -np.sin(angle)
    return M


def links(q, arm):
    """(where links begin, where they end) (15, n, 4, 4) each, by elementary matrices."""
    starts, frames = [], []
    mounts = {3: arm.branches[0].mount.as_matrix(), 9: arm.branches[1].mount.as_matrix()}
    for i, (theta, d, a, alpha, beta) in enumerate(arm.rows):
        base = np.tile(arm.base.as_matrix(), (len(q), 1, 1))
        start = frames[2] @ mounts[i] if i in mounts else frames[-1] if frames else base
        starts.append(start)
        link = elementary(2, q[:, i] + theta) @ elementary(2, shift=d) @ elementary(0, shift=a)
        frames.append(start @ link @ elementary(0, alpha) @ elementary(1, beta))
    return starts, frames


def tips(q, arm, beams=None):
    """(2, n, 4, 4) of both hands, some of whose links bend: {joint from 1: (E I, G J)}."""
    starts, frames = links(q, arm)
    hands = [frames[hand.joint] @ hand.tool.as_matrix() for hand in arm.hands]
    bending = [
        Beam(starts[joint - 1][:, :3, 3], frames[joint - 1][:, :3, 3], CARRIES[joint], *stiffness)
        for joint, stiffness in sorted((beams or {}).items())
    ]
    return np.stack(bent(hands, [(hand.mass, hand.centre_of_mass) for hand in arm.hands], bending))


def potential(q, arm):
    """(n,) J of both hands."""
    T = tips(q, arm)
    places = [T[k] @ np.r_[hand.centre_of_mass, 1.0] for k, hand in enumerate(arm.hands)]
    return -sum(hand.mass * (p[:, :3] @ G) for hand, p in zip(arm.hands, places))


def settled(q, arm):
    """Joint values (n, 15) at which springs and weight balance, commanded q."""
    out = q.copy()
    for _ in range(12):
        for joint, stiffness in SPRINGS.items():
            step = STEP * np.eye(15)[joint - 1]
            out[:, joint - 1] = (
                q[:, joint - 1] - (potential(out + step, arm) - potential(out - step, arm)) / (2 * STEP) / stiffness
            )
    return out


def write_recording(folder, arm, count, rng, beams):
    """A recording of a true arm, some of whose links bend, at random commands, both hands seen at each."""
    folder.mkdir()
    q = rng.uniform(*(0.85 * arm.limits).T, (count, 15))
    t = 10.0 * np.arange(count)
    (folder / "rig.toml").write_text(HUMANOID.read_text())
    np.savetxt(
        folder / "commands.csv",
        np.column_stack([np.r_[t, t[-1] + 9], np.r_[q, q[-1:]]]),
        "%.10f",
        ",",
        header="t," + ",".join(f"q{k + 1}" for k in range(15)),
        comments="",
    )
    lines = [f"{k},{time:.3f},," for k, time in enumerate(t)]
    (folder / "frames.csv").write_text("\n".join(["frame,t,camera,image", *lines]) + "\n")
    rows = ["frame,hand,x,y,z,rx,ry,rz"]
    for name, T in zip(("left", "right"), tips(settled(q, arm), arm, beams)):
        seen = pose_to_vector(RigidTransform.from_matrix(T) * exp(NOISE * rng.normal(size=(count, 6))))
        rows += [f"{k},{name}," + ",".join(f"{value:.10f}" for value in row) for k, row in enumerate(seen)]
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.slow
@pytest.mark.parametrize("beams", [{}, BEAMS], ids=["stiff links", "bending links"])
def test_every_spring_is_named_once_and_held_out_poses_are_met_to_the_noise(tmp_path, monkeypatch, beams):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(11)
    true = drawn(humanoid().mechanism, rng)
    write_recording(tmp_path / "REC", true, 300, rng, beams)
    write_recording(tmp_path / "NEW", true, 100, rng, beams)
    run("diagnose", "REC", "--out", "found")
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    hidden = {("compliance", f"joint {joint}"): stiffness for joint, stiffness in SPRINGS.items()}
    hidden |= {("link_bending", f"joint {joint}"): stiffness for joint, (stiffness, _) in beams.items()}
    assert sorted((one["effect"], one["place"]) for one in found) == sorted(hidden)
    for one in found:
        value = one["parameters"]["stiffness"]["value"]
        assert abs(value / hidden[one["effect"], one["place"]] - 1) < 0.05
    run("calibrate", "REC", "--diagnosis", "found", "--out", "calibration.json")
    for hand in ("left", "right"):
        tree = json.loads(run("verify", "calibration.json", "NEW", "--hand", hand, "--json").stdout)
        noise = tree["measurement_uncertainty"]
        assert tree["after"]["position"]["rms"] < 1.2 * noise["position"]
        assert tree["after"]["rotation"]["rms"] < 1.2 * noise["rotation"]
        assert tree["verdict"]["state"] == "good" and tree["claim"]["kept"]
