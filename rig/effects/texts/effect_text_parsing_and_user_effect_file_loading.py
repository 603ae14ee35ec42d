"""Effect texts parsed, and user's effect files loaded.

Of a text such as backlash:strut3:gap=40e-6 it is checked that name and place exist. Python files are checked, run, and
added to the catalogue. Such a file is a program, to be trusted as one. What is wrong with it, when it is read or while
its model is computed, is reported with file and line.
"""

import inspect
import keyword
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from rig.effects.catalogue.effect_list import BY_NAME, STAGES, Plugin
from rig.effects.framework.effect_base_class import MOTION_STAGES, Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters
from rig.effects.framework.parameters_covariates_and_marker_table import Context, Parameter
from rig.errors import FileError, RigError
from rig.formats.checked_toml_and_json_entries import NAME, nearest_known_word
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.numbers_and_units import parse_quantity
from rig.formats.user_python_file_reading_and_running import (
    UserModule,
    line_in_file_of_error,
    line_of_class,
    read_user_text_and_sha256,
    run_user_text_as_module,
)
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import AXES, Place, parse_place_in_stage
from rig.model.design import Design

Kinds = Mapping[str, type[Effect]]  # effects by their names


def parse_effect(text: str, known_effects: Kinds = BY_NAME) -> Effect:
    """Parse an effect from its text.

    The text is NAME:PLACE:PARAMETER=VALUE,.. ; a vector's numbers are separated by slashes.
    Lengths and angles may have a unit, as gap=80um.

    The place may leave out its kind where there is no doubt ("strut3", "3", "cam1", "P2"), or stand alone ("rig",
    "cameras").
    Raises RigError naming what is not known.
    """
    name, _, rest = text.partition(":")
    kind = effect_class_by_name(name, text, known_effects)
    place, _, assignments = rest.partition(":")
    values, place = {}, _place(place.strip(), kind)
    try:
        own = {parameter.name: parameter for parameter in kind.parameters_at(place)}
    except ValueError as error:
        raise RigError(f"effect {short_repr(text)}: {error}") from None
    for assignment in filter(None, assignments.split(",")):
        key, equals, value = assignment.partition("=")
        key = key.strip()
        if not equals or key not in own:
            raise RigError(
                f"effect {short_repr(text)}: {short_repr(assignment)} is no PARAMETER=VALUE; {name} has "
                f"{', '.join(own)}"
            )
        try:
            numbers = tuple(parse_quantity(part, own[key].unit.split(" (")[0]) for part in value.split("/"))
        except ValueError:
            message = f"{short_repr(value)} is no number, and no quantity in {own[key].unit or 'no unit'}"
            raise RigError(f"effect {short_repr(text)}: {message}") from None
        values[key] = numbers if own[key].size != 1 else numbers[0]
        if own[key].size == 1 and len(numbers) > 1:
            raise RigError(f"effect {short_repr(text)}: {key} is one number, got {short_repr(value)}")
    try:
        return effect_with_valid_place_and_parameters(kind(place, **values))
    except (TypeError, ValueError) as error:
        raise RigError(f"effect {short_repr(text)}: {error}") from None


def _place(text: str, kind: type[Effect]) -> str:
    kinds = [*kind.places, *(AXES if "axis" in kind.places else ())]
    if text in kinds or any(re.fullmatch(rf"{place} \S+", text) for place in kinds):
        return text
    of_stage = parse_place_in_stage(text, kind.places)
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


def effect_class_by_name(name: str, text: str, known: Kinds) -> type[Effect]:
    """Class of the effect of a name, of known ones.

    text : for the message.
    Raises RigError for an unknown name.
    """
    if name not in known:
        near = nearest_known_word(name, known)
        every = f"there are {', '.join(known)}; user-defined ones are in files named by --effects"
        hint = f"is {near!r} meant? `rig effects` lists them" if near else every
        raise RigError(f"effect {short_repr(text)}: there is no effect {short_repr(name)}; {hint}")
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
    kind = effect_class_by_name(name, name, known_effects)
    if not place:
        return text
    try:
        effect_with_existing_place(effect_with_valid_place_and_parameters(kind(place)), design)
    except ValueError as error:
        raise RigError(f"{short_repr(text)}: {error}") from None
    return text


