"""Candidate effects of a platform.

Every effect of the catalogue at every place that the recording can test.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from calib.diagnosis.engine.candidate_score import Score
from calib.diagnosis.engine.data_types_of_candidates_thresholds_and_outliers import (
    Candidate,
    Node,
    NotAsked,
    Role,
    UsualRange,
)
from calib.diagnosis.problems.evidence_interface_and_requested_effects import EffectSites, RequestedEffects
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from rig.array_and_json_types import Floats
from rig.effects.framework.effect import Candidate as EffectCandidate
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_parameters_and_covariates import COUNT, QUADRATURE, Context
from rig.model.hands_places_and_tolerances import Place

SIZED = ("linear", "inverse", "size")  # roles of the numbers that tell how large an effect is
ROUNDED = 1e-12  # share by which a sinusoid stays below its amplitude's bound, so that rounding does not take it beyond
SEARCHED = ("log", "even", "moment", "form", "choice")  # roles of parameters that mean nothing without the effect


class Reach(Enum):
    """What an effect changes, and so how its columns are made: axes' lengths, a camera's mount, what is seen, a
    spectrum of frequencies.
    """

    AXES = "axes"
    MOUNT = "mount"
    VIEW = "view"
    SPECTRUM = "spectrum"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlatformCandidate(Candidate):
    """An effect at a place. spec : as the effect states it."""

    spec: EffectCandidate

    @property
    def kind(self) -> type[Effect]:
        """The class of the effect."""
        return self.spec.kind

    @property
    def seen_alone(self) -> bool:
        """Whether it changes only what is seen, and moves nothing."""
        return affects_images_only(self.kind)

    @property
    def reach(self) -> Reach:
        """What it changes."""
        if any(p.role == "frequency" for p in self.kind.parameters):
            return Reach.SPECTRUM
        if not self.seen_alone:
            return Reach.AXES
        whole = [column.entry for column in self.spec.linear] == list(range(6))  # its columns are the six of one motion
        return Reach.MOUNT if self.kind.mount is not Effect.mount and whole else Reach.VIEW

    def effect(self, node: Node, coefficients: Floats) -> Effect:
        """The effect of a node with coefficients (q,) of its linear parameters."""
        return self.spec.effect(node, coefficients)

    def allowed(self, coefficients: Floats) -> Floats:
        """Coefficients (q,) within the bounds; a sinusoid's all together within its amplitude's."""
        if not len(coefficients) or not any(column.name == QUADRATURE for column in self.spec.linear):
            return Candidate.allowed(self, coefficients)
        amplitude = next(p for p in self.kind.parameters_at(self.place) if p.role == "linear")
        high, size = amplitude.bounds[1], abs(float(getattr(self.effect({}, coefficients), amplitude.name)))
        return coefficients * ((1 - ROUNDED) * high / size if size > high else 1.0)

    def numbers(self, node: Node, coefficients: Floats) -> dict[str, float]:
        """{name: value} of what `usual` speaks of."""
        effect = self.effect(node, coefficients)
        return {u.name: getattr(effect, u.name) for u in self.usual or ()}


PlatformScore = Score[PlatformCandidate]


def affects_images_only(kind: type[Effect] | Effect) -> bool:
    """Whether an effect affects the images only, and moves nothing."""
    return kind.stage in ("targets", "view")


def platform_candidates(
    point: OperatingPoint, requested_effects: RequestedEffects
) -> tuple[list[PlatformCandidate], list[NotAsked]]:
    """Platform candidates of the requested effects.

    At an OperatingPoint; also what the recording cannot test.
    """
    context = effect_context(point)

    def sites_of(kind: type[Effect]) -> EffectSites:
        sites = kind.sites(context)
        if not kind.discrete:
            return EffectSites(sites, sites)
        ids = dict.fromkeys(point.observed.markers.id)  # a face that nobody saw may have been exchanged as well
        return EffectSites(tuple(str(Place("marker", str(number))) for number in ids), ())

    return requested_effects.candidates(
        sites_of, lambda kind, place: [platform_candidate(spec) for spec in kind.candidates(place, context)]
    )


def effect_context(point: OperatingPoint) -> Context:
    """The effects' Context of an OperatingPoint."""
    k, seen = point, {}
    if k.seen is not None:
        rows, markers = np.unique(k.observed.observations.marker), k.observed.markers
        targets = {markers.target[m] for m in rows}
        seen = {
            "cameras": tuple(k.design.cameras[i].name for i in np.unique(k.observed.observations.camera)),
            "markers": tuple(dict.fromkeys(markers.id[rows].tolist())),
            "targets": tuple(t.name for t in k.stated.targets if t.name in targets and t.turned is None),
        }
    return Context(
        k.stated,
        k.t,
        k.sensors,
        k.motion(()) if k.axes else None,
        moving=tuple(k.design.cameras[i].name for i in k.moving),
        **seen,
    )


def lacks_temperature_log(point: OperatingPoint, needed_channels: tuple[tuple[str, ...], ...]) -> bool:
    """Whether the recording lacks a temperature log that an effect needs, each served by any of several channels."""
    logged = set(point.sensors.channels) if point.sensors is not None else set()
    return not all(logged & set(channels) for channels in needed_channels)


def platform_candidate(spec: EffectCandidate) -> PlatformCandidate:
    """PlatformCandidate of what an effect states (spec), with the usual ranges of its parameters."""
    node, parameters = spec.grid[0], spec.kind.parameters_at(spec.place)
    named = {column.name for column in spec.linear} | set(node)
    usual = tuple(
        UsualRange(p.name, *p.usual, p.signed, Role(p.role))
        for p in parameters
        if p.size == 1 and p.name in named and p.role in SIZED
    )
    return PlatformCandidate(
        name=spec.kind.name,
        place=spec.place,
        grid=spec.grid,
        label=spec.label,
        extra=spec.extra,
        tied=spec.tied,
        usual=usual,
        searched=any(p.role in SEARCHED and p.name in node for p in parameters),
        bounds=coefficient_bounds(spec),
        vector=any(column.entry is not None for column in spec.linear),
        free_form=COUNT in node and not affects_images_only(spec.kind),
        spec=spec,
    )


def coefficient_bounds(spec: EffectCandidate) -> tuple[Floats, Floats]:
    """Bounds (low (q,), high (q,)) of the linear coefficients, from the parameters' bounds."""
    by, ends = {p.name: p for p in spec.kind.parameters_at(spec.place)}, []
    for column in spec.linear:
        if any(c.name == QUADRATURE for c in spec.linear):
            ends.append((-np.inf, np.inf))
        elif by[column.name].role == "inverse":
            low, high = by[column.name].bounds
            ends.append((1 / high if high else np.inf, 1 / low if low > 0 else np.inf))
        else:
            ends.append(by[column.name].bounds)
    both = np.array(ends, float).reshape(-1, 2)
    return both[:, 0], both[:, 1]
