"""Poses and corners from images of rigs that are not there, printed as printers print, poses visited again: is what they say true?"""

import tempfile
from pathlib import Path

import numpy as np

from calib.pipeline import sample_recording
from rig import recording
from rig.pose import difference
from synthetic import blind
from tests.vision.scenes import nees
from tests.vision.test_measure import joint_chi2
from vision.predict import Sightings, State, see
from vision.targets import marker_map

SEED, RECORDINGS, FRAMES = 7001, 20, 40
INSIDE = 5.991  # chi-square with 2 degrees of freedom that 95 % stay below
NEAR = 1e-4  # m and rad; poses as near to an earlier one are visited again


def rows():
    """Yield (figure, reached, wanted). Three resolutions, two lenses, blur, defocus, vignetting, noise; ladders and repeats; nothing hidden."""
    chi2, count, alone, inside, again, ratios = 0.0, 0, [], [], [], []
    for index in range(1, RECORDINGS + 1):
        with tempfile.TemporaryDirectory() as folder:
            case = blind.draw(SEED, index, FRAMES, kinds=["nothing"], images=True)
            blind.write_recording(case, Path(folder) / "rec")
            m = sample_recording(recording.load(Path(folder) / "rec")).measurement
        T = case.simulation.run.T_base_platform
        errors = difference(m.T_base_platform, T[m.frames])
        chi2, count = chi2 + joint_chi2(m, errors), count + len(errors)
        alone.append(np.mean(nees(errors, m.covariance)) / 6)
        kept = m.observations.take(m.inliers)
        off = kept.uv - true_corners(case, kept)
        square = nees(off, kept.covariance)
        inside.append(np.mean(square < INSIDE))
        again.append(np.mean(square[np.isin(kept.frame, np.flatnonzero(revisited(T)[kept.frames]))] < INSIDE))
        ratios.append(m.noise / case.noise)
    figure = f"{RECORDINGS} recordings of some {FRAMES} frames: "
    yield figure + "normalised error squared / 6 of poses, jointly", f"{chi2 / count / 6:.3f}", "0.93-1.07"
    yield figure + "the same pose by pose, median; worst recording", f"{np.median(alone):.2f}; {max(alone):.2f}", ""
    yield figure + "corners in their stated 95 % ellipse", f"{100 * np.mean(inside):.1f} %", "93-97 %"
    yield figure + "the same at poses visited again", f"{100 * np.nanmean(again):.1f} %", "93-97 %"
    yield figure + "corners' noise over the Cramer-Rao bound, median", f"{np.median(ratios):.2f}", ""


def true_corners(case, observations):
    """(n, 2) px where the observed corners of a DrawnCase really are. observations : Observations"""
    done, o = case.simulation, observations
    sighting, row = np.unique(np.stack([o.camera, o.frame, o.marker], axis=1), axis=0, return_inverse=True)
    seen = Sightings(o.frames[sighting[:, 1]], sighting[:, 0], sighting[:, 2])
    state = State(done.world.true.cameras, done.run.T_base_platform, {})
    quads = see(seen, state, marker_map(done.world.true), done.plan.t, done.world.effects, done.sensors, done.run)
    return quads[row.ravel(), o.corner]


def revisited(T):
    """(F,) bool, which poses lie within NEAR of an earlier or a later one. T : RigidTransform (F,)"""
    apart = np.array([np.abs(difference(T, one)).max(axis=1) for one in T])
    return (apart < NEAR).sum(axis=1) > 1
