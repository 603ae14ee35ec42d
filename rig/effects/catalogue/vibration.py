"""Vibration of the platform.

A sinusoid in time, sampled at the exposures.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    QUADRATURE,
    Context,
    Covariate,
    Drawing,
    Linear,
    Node,
    Parameter,
)


@dataclass(frozen=True, slots=True)
class Vibration(Effect):
    """Displacement amplitude * sin(2 pi frequency t + phase) along mode, a tangent (x y z, rx ry rz) whose translation
    counts as one unit long whatever its numbers; without a translation they count as they are. A whole number 0 to 2
    stands for x, y or z."""

    place: str
    amplitude: float = 0.0
    frequency: float = 10.0
    mode: tuple[float, ...] = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    phase: float = 0.0
    name: ClassVar = "vibration"
    stage: ClassVar = "structure"
    places: ClassVar = ("rig",)
    lasting: ClassVar = False
    parameters: ClassVar = (
        Parameter("amplitude", "m", (0, 5e-3), (1e-6, 1e-4)),
        Parameter("frequency", "Hz", (1e-4, 1e3), (0.1, 100), role="frequency"),
        Parameter("mode", "1, 1/m", (-1e3, 1e3), (0.5, 2), 6, role="direction"),
        Parameter("phase", "rad", (-7, 7), (-3.1416, 3.1416), role="phase"),
    )
    experiment: ClassVar = "many exposures of one pose at irregular times"
    action: ClassVar = (
        "Find what shakes at that frequency (pump, fan, floor) and decouple the rig, or expose for whole periods."
    )

    def __post_init__(self) -> None:
        if np.size(self.mode) == 1:
            number = float(np.ravel(self.mode)[0])
            if number not in (0, 1, 2):
                raise ValueError(f"mode takes six numbers, a tangent (x y z, rx ry rz), not {self.mode!r}")
            object.__setattr__(self, "mode", tuple(np.eye(6)[int(number)].tolist()))

    @property
    def direction_(self) -> Floats:
        """(6,) the mode, one unit long in its translation."""
        mode = np.asarray(self.mode, float)
        size = np.linalg.norm(mode[:3])
        return mode / size if size > 0 else mode

    def sway(self, motion: Motion) -> Floats:
        return self.amplitude * np.sin(self._angle(motion))[:, None] * self.direction_

    def covariate(self, motion: Motion) -> Covariate:
        return Covariate(self.frequency * motion.t % 1, "phase of the shaking, turns")

    def direction(self, motion: Motion) -> Floats:
        return np.tile(self.direction_, (len(motion.t), 1))

    def conserved_sums(self) -> tuple[dict[tuple[str, int | None], float], ...]:
        size = 3 if np.any(self.mode[:3]) else 6
        return ({("mode", i): self.mode[i] for i in range(size)},)

    def written(self) -> Self:
        mode = self.direction_
        turned = (
            mode[np.argmax(np.abs(mode[:3]) if np.any(mode[:3]) else np.abs(mode))] < 0
        )  # its greatest number is written positive
        phase = np.remainder(self.phase + (2 if turned else 1) * np.pi, 2 * np.pi) - np.pi
        return replace(self, mode=tuple((-mode if turned else mode).tolist()), phase=float(phase))

    def _angle(self, motion: Motion) -> Floats:
        return 2 * np.pi * self.frequency * motion.t + self.phase

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        return super(Vibration, cls).drawn(place, drawing, rng).written()

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        columns = [Linear(name, j, 1e-6) for name in ("mode", QUADRATURE) for j in range(6)]
        return [
            Candidate(cls, place, [{}], columns, extra=1, tied=5)
        ]  # of twelve, a direction (6) and a phase are free

    @classmethod
    def composed(cls, candidate: Candidate, node: Node, coefficients: Floats) -> "Vibration":
        """Of twelve coefficients (six directions of the sine, then of the cosine), the one direction and phase that
        make most of them up.
        """
        u, s, vt = np.linalg.svd(np.reshape(coefficients, (2, 6)), full_matrices=False)
        size = np.linalg.norm(vt[0, :3]) or 1.0
        return cls(
            candidate.place,
            float(s[0] * size),
            mode=tuple(vt[0].tolist()),
            phase=float(np.arctan2(u[1, 0], u[0, 0])),
            **node,
        ).written()
