"""Checks of an effect, and its fit coordinates.

Checks are of place and parameters; in the coordinates a fit changes its parameters.
"""

import re
from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import LINEAR, Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Parameter
from rig.formats.checked_toml_and_json_entries import NAME
from rig.formats.local_and_remote_input_files import short_repr
from rig.model.arm_hands_effect_places_and_tolerances import AXES, NUMBER, Place

MOST = 1000  # numbers of a parameter of any length


def effect_with_valid_place_and_parameters(effect: Effect) -> Effect:
    """Check that an effect's place and parameters are permitted, and return it.

    Raises ValueError for a place where it cannot be or a parameter out of bounds.
    """
    place = Place.parse(effect.place)
    kind = place.kind
    if kind not in effect.places and not ("axis" in effect.places and kind in AXES):
        raise ValueError(f"{effect.name} cannot sit at {effect.place!r}; it takes {', '.join(effect.places)}")
    name = {**dict.fromkeys(AXES, NUMBER), "marker": f"0|{NUMBER}", "camera": NAME.pattern, "target": NAME.pattern}.get(
        kind
    )
    known = str(place) == effect.place and re.fullmatch(name, place.name) if name else kind == effect.place
    if not known:
        raise ValueError(
            f"{effect.name}: which {kind}? write for example '{kind} {'1' if kind in (*AXES, 'marker') else 'name'}'"
        )
    for parameter in effect.parameters_at(effect.place):
        value = np.atleast_1d(np.asarray(getattr(effect, parameter.name), float))
        if value.ndim != 1 or (parameter.size and len(value) != parameter.size) or len(value) > MOST:
            raise ValueError(
                f"{effect.name}: {parameter.name} has {parameter.size or f'at most {MOST}'} numbers, got {value.size}"
            )
        low, high = parameter.bounds
        if not ((value >= low).all() and (value <= high).all()):  # false for what is not a number, too
            raise ValueError(
                f"{effect.name}: {parameter.name} must lie in {low:g} .. {high:g} {parameter.unit}, got "
                f"{short_repr(value.tolist())}"
            )
    problem = effect.problem()
    if problem:
        raise ValueError(f"{effect.name}: {problem}")
    return effect


LOOSE = 3.0  # times the greatest usual size: what a number of a vector may be before anything is measured
SWALLOWED = 0.15  # the same for a lens, whose terms and warps a camera's pose and stated lens take up almost whole


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One continuous parameter of one admitted effect: index of a vector or None; role as the parameter's; bounds : of
    the parameter
    step : of the coordinate, for derivatives; loose : 1 / standard deviation that it is given beforehand"""

    effect: int
    name: str
    index: int | None
    role: str
    step: float
    bounds: tuple[float, float]
    loose: float

    @property
    def is_size(self) -> bool:
        """Whether the effect does nothing where all such coordinates are 0."""
        return self.role in (*LINEAR, "size")

    def read(self, effect: Effect) -> float:
        """The coordinate's value: the parameter, its reciprocal or its logarithm."""
        value = getattr(effect, self.name)
        value = value if self.index is None else value[self.index]
        return self.measured(value)

    def measured(self, value: float) -> float:
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
        low, high = (self.measured(end) for end in self.bounds)
        return (low, high) if self.role != "inverse" else (high, low)

    def written(self, effect: Effect, value: float) -> Effect:
        """The effect with the coordinate at a value within its bounds; rounding beyond them is clipped."""
        number = float(np.clip(self.parameter(value), *self.bounds))
        if self.index is None:
            return _changed(effect, self.name, number)
        vector = list(getattr(effect, self.name))
        vector[self.index] = number
        return _changed(effect, self.name, tuple(vector))

    def around(self, effect: Effect) -> tuple[float, float]:
        """The coordinate's values a step above and below an effect's, or at its bounds, between which a difference
        tells a derivative.
        """
        value, (low, high) = self.read(effect), self.ends
        return min(value + self.step, high), max(value - self.step, low)

    def ends_of(
        self, effects: tuple[Effect, ...], acting: tuple[Effect, ...]
    ) -> tuple[tuple[tuple[Effect, ...], tuple[Effect, ...]], float]:
        """((effects above, below), how far apart) between which a difference tells what the axes do with it, without
        those that only add to it.

        effects : of which it is one of the parameters; acting : those at work, of which clocks and paths matter to the
            others
        """
        own = effects[self.effect]
        others, (high, low) = tuple(e for e in acting if e is not own and e.retimes()), self.around(own)
        return ((*others, self.written(own, high)), (*others, self.written(own, low))), high - low

    def at_bound(self, effect: Effect) -> float | None:
        """The bound that the parameter of an effect is at, or None."""
        value = getattr(effect, self.name)
        value = value if self.index is None else value[self.index]
        return next((end for end in self.bounds if value == end), None)


