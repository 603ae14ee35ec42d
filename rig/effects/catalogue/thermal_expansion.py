"""Thermal expansion of struts, or of an arm's links.

They grow with their logged temperature.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import REFERENCE_TEMPERATURE, Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Context,
    ControllerTerm,
    Covariate,
    Parameter,
    c_channel_expression,
    temperature_covariate,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place

AMBIENT = "ambient_temperature_C"
LAGS = 8  # that a search tries


@dataclass(frozen=True, slots=True)
class ThermalExpansion(Effect):
    """Share coefficient * (T - 20 C) by which a strut is longer, or the link behind a joint; T its own channel, for a
    link else the room's, which the metal follows by a first-order lag (0 s: at once).
    """

    place: str
    coefficient: float = 0.0
    lag: float = 0.0
    name: ClassVar = "thermal_expansion"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis", "rig")
    parameters: ClassVar = (
        Parameter("coefficient", "1/K", (-1e-4, 1e-4), (9e-6, 2.4e-5)),
        Parameter("lag", "s", (0, 1e5), (60, 3600), role="form"),
    )
    experiment: ClassVar = "heat the {axis}s, or log their temperatures: without a log it is a warm-up"
    action: ClassVar = "Let the machine reach its temperature, or correct lengths by the logged temperatures."

    def needs(self, motion: Motion) -> str | None:
        return next(
            filter(None, (motion.no_channel(*_channels(place)) for place in motion.places if self.at(place))), None
        )

    def deviation(self, motion: Motion) -> Floats:
        return self._grown(motion)[0]

    def sway(self, motion: Motion) -> Floats:
        return self._grown(motion)[1] if motion.kind.AXIS != "strut" else np.zeros((len(motion.t), 6))

    def _grown(self, motion: Motion) -> tuple[Floats, Floats]:
        share = np.zeros(motion.lengths.shape)
        for i in np.flatnonzero(self.axes(motion.places)):
            warm = motion.lagged_channel(self.lag, *_channels(motion.places[i]))
            share[:, i] = self.coefficient * (warm - REFERENCE_TEMPERATURE)
        return motion.kind.axis_deviation_and_sway_by_member_growth(motion.T, motion.lengths, motion.mechanism, share)

    def in_controller(self, motion: Motion) -> ControllerTerm | None:
        if motion.kind.AXIS != "strut":  # a link that grows moves the hand, and no joint
            return None
        sits = np.flatnonzero(self.axes(motion.places)).tolist()
        names = {i: _channels(motion.places[i])[0] for i in sits}
        return ControllerTerm(
            tuple(
                f"d[{i}] += {self.coefficient!r} * ({c_channel_expression(name)} - {REFERENCE_TEMPERATURE!r}) * c[{i}];"
                for i, name in names.items()
            ),
            channels=tuple(names.values()),
            lag=self.lag,
        )

    def covariate(self, motion: Motion) -> Covariate:
        warm = [
            motion.lagged_channel(self.lag, *_channels(place)) if self.at(place) else np.zeros(len(motion.t))
            for place in motion.places
        ]
        return temperature_covariate(np.stack(warm, axis=1), f"the {motion.kind.AXIS}")

    @classmethod
    def follows(cls, place: str, context: Context) -> tuple[tuple[str, ...], ...]:
        return tuple(_channels(at) for at in context.moved().places if place in (at, "rig"))

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        lag = cls.parameters[1]
        late = [{lag.name: value} for value in np.geomspace(*lag.usual, LAGS).tolist()]
        return [
            *super(ThermalExpansion, cls).candidates(place, context),
            Candidate(cls, place, late, cls.linear(place), "late", extra=1),
        ]

    @classmethod
    def sites(cls, context: Context) -> tuple[str, ...]:
        found = super(ThermalExpansion, cls).sites(context)
        own = any(context.logged(_channels(place)[0]) for place in context.moved().places)
        return (
            found if context.moved().kind.AXIS == "strut" or own else ("rig",)
        )  # one temperature tells of no link by itself


def _channels(place: str) -> tuple[str, ...]:
    """The channels, any one of which tells an axis' temperature: a strut's is its own, a link's may be the room's."""
    own, at = f"{place.replace(' ', '')}_temperature_C", Place.parse(place)
    return (own,) if at.kind == "strut" and not at.stage else (own, AMBIENT)
