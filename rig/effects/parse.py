"""Effects as text: backlash:strut3:gap=40e-6 on a command line, a dict in a truth file."""

import difflib
import re

import numpy as np

from rig.effects import BY_NAME
from rig.effects.base import AXES, Effect, check
from rig.errors import RigError


def parse(text: str) -> Effect:
    """An effect from NAME:PLACE:PARAMETER=VALUE,.. ; a vector's numbers are parted by slashes.

    The place may leave out its kind where there is no doubt ("strut3", "3", "cam1", "P2"), or stand alone ("rig", "cameras").
    Raises RigError naming what is not known.
    """
    name, _, rest = text.partition(":")
    if name not in BY_NAME:
        near = difflib.get_close_matches(name, BY_NAME, n=1)
        raise RigError(f"effect {text!r}: there is no effect {name!r}{f'; is {near[0]!r} meant?' if near else ''}; there are {', '.join(BY_NAME)}")
    kind = BY_NAME[name]
    place, _, assignments = rest.partition(":")
    values = {}
    known = {parameter.name: parameter for parameter in kind.parameters}
    for assignment in filter(None, assignments.split(",")):
        key, equals, value = assignment.partition("=")
        key = key.strip()
        if not equals or key not in known:
            raise RigError(f"effect {text!r}: {assignment!r} is no PARAMETER=VALUE; {name} has {', '.join(known)}")
        try:
            numbers = tuple(float(part) for part in value.split("/"))
        except ValueError:
            raise RigError(f"effect {text!r}: {value!r} is no number") from None
        values[key] = numbers if known[key].size != 1 else numbers[0]
        if known[key].size == 1 and len(numbers) > 1:
            raise RigError(f"effect {text!r}: {key} is one number, got {value!r}")
    try:
        return check(kind(_place(place.strip(), kind), **values))
    except (TypeError, ValueError) as error:
        raise RigError(f"effect {text!r}: {error}") from None


def _place(text: str, kind: type[Effect]) -> str:
    kinds = [*kind.places, *(AXES if "axis" in kind.places else ())]
    if text in kinds or any(re.fullmatch(rf"{place} \S+", text) for place in kinds):
        return text
    for place in ("strut", "joint", "camera", "marker", "target"):
        if place in kinds:
            rest = re.fullmatch(rf"(?:{place})?[ _]?(\S+)", text)
            if rest and (place in ("camera", "target") or rest.group(1).isdigit()):
                return f"{place} {rest.group(1)}"
    if not text and len(kind.places) == 1 and kind.places[0] in ("rig", "clock", "cameras", "markers"):
        return kind.places[0]
    return text


def to_dict(effect: Effect) -> dict:
    """{"effect", "place", "parameters"} of an effect, as truth files and diagnoses write it."""
    return {"effect": effect.name, "place": effect.place,
            "parameters": {key: list(value) if isinstance(value, tuple) else value for key, value in effect.values().items()
                           if isinstance(value, tuple) or np.isfinite(value)}}  # what is infinite is its default


def from_dict(tree: dict) -> Effect:
    """The effect of such a dict. Raises RigError for one that is none."""
    try:
        values = {key: tuple(value) if isinstance(value, list) else value for key, value in tree["parameters"].items()}
        return check(BY_NAME[tree["effect"]](tree["place"], **values))
    except (KeyError, TypeError, ValueError) as error:
        raise RigError(f"{tree!r} is no effect: {error!r}") from None
