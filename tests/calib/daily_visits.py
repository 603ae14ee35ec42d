"""Rigs visited day by day: a calibration, quiet visits, and visits after one of six changes."""

from dataclasses import dataclass, replace

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import fit_geometry_and_remainder_of_correction
from calib.drift.choice_and_order_of_visit_configurations import choose_visit_configurations
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from rig.recording.recording_folder import Sensors
from synthetic import random_true_machine_and_truth_file as world
from synthetic import recording_simulation

NOISE = 0.04  # px
ROOM = 20.0  # degrees Celsius
ALWAYS = ("thermal_expansion:rig:coefficient=1.15e-5", "compliance:rig:stiffness=1e6")
SIX = ("camera", "backlash", "temperature", "zero", "target", "payload")


@dataclass(frozen=True)
class Rig:
    """world : the World; text : its rig.toml; calibration : Calibration; route : the Plan of a visit."""

    world: world.World
    text: str
    calibration: Calibration
    route: plan.Plan

    def visit(self, folder, rng, change=None):
        """Recording of a visit to a folder, after a Change or none."""
        change = change or Change("nothing", self.world)
        weather = _weather(self.route, change.room + 0.2 * rng.normal(), change.load)
        recording_simulation.write_recording(
            recording_simulation.simulate_world(change.world, self.route, rng, weather), folder, self.text, rng, NOISE
        )
        return recording_folder.load_recording(folder)


@dataclass(frozen=True)
class Change:
    """name : as the watch should give it; world : World after it; room : degrees Celsius; load : kg on the platform."""

    name: str
    world: world.World
    room: float = ROOM
    load: float = 0.0


def rig(design, text, seed, folder, poses=80):
    """A Rig drawn at random and calibrated from so many poses; its platform's weight and its warmth act on it, and are
    not known.
    """
    rng = np.random.default_rng(seed)
    secret = world.random_true_machine(design, rng, 1.0, tuple(map(parse_effect, ALWAYS)))
    route = plan.build_plan(design, f"sobol:{poses}", seed)
    recording_simulation.write_recording(
        recording_simulation.simulate_world(secret, route, rng, _weather(route, ROOM, 0.0)), folder, text, rng, NOISE
    )
    sampled = sample_recording(recording_folder.load_recording(folder))
    correction, found = fit_geometry_and_remainder_of_correction(sampled.samples, design.mechanism)
    made = Calibration(correction, found.covariance, found.scatter, tuple(sampled.samples.frame.tolist()), (), None, {})
    return Rig(secret, text, made, visits_of(design, made))


def visits_of(design, calibration):
    """Plan of a visit to a calibrated rig."""
    strokes = design.mechanism.strut_range
    return plan.plan_of_configurations(
        choose_visit_configurations(calibration, design, 12).commands,
        strokes.mean(axis=1),
        plan.planned_axis_speeds(design),
    )


def changed(which, rig, rng):
    """Change of a kind of SIX, where and how much at random."""
    strut, sign = int(rng.integers(6)), rng.choice([-1, 1])
    true, effects = rig.world.true, rig.world.effects
    if which == "camera":
        place = f"camera {true.cameras[rng.integers(len(true.cameras))].name}"
        return Change(
            place, replace(rig.world, effects=(*effects, parse_effect(f"camera_bump:{place}:motion={_motion(rng)}")))
        )
    if which == "target":
        place = f"target B{1 + rng.integers(4)}"
        return Change(
            place,
            replace(rig.world, effects=(*effects, parse_effect(f"cube_misplacement:{place}:motion={_motion(rng)}"))),
        )
    if which == "backlash":
        return Change(
            f"nut of strut {strut + 1}",
            replace(
                rig.world, effects=(*effects, parse_effect(f"backlash:strut{strut + 1}:gap={rng.uniform(2e-5, 1e-4)}"))
            ),
        )
    if which == "zero":
        zeros = true.mechanism.strut_zeros + sign * rng.uniform(2e-5, 2e-4) * (np.arange(6) == strut)
        return Change(
            f"zero of strut {strut + 1}",
            replace(rig.world, true=replace(true, mechanism=replace(true.mechanism, strut_zeros=zeros))),
        )
    if which == "temperature":
        return Change("growth of all struts", rig.world, room=ROOM + sign * rng.uniform(4, 12))
    return Change("sag under added load", rig.world, load=float(rng.uniform(3, 12)))


def _motion(rng):
    """Text of a knock: 0.1 to 1 mm and as many mrad, in any direction."""
    parts = [part / np.linalg.norm(part) * rng.uniform(1e-4, 1e-3) for part in rng.normal(size=(2, 3))]
    return "/".join(f"{value:.6g}" for value in np.concatenate(parts))


def _weather(route, room, load):
    """Sensors of a visit as they truly are; the machine's owner logs them too, and the watch does not look at them."""
    t = np.array([0.0, route.commands.t[-1] + 60.0])
    warm = {f"strut{i + 1}_temperature_C": np.full(2, room) for i in range(6)}
    return Sensors(t, {"ambient_temperature_C": np.full(2, room), "payload_mass_kg": np.full(2, load), **warm})