def parse_effect_and_place(text: str, design: Design, known_effects: Kinds = BY_NAME) -> tuple[str, str]:
    """Parse an effect and its place from "EFFECT PLACE", of known effects.

    Raises RigError otherwise.
    """
    name, _, place = text.partition(" ")
    kind = effect_class_by_name(name, text, known_effects)
    if kind.discrete:
        raise RigError(
            f"{short_repr(text)}: a {name} is searched for first and cannot be assumed; state it in rig.toml"
        )
    try:
        effect = effect_with_existing_place(
            effect_with_valid_place_and_parameters(kind(_place(place.strip(), kind))), design
        )
    except ValueError as error:
        raise RigError(f"{short_repr(text)}: {error}") from None
    return effect.name, effect.place


def effect_with_existing_place(effect: Effect, design: Design) -> Effect:
    """Require that an effect's place exists in the design, and return the effect.

    Raises RigError otherwise.
    """
    site, places = effect.site, mechanisms.axis_places(design.mechanism)
    kind, name = site.kind, site.name
    slide = replace(site, kind="slide")
    if kind == "joint" and slide in places:
        try:
            return effect_with_valid_place_and_parameters(replace(effect, place=str(slide)))
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
    existing = {
        **{word: [axis.name for axis in places if axis.kind == word] for word in AXES},
        "camera": [c.name for c in design.cameras],
        "target": [t.name for t in design.targets],
        "marker": [str(i) for t in design.targets for i in t.ids],
    }
    requested = [(kind, name)] if name and kind in existing else []
    other = getattr(effect, "other", -1.0) if effect.discrete else -1.0
    if other >= 0:
        requested.append(("marker", f"{other:g}"))
    for what, one in requested:
        if one not in existing[what]:
            near = nearest_known_word(one, existing[what])
            raise RigError(
                f"{effect.name} at {effect.place}: this rig has no {what} {short_repr(one)}"
                + (f"; is {near!r} meant?" if near else "")
                + f"; it has {', '.join(existing[what]) or 'none'}"
            )
    return effect


KINDS = ("axis", *AXES, "rig", "clock", "camera", "cameras", "marker", "markers", "target")  # of place
ROLES = ("linear", "inverse", "size", "phase", "log", "even", "moment", "direction", "form", "choice")  # of a parameter
ARRAYS = ("times", "deviation", "sway", "mount", "focal", "late")  # hooks whose answer has a shape
HOOKS = (*ARRAYS, "needs", "follow", "attach", "camera", "bend", "print_", "covariate")
RESERVED = frozenset(name for name in dir(Effect) if not name.startswith("__"))  # names that no parameter may have
EXAMPLE = {
    "axis": "strut 1",
    "strut": "strut 1",
    "joint": "joint 1",
    "slide": "slide 1",
    "camera": "camera one",
    "marker": "marker 1",
    "target": "target one",
}
T = TypeVar("T", bound=ArrayLike)


def load_effect_file(path: Path) -> Plugin:
    """Load a user's effect file as a Plugin.

    Raises FileError, with the line, where it cannot be read, run or used.
    """
    text, digest = read_user_text_and_sha256(path)
    return Plugin(path, digest, effect_classes_of_source_text(text, path))


def effect_classes_of_source_text(text: str, path: Path) -> tuple[type[Effect], ...]:
    """Effect classes defined by a source text.

    path : its name in errors.
    Raises FileError.
    """
    found: list[type[Effect]] = UserModule(path, text, "", run_user_text_as_module(text, path)).classes(Effect)
    if not found:
        raise FileError(path, "defines no effect: a dataclass derived from rig.effects.base.Effect")
    for kind in found:
        reserved = next((name for name in _field_names(kind) if name in RESERVED), None)
        if reserved is not None:
            raise FileError(
                path,
                f"{kind.__name__} has a parameter {reserved!r}, which every effect has as a hook or an attribute: "
                "take another name",
                line_of_class(text, kind.__name__, reserved),
            )
        problem = _problem(kind)
        if problem:
            raise FileError(path, f"{kind.__name__} {problem}", line_of_class(text, kind.__name__))
    for kind in found:
        _guard(kind, path, line_of_class(text, kind.__name__))
    return tuple(found)


def effect_name_problem(name: str) -> str | None:
    """Problem with the name of an effect, in words.

    None for a valid name.
    """
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower() or name.startswith("_"):
        return f"takes a name of small letters, digits and underscores, not {name!r}"
    return f"collides with the catalogue's {name}: choose another name" if name in BY_NAME else None


