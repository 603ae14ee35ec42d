"""Parsing of effects from text.

As backlash:strut3:gap=40e-6; it is checked that their name and place exist.
"""

import re
from collections.abc import Mapping
from dataclasses import replace

from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import check_effect_place_and_parameter_bounds
from rig.errors import RigError
from rig.formats.checked_entries import NAME, nearest_known_word
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.number_parsing_and_rounding import parse_number
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.effect_places_and_part_tolerances import AXES, Place, parse_stage_place

Kinds = Mapping[str, type[Effect]]  # effects by their names


def parse_effect(text: str, known_effects: Kinds = BY_NAME) -> Effect:
    """Effect parsed from the text NAME:PLACE:PARAMETER=VALUE,.. ; a vector's numbers are separated by slashes.

    The place may leave out its kind where there is no doubt ("strut3", "3", "cam1", "P2"), or stand alone ("rig",
    "cameras").
    Raises RigError naming what is not known.
    """
    name, _, rest = text.partition(":")
    kind = named_effect(name, text, known_effects)
    place, _, assignments = rest.partition(":")
    values = {}
    own = {parameter.name: parameter for parameter in kind.parameters}
    for assignment in filter(None, assignments.split(",")):
        key, equals, value = assignment.partition("=")
        key = key.strip()
        if not equals or key not in own:
            raise RigError(
                f"effect {short_repr(text)}: {short_repr(assignment)} is no PARAMETER=VALUE; {name} has "
                f"{', '.join(own)}"
            )
        try:
            numbers = tuple(parse_number(part) for part in value.split("/"))
        except ValueError:
            raise RigError(f"effect {short_repr(text)}: {short_repr(value)} is no number") from None
        values[key] = numbers if own[key].size != 1 else numbers[0]
        if own[key].size == 1 and len(numbers) > 1:
            raise RigError(f"effect {short_repr(text)}: {key} is one number, got {short_repr(value)}")
    try:
        return check_effect_place_and_parameter_bounds(kind(_place(place.strip(), kind), **values))
    except (TypeError, ValueError) as error:
        raise RigError(f"effect {short_repr(text)}: {error}") from None


def _place(text: str, kind: type[Effect]) -> str:
    kinds = [*kind.places, *(AXES if "axis" in kind.places else ())]
    if text in kinds or any(re.fullmatch(rf"{place} \S+", text) for place in kinds):
        return text
    of_stage = parse_stage_place(text, kind.places)
    if of_stage is not None:
        return str(of_stage)
    for place in (*AXES, "camera", "marker", "target"):
        if place in kinds:
            rest = re.fullmatch(rf"(?:{place})?[ _]?({'[0-9]+' if place in (*AXES, 'marker') else NAME.pattern})", text)
            if rest:
                return str(Place(place, rest.group(1)))
    if not text and len(kind.places) == 1 and kind.places[0] in ("rig", "clock", "cameras", "markers"):
        return kind.places[0]
    return text


def named_effect(name: str, text: str, known: Kinds) -> type[Effect]:
    """Class of the effect of a name, of known ones.

    text : for the message.
    Raises RigError for an unknown name.
    """
    if name not in known:
        near = nearest_known_word(name, known)
        every = f"there are {', '.join(known)}; user-defined ones are in files named by --effects"
        told = f"is {near!r} meant? `rig effects` lists them" if near else every
        raise RigError(f"effect {short_repr(text)}: there is no effect {short_repr(name)}; {told}")
    return known[name]


def require_nonzero_effect(effect: Effect) -> Effect:
    """Require that an effect is nonzero, and return it.

    Raises RigError where its parameters amount to no effect.
    """
    if effect.parameters and effect == type(effect)(effect.place):
        p = effect.parameters_at(effect.place)[0]
        usual = (
            f", from {p.usual[0]:g} to {p.usual[1]:g}{f' {p.unit}' if p.unit else ''} where rigs show it"
            if p.role != "choice"
            else ""
        )
        raise RigError(
            f"effect {effect.name} at {effect.place} has no size and would change nothing: write "
            f"{effect.name}:{effect.place.replace(' ', '')}:{p.name}=..{usual}"
        )
    return effect


def require_known_effect(text: str, design: Design, known_effects: Kinds = BY_NAME) -> str:
    """Require that a text "EFFECT" or "EFFECT PLACE" names a known effect and place.

    Raises RigError otherwise.
    """
    name, _, place = text.partition(" ")
    kind = named_effect(name, name, known_effects)
    if not place:
        return text
    try:
        require_existing_place(check_effect_place_and_parameter_bounds(kind(place)), design)
    except ValueError as error:
        raise RigError(f"{short_repr(text)}: {error}") from None
    return text


def parse_effect_and_place(text: str, design: Design, known_effects: Kinds = BY_NAME) -> tuple[str, str]:
    """Parse an effect and its place from "EFFECT PLACE", of known effects.

    Raises RigError otherwise.
    """
    name, _, place = text.partition(" ")
    kind = named_effect(name, text, known_effects)
    if kind.discrete:
        raise RigError(
            f"{short_repr(text)}: a {name} is searched for first and cannot be assumed; state it in rig.toml"
        )
    try:
        effect = require_existing_place(
            check_effect_place_and_parameter_bounds(kind(_place(place.strip(), kind))), design
        )
    except ValueError as error:
        raise RigError(f"{short_repr(text)}: {error}") from None
    return effect.name, effect.place


def require_existing_place(effect: Effect, design: Design) -> Effect:
    """Require that an effect's place exists in the design, and return the effect.

    Raises RigError otherwise.
    """
    site, places = effect.site, mechanisms.axis_places(design.mechanism)
    kind, name = site.kind, site.name
    slide = replace(site, kind="slide")
    if kind == "joint" and slide in places:
        try:
            return check_effect_place_and_parameter_bounds(replace(effect, place=str(slide)))
        except ValueError as error:
            raise RigError(str(error)) from None
    if kind in AXES and design.mechanism.bodies and site not in places:
        names = mechanisms.axis_place_texts(design.mechanism)
        near = nearest_known_word(effect.place, names)
        raise RigError(
            f"{effect.name} at {effect.place}: this rig has no such axis"
            + (f"; is {near!r} meant?" if near else "")
            + f"; it has {', '.join(names)}"
        )
    there = {
        **{word: [axis.name for axis in places if axis.kind == word] for word in AXES},
        "camera": [c.name for c in design.cameras],
        "target": [t.name for t in design.targets],
        "marker": [str(i) for t in design.targets for i in t.ids],
    }
    asked = [(kind, name)] if name and kind in there else []
    other = getattr(effect, "other", -1.0) if effect.discrete else -1.0
    if other >= 0:
        asked.append(("marker", f"{other:g}"))
    for what, one in asked:
        if one not in there[what]:
            near = nearest_known_word(one, there[what])
            raise RigError(
                f"{effect.name} at {effect.place}: this rig has no {what} {short_repr(one)}"
                + (f"; is {near!r} meant?" if near else "")
                + f"; it has {', '.join(there[what]) or 'none'}"
            )
    return effect
