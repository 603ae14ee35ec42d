"""Parameters are as sure as is said: z-scores over two hundred recordings, of arms that are seen and two struts from
corners, of a chain from poses and from corners.

A world is recorded once; two hundred times noise is put on its corners, or on the instrument's poses, and all is
measured and identified anew. What parameters truly are, in the gauge of the fit, is what the same recording says with
next to no noise.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.models.arm.arm_certification import arm_correction_and_identification
from calib.models.chain import chain_error_model_and_identification as chains
from calib.models.chain.chain_error_model_and_identification import identify_chain as identify_chain
from calib.models.platform.platform_identification import identify_platform
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from rig.model.pose import exp, log
from rig.recording import recording_folder
from tests.closed_loops import design_two_struts, rig, simulate_with_truth
from tests.gantry_and_hexapod import written

RUNS, NOISE = 200, 0.04  # px
DETERMINED = (
    0.05  # of what an owner may be off by, above which a combination's standard error is the owner's, not the corners'
)
pytestmark = pytest.mark.slow


def arm(folder, carried, cameras):
    rig(
        "design",
        "--arm",
        "ur10",
        "--seen",
        carried,
        "--cameras",
        cameras,
        "--cubes",
        "3",
        "--size",
        "1280x1024",
        "--out",
        folder / "rig.toml",
    )
    return "sobol:20"


def planar(folder):
    design_two_struts(folder, "--size", "640x512")
    return "sobol:16"


def on_a_gantry(folder, **words):
    written(folder, **words)
    return "sobol:40"


def seen_on_a_gantry(folder):
    return on_a_gantry(folder, seen=True)


def with_its_carriage(folder):
    return on_a_gantry(folder, seen=True, carriage=True)


def fitted(samples, design, instrument):
    """(what was identified, its covariance (p, p), sizes (p,) of what an owner may be off by) of one recording's
    samples.
    """
    m = design.mechanism
    if m.kind == "arm":
        _, found = arm_correction_and_identification(samples, m, instrument, profiles=False)
        return found.arm, found.covariance, np.full(len(found.covariance), np.inf)
    if m.kind == "chain":
        found = identify_chain(samples, m)
        return found.step, found.covariance, chains.parameter_tolerances(m)
    found = identify_platform(samples, m)
    return geometric_parameters(found.mechanism), found.covariance, found.prior


def off(found, true):
    """(p,) m and rad, of what was identified from what is true, as its covariance counts."""
    if isinstance(found, np.ndarray):
        return found - true
    ends = [log(a.inv() * b) for a, b in ((true.base, found.base), (true.tool, found.tool))]
    return np.concatenate([ends[0], (found.rows - true.rows).ravel(), ends[1]])


def scores(folder, make, *words):
    """(runs, combinations) z of what is identified, along combinations that are independent and that corners tell, not
    the owner.
    """
    plan = make(folder, *words)
    simulate_with_truth(folder, plan, 4, "--noise", "0")
    clean = recording_folder.load_recording(folder / "rec")
    if clean.poses is not None:
        poses = np.array(json.loads((folder / "truth.json").read_text())["poses"]).reshape(-1, 4, 4)
        clean = replace(clean, poses=replace(clean.poses, T_base_platform=RigidTransform.from_matrix(poses)))
    rng, out = np.random.default_rng(0), []

    def fitted_to_noisy(share):
        sampled = sample_recording(noisy(clean, share, rng))
        return fitted(sampled.samples, clean.design, sampled.instrument)

    true, _, _ = fitted_to_noisy(1e-5)
    found, covariance, size = fitted_to_noisy(1.0)
    along = combinations(covariance, size)
    for _ in range(RUNS):
        found, covariance, _ = fitted_to_noisy(1.0)
        out.append(np.linalg.solve(np.linalg.cholesky(along.T @ covariance @ along), along.T @ off(found, true)))
    return np.array(out)


def noisy(clean, share, rng):
    """A recording without noise, with that share of it: on its corners, or on an instrument's poses, whose own is
    stated.
    """
    if clean.corners is not None:
        return replace(
            clean,
            corners=replace(
                clean.corners, uv=clean.corners.uv + share * NOISE * rng.normal(size=clean.corners.uv.shape)
            ),
        )
    sigma = share * np.repeat([clean.design.instrument.position_sigma, clean.design.instrument.rotation_sigma], 3)
    T = clean.poses.T_base_platform
    return replace(clean, poses=replace(clean.poses, T_base_platform=T * exp(sigma * rng.normal(size=(len(T), 6)))))


def combinations(covariance, size):
    """(p, r) combinations of parameters, apart from each other, that are told to TOLD of what an owner may be off by;
    all where none is stated.
    """
    free = np.flatnonzero(np.diag(covariance) > 0)
    scale = np.where(np.isfinite(size), size, np.sqrt(np.diag(covariance)))[free]
    values, vectors = np.linalg.eigh(covariance[np.ix_(free, free)] / np.outer(scale, scale))
    sharp = values < DETERMINED**2 if np.isfinite(size).all() else np.ones(len(values), bool)
    along = np.zeros((len(size), sharp.sum()))
    along[free] = vectors[:, sharp] / scale[:, None]
    return along


@pytest.mark.parametrize(
    "make, words",
    [
        (arm, ("cubes", 2)),
        (arm, ("hand", 1)),
        (planar, ()),
        (on_a_gantry, ()),
        (seen_on_a_gantry, ()),
        (with_its_carriage, ()),
    ],
    ids=[
        "arm with cubes",
        "camera in the hand",
        "planar2",
        "hexapod on a gantry",
        "seen on a gantry",
        "with its carriage seen",
    ],
)
def test_z_scores_of_two_hundred_recordings(tmp_path, make, words):
    z = scores(tmp_path, make, *words)
    assert len(z) == RUNS and abs(z.mean()) < 0.1 and np.abs(z.mean(axis=0)).max() < 4.5 / np.sqrt(RUNS)
    assert 0.95 < z.std() < 1.05