def _field_names(kind: type[Effect]) -> tuple[str, ...]:
    """Names of a class' fields; none of one that is no dataclass."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else ()


def _problem(kind: type[Effect]) -> str | None:
    """What is wrong with a class, in words that follow its name; None where nothing is."""
    if not is_dataclass(kind) or not kind.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        return "must be a frozen dataclass: @dataclass(frozen=True, slots=True)"
    if effect_name_problem(kind.name):
        return effect_name_problem(kind.name)
    if kind.stage not in STAGES:
        return f"has the stage {kind.stage!r}; there are {', '.join(STAGES)}"
    if not isinstance(kind.places, tuple) or not kind.places or set(kind.places) - set(KINDS):
        return f"sits at {kind.places!r}; places are a tuple of {', '.join(KINDS)}"
    if (kind.__doc__ or "").startswith(f"{kind.__name__}("):
        return "has no docstring, which describes its model"
    for name in ("experiment", "action"):
        if not getattr(kind, name):
            return f"says nothing of its {name}"
    if not any(name in vars(kind) for name in HOOKS if name not in ("needs", "covariate")):
        return f"does nothing: it has none of {', '.join(n for n in HOOKS if n not in ('needs', 'covariate'))}"
    return _parameters_problem(kind) or _default_problem(kind)


def _parameters_problem(kind: type[Effect]) -> str | None:
    own = [f for f in fields(kind) if f.name != "place"]
    if (
        not isinstance(kind.parameters, tuple)
        or not kind.parameters
        or not all(isinstance(p, Parameter) for p in kind.parameters)
    ):
        return "must list its parameters, a tuple of Parameter"
    if [f.name for f in own] != [p.name for p in kind.parameters] or fields(kind)[0].name != "place":
        return (
            f"has the fields {', '.join(f.name for f in fields(kind))}; they are place and its parameters in "
            "their order, "
            f"{', '.join(p.name for p in kind.parameters)}"
        )
    for f, p in zip(own, kind.parameters):
        if f.default is MISSING:
            return f"gives {p.name} no default, with which it changes nothing"
        if p.role not in ROLES:
            return f"has {p.name} in the role {p.role!r}; there are {', '.join(ROLES)}"
        if not p.bounds[0] < p.bounds[1]:
            return f"has {p.name} within {p.bounds}, the smaller first"
        if p.role not in ("choice", "moment", "phase") and not 0 < max(map(abs, p.usual)) < np.inf:
            return f"must state how large {p.name} usually is, two numbers, not {p.usual}"
        if p.role in ("log", "size") and not p.usual[0] > 0:
            return f"has {p.name} on a scale of logarithms, where what is usual is above 0, not {p.usual}"
    return None


def _default_problem(kind: type[Effect]) -> str | None:
    for place in kind.places:
        try:
            effect_with_valid_place_and_parameters(kind(EXAMPLE.get(place, place)))
        except Exception as error:
            return f"cannot be made with its defaults at {place}: {error}"
    return None


def _guard(kind: type[Effect], path: Path, line: int | None) -> None:
    """Have a class name its file and line where a hook of its own fails, or answers what nobody asked for."""
    for name in HOOKS:
        if name in vars(kind):
            setattr(kind, name, _guarded(vars(kind)[name], name, path))
    sites = inspect.getattr_static(kind, "sites").__func__

    def lawful(cls: type[Effect], context: Context) -> tuple[str, ...]:
        found = sites(cls, context)
        if found and cls.stage in MOTION_STAGES:
            motion, zero = context.moved(), cls(found[0])
            if zero.deviation(motion).any() or zero.sway(motion).any():
                raise FileError(
                    path,
                    f"{cls.name} changes something with its parameters at their defaults, where it must change nothing",
                    line,
                )
        return found

    setattr(kind, "sites", classmethod(lawful))  # noqa: B010  of a class, which is not to be assigned to


def _guarded(hook: Callable[..., T], name: str, path: Path) -> Callable[..., T]:
    @wraps(hook)
    def guarded(effect: Effect, *given: object) -> T:
        try:
            found = hook(effect, *given)
        except RigError:
            raise
        except Exception as error:
            raise FileError(
                path, f"{effect.name}.{name} fails: {type(error).__name__}: {error}", line_in_file_of_error(error, path)
            ) from None
        if name in ARRAYS:
            expected = np.shape(getattr(Effect, name)(effect, *given))
            if np.shape(found) != expected or not np.isfinite(found).all():
                message = f"numbers of shape {np.shape(found)}" if np.shape(found) != expected else "no finite number"
                raise FileError(
                    path,
                    f"{effect.name}.{name} answers {message}; it must return finite numbers of shape {expected}",
                    hook.__code__.co_firstlineno,
                )
        return found

    return guarded
