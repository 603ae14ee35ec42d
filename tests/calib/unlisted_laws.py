"""Six laws that the catalogue does not hold, each a short formula of a few covariates: what a diagnosis should suggest
of them.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from rig.effects.framework.effect_base_class import Effect
from rig.model import machine_motion_simulation as motion_simulation
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation

WARM = (
    "sobol:50,warmup:16,sobol:50,warmup:16,sobol:50"  # hours, in which the room and the struts warm each in its own way
)
# frames with speeds and steps of both directions, over some twenty minutes
PLAN = "moving:24,sobol:60,ladder:6,moving:24,sobol:40"


class OnStrut(Effect):
    """A law of one strut, which errs by what `law` makes of a motion: (n, struts) or (n, 1) m."""

    __slots__ = ()
    stage = "struts"
    places = ("strut",)

    def deviation(self, motion):
        return self.axes(motion.places) * self.law(motion)


@dataclass(frozen=True, slots=True)
class WavyCoupling(OnStrut):
    """A strut takes part in another's travel as a sinusoid: amplitude m, wavelength m, phase rad."""

    place: str
    other: int
    amplitude: float
    wavelength: float
    phase: float
    name = "wavy_coupling"

    def law(self, motion):
        return self.amplitude * np.sin(2 * np.pi * motion.stroke[:, [self.other - 1]] / self.wavelength + self.phase)


@dataclass(frozen=True, slots=True)
class CubicSag(Effect):
    """The platform sinks by the cube of how far it went along the base's x: size m/m^3."""

    place: str
    size: float
    name = "cubic_sag"
    stage = "structure"
    places = ("rig",)
    on_pose = True

    def sway(self, motion):
        if motion.T is None:
            return np.zeros((len(motion.t), 6))
        x = motion.T.translation[:, 0] - motion.mechanism.home.translation[0]
        down = np.stack([np.zeros_like(x), np.zeros_like(x), -self.size * x**3], axis=1)
        return np.concatenate([motion.T.rotation.inv().apply(down), np.zeros((len(x), 3))], axis=1)


@dataclass(frozen=True, slots=True)
class WarmPose(OnStrut):
    """A strut errs by size m/(m K) times how far the platform went along y, times how far the room is from 20 C."""

    place: str
    size: float
    name = "warm_pose"
    on_pose = True

    def law(self, motion):
        y = motion.T.translation[:, 1] - motion.mechanism.home.translation[1]
        return self.size * (y * (motion.channel("ambient_temperature_C") - 20))[:, None]


@dataclass(frozen=True, slots=True)
class RateTimesLength(OnStrut):
    """A strut falls back by size s/m times its speed times its stroke."""

    place: str
    size: float
    name = "rate_times_length"

    def law(self, motion):
        return self.size * motion.path.speed * motion.stroke


@dataclass(frozen=True, slots=True)
class OneSided(OnStrut):
    """A strut errs by size m/m times how far the platform went along x, with the sign of that strut's last move."""

    place: str
    size: float
    name = "one_sided"
    on_pose = True

    def law(self, motion):
        x = motion.T.translation[:, [0]] - motion.mechanism.home.translation[0]
        return self.size * np.sign(motion.path.since_reversal) * x


@dataclass(frozen=True, slots=True)
class DriftingSine(OnStrut):
    """A strut swings slowly in time, ever more: amplitude m at the end, nothing at first; period s, phase rad."""

    place: str
    amplitude: float
    period: float
    phase: float
    end: float
    name = "drifting_sine"

    def law(self, motion):
        swing = (
            self.amplitude * (0.4 + 0.6 * motion.t / self.end) * np.sin(2 * np.pi * motion.t / self.period + self.phase)
        )
        return swing[:, None]


LAWS = (
    "a coupling as a sine of another strut",
    "a cubic sag",
    "a pose times a temperature",
    "a speed times a length",
    "a step's direction times a pose",
    "a sine of time that grows",
)


def drawn(number, rng, end):
    """(Effect, names of its covariates) of one of the six laws, its size still open. end : s of the recording"""
    i, j = (int(k) for k in rng.choice(np.arange(1, 7), 2, replace=False))
    strut, sign, phase = f"strut {i}", float(rng.choice([-1, 1])), float(rng.uniform(-3, 3))
    if number == 0:
        return WavyCoupling(strut, j, 1e-5, float(rng.uniform(0.03, 0.07)), phase), {f"travel of strut {j}"}
    if number == 1:
        return CubicSag("rig", sign * 0.1), {"x"}
    if number == 2:
        return WarmPose(strut, sign * 1e-3), {"y", "ambient_temperature_C"}
    if number == 3:
        return RateTimesLength(strut, sign), {"own speed", "own travel"}
    if number == 4:
        return OneSided(strut, sign * 5e-4), {"own direction", "x"}
    return DriftingSine(strut, 1e-5, end / float(rng.uniform(3, 7)), phase, end), {"time"}


def recorded(folder, design, text, number, seed, seen=2.5e-5):
    """(Recording, Effect, names of its covariates) of a secret machine with one of the laws, of which so much (m, RMS)
    is seen: what no straight line in the struts' travels takes."""
    route = plan.build_plan(design, WARM if number == 2 else PLAN, seed)
    effect, covariates = drawn(number, np.random.default_rng([number, seed]), float(route.t[-1]))
    bare = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(seed), 1.0, ()),
        route,
        np.random.default_rng(seed),
    )
    motion = replace(
        motion_simulation.motion_of_commands(bare.world.true, route.commands, route.t, (), bare.sensors),
        T=bare.run.T_base_platform,
    )
    lengths = effect.deviation(motion) + motion_simulation.apparent_strut_elongations_of_sway(
        bare.world.true, motion.T, effect.sway(motion)
    )
    lines = np.column_stack([np.ones(len(route.t)), motion.stroke])
    left = lengths - lines @ np.linalg.lstsq(lines, lengths, rcond=None)[0]
    size = fields(effect)[1 if number not in (0, 5) else 2 if number == 0 else 1].name
    effect = replace(effect, **{size: getattr(effect, size) * seen / np.sqrt(np.mean(left[:, left.any(axis=0)] ** 2))})
    secret = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(seed), 1.0, (effect,))
    rng = np.random.default_rng(seed)
    recording_simulation.write_recording(
        recording_simulation.simulate_world(secret, route, rng), folder, text, rng, 0.04
    )
    return recording_folder.load_recording(folder), effect, covariates