def _changed(effect: Effect, name: str, value: float | tuple[float, ...]) -> Effect:
    return type(effect)(effect.place, **{**effect.values(), name: value})


def fit_coordinates_of_effects(effects: tuple[Effect, ...]) -> list[Coordinate]:
    """Coordinates ([Coordinate]) of the effects' parameters that a fit may change, in order."""
    return [
        Coordinate(number, p.name, index, p.role, _step(p), p.bounds, inverse_prior_standard_deviation(p, index))
        for number, effect in enumerate(effects)
        for p in effect.parameters_at(effect.place)
        for index in effect.fitted(p)
    ]


def effects_with_coordinates(
    effects: tuple[Effect, ...], coordinates: list[Coordinate], values: Floats
) -> tuple[Effect, ...] | None:
    """The effects with their coordinates at values (c,).

    They are in their written form.
    None where one cannot be so.
    """
    out = list(effects)
    for c, value in zip(coordinates, values.tolist()):
        out[c.effect] = c.written(out[c.effect], value)
    try:
        return tuple(effect_with_valid_place_and_parameters(effect.written()) for effect in out)
    except ValueError:  # a combination of numbers, each within its bounds, that an effect does not allow
        return None


def conserved_coordinate_sums(coordinates: list[Coordinate], effects: tuple[Effect, ...]) -> Floats:
    """Sums of fit coordinates that a fit must conserve, rows (k, c).

    As the effects state them.
    """
    rows = [
        [row.get((c.name, c.index), 0.0) * (c.effect == number) for c in coordinates]
        for number, effect in enumerate(effects)
        for row in effect.conserved_sums()
    ]
    rows = [row for row in rows if any(row)]
    return np.array(rows).reshape(len(rows), len(coordinates))


def _step(p: Parameter) -> float:
    size = np.sqrt(p.usual[0] * p.usual[1]) if p.usual[0] > 0 else 0.1
    return {
        "inverse": 1e-3 / size,
        "log": 1e-3,
        "size": 1e-2 * size,
        "phase": 1e-3,
        "even": 1e-5,
        "frequency": 1e-8,
    }.get(p.role, 1e-2 * size)


def inverse_prior_standard_deviation(parameter: Parameter, index: int | None) -> float:
    """1 / standard deviation of a parameter's prior.

    0 for a scalar or a direction.
    """
    if index is None or parameter.role == "direction":
        return 0.0
    return 1 / ((SWALLOWED if parameter.name in ("terms", "warp") else LOOSE) * parameter.usual[1])


def cost_of_priors(effects: tuple[Effect, ...]) -> float:
    """Cost of the priors on the effects' vector parameters.

    Sum of squares in prior standard deviations.
    """
    return float(
        sum(
            np.sum((np.asarray(getattr(e, p.name)) * inverse_prior_standard_deviation(p, 0)) ** 2)
            for e in effects
            for p in e.parameters
            if p.role in ("linear", "form") and isinstance(getattr(e, p.name), tuple) and len(getattr(e, p.name))
        )
    )
