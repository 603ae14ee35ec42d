"""Loading of a user's effect files.

Python files are checked, run, and added to the catalogue.

The file is run: it is a program, to be trusted as one. What is wrong with it, when it is read or while its model is
computed, is reported with file and line.
"""

import inspect
import keyword
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from rig.effects.catalogue.effect_list import BY_NAME, STAGES, Plugin
from rig.effects.framework.effect import MOTION_STAGES, Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import check_effect_place_and_parameter_bounds
from rig.effects.framework.effect_parameters_and_covariates import Context, Parameter
from rig.errors import FileError, RigError
from rig.formats.user_python_file import UserModule, line_of_class, line_within, read_user_text, run_user_text
from rig.model.effect_places_and_part_tolerances import AXES

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
    text, digest = read_user_text(path)
    return Plugin(path, digest, effects_of_source(text, path))


def effects_of_source(text: str, path: Path) -> tuple[type[Effect], ...]:
    """Effect classes defined by a source text.

    path : its name in errors.
    Raises FileError.
    """
    found: list[type[Effect]] = UserModule(path, text, "", run_user_text(text, path)).classes(Effect)
    if not found:
        raise FileError(path, "defines no effect: a dataclass derived from rig.effects.base.Effect")
    for kind in found:
        taken = next((name for name in _field_names(kind) if name in RESERVED), None)
        if taken is not None:
            raise FileError(
                path,
                f"{kind.__name__} has a parameter {taken!r}, which every effect has as a hook or an attribute: "
                "take another name",
                line_of_class(text, kind.__name__, taken),
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
            check_effect_place_and_parameter_bounds(kind(EXAMPLE.get(place, place)))
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
                path, f"{effect.name}.{name} fails: {type(error).__name__}: {error}", line_within(error, path)
            ) from None
        if name in ARRAYS:
            expected = np.shape(getattr(Effect, name)(effect, *given))
            if np.shape(found) != expected or not np.isfinite(found).all():
                said = f"numbers of shape {np.shape(found)}" if np.shape(found) != expected else "no finite number"
                raise FileError(
                    path,
                    f"{effect.name}.{name} answers {said}; it must return finite numbers of shape {expected}",
                    hook.__code__.co_firstlineno,
                )
        return found

    return guarded
