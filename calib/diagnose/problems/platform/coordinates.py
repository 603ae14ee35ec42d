"""The continuous parameters of admitted effects as a fit sees them: in which measure, within which bounds, with which priors and directions."""

from dataclasses import dataclass, replace

import numpy as np

from calib.diagnose.engine.linear import Column, joined
from calib.diagnose.problems.platform.candidates import seen_alone
from calib.diagnose.problems.platform.linearised import LinearisedModel
from calib.diagnose.problems.platform.sensitivities import Sensitivities
from rig.effects.base import COUNT, Effect, Linear, Parameter

LOOSE = 3.0  # times the greatest usual size: what a number of a vector may be before anything is measured
SWALLOWED = 0.15  # the same for a lens, whose terms and warps a camera's pose and stated lens take up almost whole


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One continuous parameter of one admitted effect: index of a vector or None; role as the parameter's; bounds : of the parameter
    step : of the coordinate, for derivatives; loose : 1 / standard deviation that it is given beforehand"""

    effect: int
    name: str
    index: int | None
    role: str
    step: float
    bounds: tuple[float, float]
    loose: float

    def read(self, effect: Effect) -> float:
        """The coordinate's value: the parameter, its reciprocal or its logarithm."""
        value = getattr(effect, self.name)
        value = value if self.index is None else value[self.index]
        return self._measured(value)

    def _measured(self, value: float) -> float:
        if self.role == "inverse":
            return 1 / value if value else np.inf
        return (np.log(value) if value > 0 else -np.inf) if self.role == "log" else value

    def parameter(self, value: float) -> float:
        """The parameter's value of the coordinate's."""
        if self.role == "inverse":
            return 1 / value if value else np.inf
        return np.exp(value) if self.role == "log" else value

    @property
    def ends(self) -> tuple[float, float]:
        """The coordinate's bounds."""
        low, high = (self._measured(end) for end in self.bounds)
        return (low, high) if self.role != "inverse" else (high, low)

    def written(self, effect: Effect, value: float) -> Effect:
        """The effect with the coordinate at a value within its bounds; what rounding takes over them is taken back."""
        number = float(np.clip(self.parameter(value), *self.bounds))
        if self.index is None:
            return replace(effect, **{self.name: number})
        vector = list(getattr(effect, self.name))
        vector[self.index] = number
        return replace(effect, **{self.name: tuple(vector)})

    def at_bound(self, effect: Effect) -> float | None:
        """The bound that the parameter of an effect stands at, or None."""
        value = getattr(effect, self.name)
        value = value if self.index is None else value[self.index]
        return next((end for end in self.bounds if value == end), None)


def coordinates_of(effects: tuple[Effect, ...]) -> list[Coordinate]:
    """[Coordinate] of what a fit may move of effects, in order."""
    return [Coordinate(number, p.name, index, p.role, _step(p), p.bounds, loose(p, index))
            for number, effect in enumerate(effects) for p in effect.parameters_at(effect.place) for index in effect.fitted(p)]


def kept_sums(coordinates: list[Coordinate], effects: tuple[Effect, ...]) -> np.ndarray:
    """(k, c) sums of coordinates that effects ask to be kept."""
    rows = [[row.get((c.name, c.index), 0.0) * (c.effect == number) for c in coordinates]
            for number, effect in enumerate(effects) for row in effect.kept()]
    rows = [row for row in rows if any(row)]
    return np.array(rows).reshape(len(rows), len(coordinates))


def _step(p: Parameter) -> float:
    size = np.sqrt(p.usual[0] * p.usual[1]) if p.usual[0] > 0 else 0.1
    return {"inverse": 1e-3 / size, "log": 1e-3, "size": 1e-2 * size, "phase": 1e-3, "even": 1e-5, "frequency": 1e-8}.get(p.role, 1e-2 * size)


def loose(p: Parameter, index: int | None) -> float:
    """1 / standard deviation that a parameter is given beforehand: vectors have directions that nothing sees, a number alone is free."""
    if index is None or p.role == "direction":
        return 0.0
    return 1 / ((SWALLOWED if p.name in ("terms", "warp") else LOOSE) * p.usual[1])


def priors_cost(effects: tuple[Effect, ...]) -> float:
    """What the priors on vectors cost."""
    return float(sum(np.sum((np.asarray(getattr(e, p.name)) * loose(p, 0)) ** 2) for e in effects for p in e.parameters
                     if p.role == "linear" and isinstance(getattr(e, p.name), tuple) and len(getattr(e, p.name))))


def tangents(model: LinearisedModel, sensitivities: Sensitivities) -> tuple[list[Coordinate], Column | None]:
    """(coordinates, Column of their directions) of the admitted effects at a linearisation."""
    k, parts = model.point, []
    sensitivities, coordinates = sensitivities.at(k), coordinates_of(k.effects)
    for number, effect in enumerate(k.effects):
        own = [c for c in coordinates if c.effect == number]
        if seen_alone(effect) and type(effect).mount is Effect.mount and own and all(c.role == "linear" for c in own):
            pixels = [sensitivities.corners(*_still(effect, c, sensitivities)) for c in own]
            parts.append(model.fold(np.concatenate(pixels, axis=2)))
            continue
        for c in own:
            ends = _ends(c, effect)
            both = [k.effects[:number] + (c.written(effect, end),) + k.effects[number + 1 :] for end in ends]
            apart = ends[0] - ends[1]
            if seen_alone(effect):
                parts.append(model.fold(((k.pixels(both[0]) - k.pixels(both[1])) / apart)[..., None]))
            else:
                parts.append(model.lengthened(((k.effective(both[0]) - k.effective(both[1])) / apart)[..., None]))
    return coordinates, joined(parts) if parts else None


def _ends(c: Coordinate, effect: Effect) -> tuple[float, float]:
    """A coordinate's values a step to either side, or up to its bounds, between which a difference tells the derivative."""
    value, (low, high) = c.read(effect), c.ends
    return min(value + c.step, high), max(value - c.step, low)


def _still(effect: Effect, c: Coordinate, sensitivities: Sensitivities) -> tuple[np.ndarray, np.ndarray]:
    """(sightings, (s, 4, 2, 1) px per unit) of a linear parameter of a view effect that is the same in every frame."""
    node = {p.name: getattr(effect, p.name) for p in effect.parameters if p.role != "linear"}
    if c.index is not None:
        node[COUNT] = len(getattr(effect, c.name))
    rows, quads = sensitivities.derivative(type(effect), effect.place, Linear(c.name, c.index, c.step), node)
    return rows, quads[..., None]
