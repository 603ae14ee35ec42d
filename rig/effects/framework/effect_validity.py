"""Validity of an effect: its place must exist for it, its parameters lie within their bounds."""

import re

import numpy as np

from rig.effects.framework.effect import Effect
from rig.effects.framework.place import AXES, NUMBER, Place
from rig.formats.checked_entries import NAME
from rig.formats.input_files import short_repr

MOST = 1000  # numbers of a parameter of any length


def check_effect(effect: Effect) -> Effect:
    """The effect, checked. Raises ValueError for a place where it cannot be or a parameter out of bounds."""
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
