"""Rigs with one thing left out of their geometry: calibrated with what a diagnosis found, and driven in time under
other weather and loads.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.platform_certification import Certified
from calib.correction.machine_correction import fit_geometry_and_remainder_of_correction
from calib.diagnosis.geometry_refitted_with_diagnosed_effects import findings_of_diagnosis, refit_platform_with_findings
from calib.models.wanted_pose_commands import commands_along_route, pace_with_hold_times
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import MOTION_STAGES
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.pose import pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.noisy_samples import rms

REQUESTED = [
    kind.name for kind in ALL if kind.stage in MOTION_STAGES
]  # what cameras leave out is diagnosed apart, and takes most of the time
POSES = 100
LOAD_EVERY = 600.0  # s


@dataclass(frozen=True)
class Driven:
    """error : (m, rad) RMS of wanted poses driven in time; stated : m, RMS of its standard uncertainty; found : the
    Effects undone.
    """

    error: tuple
    stated: float
    found: tuple


def write(folder, design, text, seed, effects, route):
    """(Recording at a folder, World) of a rig with effects. text : its rig.toml"""
    rng = np.random.default_rng(seed)
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, tuple(effects))
    recording_simulation.write_recording(
        recording_simulation.simulate_world(secret, plan.build_plan(design, route, seed), rng), folder, text, rng, 0.04
    )
    return recording_folder.load_recording(folder), secret


def learnt(rec, sampled, findings, remainder="find"):
    """Calibration of a recording's samples; findings : Findings taken in, or None: geometry and what is smooth over the
    configuration alone.
    remainder : "none" for no such thing"""
    refitted = None if findings is None else refit_platform_with_findings(rec, sampled, findings)
    samples = sampled.samples if refitted is None else refitted.samples
    correction, found = fit_geometry_and_remainder_of_correction(samples, rec.design.mechanism, remainder)
    done = Certified(correction, found, np.arange(len(samples)), None)
    physics, covariance = (None, found.covariance) if refitted is None else refitted.with_geometry(done)
    return Calibration(
        correction, covariance, found.scatter, tuple(samples.frame.tolist()), (), None, {}, None, physics
    )


def driven(calibration, secret, seed, sensed=True, approach="auto", poses=POSES):
    """Driven of a calibration through poses, times, weather and loads of another seed. sensed : whether the drive's
    sensors are logged
    """
    rng = np.random.default_rng([seed, 1])
    m = secret.stated.mechanism
    T = mechanisms.kinematics_of(m).forward(
        configuration_generators.sobol_configurations(m.strut_range, poses, 0.75, seed=int(rng.integers(1 << 30))), m
    )
    t = 30 + np.cumsum(rng.uniform(8, 40, poses))
    true, log = random_true_machine_and_truth_file.random_true_and_logged_temperatures(t[-1], rng)
    payload = np.where(true.t % (2 * LOAD_EVERY) < LOAD_EVERY, 0.0, 0.6 * (secret.stated.platform.mass or 0.0))
    true, log = (replace(s, channels={**s.channels, "payload_mass_kg": payload}) for s in (true, log))
    done = commands_along_route(
        calibration,
        T,
        mechanisms.kinematics_of(m).home_values(m),
        pace_with_hold_times(calibration, t, log),
        log if sensed else None,
        approach,
    )
    run = motion_simulation.simulate_machine_run(
        secret.true, done.route.commands(np.round(done.values, 10)), t, secret.effects, true
    )
    errors = pose_difference(T, run.T_base_platform)
    stated = np.sqrt(np.trace(done.covariance[:, :3, :3], axis1=1, axis2=2).mean())
    return Driven(
        rms(errors), float(stated), () if calibration.physics is None else calibration.physics.compensable_effects()
    )


def three_ways(folder, design, text, seed, effect, route):
    """(Driven with physics, Driven plain, Driven of the same rig without the effect, calibrated plainly)."""
    rec, secret = write(folder / "with", design, text, seed, (effect,), route)
    sampled = sample_recording(rec)
    known = learnt(rec, sampled, findings_of_diagnosis(diagnosis_of(rec, only=REQUESTED, sampled=sampled)))
    plain = learnt(rec, sampled, None)
    bare, innocent = write(folder / "without", design, text, seed, (), route)
    without = learnt(bare, sample_recording(bare), None)
    return (
        driven(known, secret, seed + 1000),
        driven(plain, secret, seed + 1000),
        driven(without, innocent, seed + 1000),
    )


def measured_by(text=None, position=4e-6, rotation=3e-5):
    """A rig.toml whose poses an outside instrument sees, in place of cameras: m and rad, standard deviations."""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3) if text is None else text
    return text[: text.index("\n[[camera]]")] + (
        f'\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = {position}\nrotation_sigma = {rotation}\n'
    )
