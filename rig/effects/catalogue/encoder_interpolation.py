"""Encoder interpolation error.

A scale's signals are interpolated wrongly, the same in each of its many periods.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Context,
    Covariate,
    Drawing,
    Node,
    Parameter,
    draw_scalar_parameter,
    sine_and_cosine_columns_of_travel,
)

FINE = 0.3  # step of the periods, of what an axis' travel resolves
OF_SCREW = 5.0  # periods in a screw's lead, up to which it is the screw's cyclic error
SAME = 6  # digits of m, in which lengths that are visited again are the same
SHORTEST = 1e-3  # m of travel; on less nothing fine is found
ALIAS, SLOWEST = 0.25, 10  # share of lengths that stand alike within a period; periods in the travel of what is slow
FEWEST, MOST = 500.0, 1e4  # 1/m; finer scales err by less than cameras see: a hundredth of their pitch


@dataclass(frozen=True, slots=True)
class EncoderInterpolation(Effect):
    """Deviation amplitude * sin(2 pi periods q + phase), q the commanded value less that at home, periods in a metre:
    one over the pitch of the scale. What unbalanced signals err by has half that pitch and is an effect of its own.
    Source: Heydemann, Determination and correction of quadrature fringe measurement errors, 1981."""

    place: str
    amplitude: float = 0.0
    phase: float = 0.0
    periods: float = 2000.0
    name: ClassVar = "encoder_interpolation"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("amplitude", "m", (0, 1e-4), (1e-7, 5e-6)),
        Parameter("phase", "rad", (-7, 7), (-3.1416, 3.1416), role="phase"),
        Parameter("periods", "1/m", (50, 2e5), (FEWEST, MOST), role="even"),
    )
    experiment: ClassVar = "fine steps that are no whole part of the scale's pitch, over some millimetres of one strut"
    action: ClassVar = (
        "Adjust the strut's reading head: its distance, its tilt, and the offset and gain of its signals."
    )
    form: ClassVar = "sinusoid"
    own_axis: ClassVar = 2

    def needs(self, motion: Motion) -> str | None:
        return None if motion.kind.AXIS == "strut" else "takes struts: a joint's scale errs as its cyclic error"

    def deviation(self, motion: Motion) -> Floats:
        angle = 2 * np.pi * self.periods * motion.stroke + self.phase
        return self.axes(motion.places) * self.amplitude * np.sin(angle)

    def covariate(self, motion: Motion) -> Covariate:
        return Covariate(self.periods * motion.stroke % 1, "period of the scale, share of a turn")

    @classmethod
    def columns_of_nodes(cls, candidate: Candidate, nodes: Sequence[Node], motion: Motion) -> Floats:
        effects, own = [cls(candidate.place, **node) for node in nodes], cls(candidate.place).axes(motion.places) > 0
        return sine_and_cosine_columns_of_travel(
            motion.stroke, own, [2 * np.pi * e.periods for e in effects], [e.phase for e in effects]
        )

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        amplitude, phase = (draw_scalar_parameter(p, drawing, rng) for p in cls.parameters[:2])
        return cls(
            place,
            amplitude,
            phase,
            float(rng.uniform(fewest_encoder_periods_distinct_from_screw_error(drawing.motion), MOST)),
        )

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        motion = context.moved()
        lengths = motion.lengths[:, motion.places.index(place)]
        spacing = FINE / max(np.ptp(lengths), SHORTEST)
        periods = np.arange(fewest_encoder_periods_distinct_from_screw_error(motion) + spacing, MOST, spacing)
        grid = [{"periods": float(w)} for w in periods[~are_periods_aliased(np.unique(lengths.round(SAME)), periods)]]
        return [Candidate(cls, place, grid, cls.linear(place), extra=1)] if grid else []


def fewest_encoder_periods_distinct_from_screw_error(motion: Motion) -> float:
    """Fewest periods per metre by which an encoder's error is distinct from the screw's.

    With fewer it would be the screw's cyclic error.
    """
    return max(FEWEST, OF_SCREW / (motion.actuator.screw_lead or np.inf))


def are_periods_aliased(lengths: Floats, periods: Floats) -> Booleans:
    """Whether periods (k,) 1/m are aliased by evenly spaced lengths (n,) m.

    Such periods look like a slow function.
    Steps that are whole multiples of a pitch show nothing of what is within it.
    """
    window = np.abs(np.exp(2j * np.pi * periods[:, None] * lengths).mean(axis=1))
    reach = round(SLOWEST / FINE)
    return np.convolve(window > ALIAS, np.ones(2 * reach + 1))[reach:-reach] > 0.5
