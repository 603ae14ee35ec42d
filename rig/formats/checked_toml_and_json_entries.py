"""Checked entries of TOML and JSON files, with errors that name file, line, column and key."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn, TypedDict, Unpack, cast, overload

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.errors import FileError
from rig.formats.local_and_remote_input_files import require_schema, short_repr
from rig.formats.numbers_and_units import SI, LengthAndAngleUnits, UnitNames, parse_length_and_angle_units
from rig.model.pose import pose

LARGEST_RIG = 50.0  # m; nothing on struts or arms is larger, so a larger figure is in another unit
LARGEST_NUMBER = 1e100  # beyond it the square of a number is none
LARGEST_TURN = 7.0  # rad, of a rotation vector's components: a full turn is 2 pi
LARGEST_WHOLE = 1 << 53  # to which a float counts
NEAREST = 0.6  # of difflib's ratio, between an unknown key and the known one that is named
SLIPS = 200  # keys among which a slip of one is looked for
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
NAMES = "letters, digits, '_', '-' and '.', at most 64 of them, the first a letter, digit or '_'"
Key = str | int  # of a table, or an index of a list
Shape = tuple[int | None, ...]  # of nested lists; None: any length


class Required:
    """Type of REQUIRED, which stands for a default where there is none."""


REQUIRED = Required()


class Limits(TypedDict, total=False):
    """Limits of a number. least, most : both included; above : not included; unit : SI unit of these and the number"""

    least: float
    most: float
    above: float
    unit: str


def nearest_known_word(word: str, known: Iterable[object], cutoff: float = 0.7) -> str | None:
    """The nearest known word to one that is likely misspelt, or None.
    cutoff : of difflib's ratio, least of what counts as near
    """
    near = difflib.get_close_matches(
        word[:64], [k for k in list(known)[:SLIPS] if isinstance(k, str) and len(k) <= 64], n=1, cutoff=cutoff
    )
    return near[0] if near else None


def rig_part_name_problem(name: str) -> str | None:
    """Problem of a name of a camera, target or channel, as text, or None."""
    if NAME.fullmatch(name):
        return None
    better = re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("._-")[:64]
    return f"{short_repr(name)} cannot be a name: names have {NAMES}" + (f"; {better!r} would do" if better else "")


class LimitsOfEach(Limits, total=False):
    """The same of several numbers. units : SI unit of each where they differ, in place of the unit of all"""

    units: Sequence[str]


class ArrayOptions(TypedDict, total=False):
    """Options of an array. length_limit : m, catches figures in another unit; nulls : whether a null may stand for what
    was not measured, and becomes NaN; unit : SI unit, m where there is a length_limit, or several that broadcast
    """

    length_limit: float | None
    nulls: bool
    unit: UnitNames


@dataclass
class Entries:
    """A table that knows its position. tree : {key: value}, of a list {0: value, ..}; path : keys and indices to it
    places : {path: (line, column)} of the values whose place in the file is known, the path () among them
    units : in which the file states lengths and angles; all methods give SI
    unit_log : where given, gets {path: SI unit} of each figure that the file states and somebody reads"""

    tree: dict[Any, Any]
    path: tuple[str | int, ...]
    file: Path
    places: Mapping[Any, Any]
    units: LengthAndAngleUnits = SI
    unit_log: dict[tuple[Key, ...], UnitNames] | None = None

    def in_stated_units(self) -> Entries:
        """The same, read in what the key `units` states: "mm, deg". Raises FileError for what is no such units."""
        text = self.text("units", default="m, rad")
        try:
            return replace(self, units=parse_length_and_angle_units(text))
        except ValueError as error:
            self.fail(f"{self.name('units')} must be {error}", "units", value=text)

    def fail(self, message: str, *keys: Key, value: object = None) -> NoReturn:
        """Raise FileError at the value under keys, or at the nearest thing above it that has a place."""
        at = self.path + keys
        while at not in self.places:
            at = at[:-1]
        line, column = self.places[at]
        raise FileError(self.file, message, line, column, value)

    def refuse(self, key: Key, expected: str, value: object) -> NoReturn:
        """Raise FileError at a value that is not what it must be. expected : in words"""
        self.fail(f"{self.name(key)} must be {expected}, not {short_repr(value)}", key, value=value)

    def _inner(self, tree: dict[int, object] | dict[str, object], *keys: Key) -> Entries:
        return replace(self, tree=tree, path=self.path + keys)

    def name(self, key: Key) -> str:
        """A key with its path, as in camera.1.width."""
        return ".".join(str(part + 1 if isinstance(part, int) else part) for part in (*self.path, key))

    def get(self, key: Key, default: object = REQUIRED) -> object:
        """A value as TOML has it. Raises FileError where it is missing and no default is given."""
        if key in self.tree:
            return self.tree[key]
        if default is REQUIRED:
            near = nearest_known_word(key, self.tree) if isinstance(key, str) else None
            self.fail(
                f"{self.name(key)} is missing" + (f"; is {near!r} meant?" if near else ""), *([near] if near else [])
            )
        return default

    def table(self, key: Key, optional: bool = False) -> Entries:
        """A table within this one."""
        value = self.get(key, {} if optional else REQUIRED)
        if not isinstance(value, dict):
            self.refuse(key, "a table", value)
        return self._inner(value, key)

    def tables(self, key: Key) -> list[Entries]:
        """The tables of an array of tables."""
        value = self.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.fail(f"{self.name(key)} must be written as [[{key}]] tables", key, value=value)
        return [self._inner(item, key, i) for i, item in enumerate(value)]

    def lists(self, key: Key, length: int) -> list[Entries]:
        """The lists of a list, each of a length, as Entries whose keys are 0, 1, .."""
        value = self.get(key)
        if not isinstance(value, list) or not all(isinstance(item, list) and len(item) == length for item in value):
            self.fail(f"{self.name(key)} must be a list of lists of {length}", key)
        return [self._inner(dict(enumerate(item)), key, i) for i, item in enumerate(value)]

    def wholes(self, key: Key, least: int = 0) -> tuple[int, ...]:
        """Whole numbers of at least `least`, as a tuple."""
        value = self.get(key)
        if not isinstance(value, list):
            self.fail(f"{self.name(key)} must be a list of whole numbers, not {short_repr(value)}", key)
        inner = self._inner(dict(enumerate(value)), key)
        return tuple(inner.whole(i, least) for i in range(len(value)))

    def schema(self, what: str, known: str) -> None:
        """Raise FileError where a whole file's table does not name the schema known. what : the file should be"""
        self.text("schema")
        require_schema(self.file, what, self.tree["schema"], (known,), self.places[(*self.path, "schema")])

    def texts(self, key: Key) -> tuple[str, ...]:
        """Texts, as a tuple."""
        value = self.get(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self.fail(f"{self.name(key)} must be a list of texts, not {short_repr(value)}", key)
        return tuple(value)

    def flag(self, key: Key, default: object = REQUIRED) -> bool:
        """True or false."""
        value = self.get(key, default)
        if not isinstance(value, bool):
            self.refuse(key, "true or false", value)
        return value

    def identifier(self, key: Key) -> str:
        """The name of a camera, a target or the like."""
        value = self.text(key)
        if rig_part_name_problem(value):
            self.fail(f"{self.name(key)}: {rig_part_name_problem(value)}", key, value=value)
        return value

    @overload
    def text(self, key: Key, choices: Collection[str] | None = None, default: str | Required = ...) -> str: ...

    @overload
    def text(self, key: Key, choices: Collection[str] | None = ..., *, default: None) -> str | None: ...

    def text(self, key: Key, choices: Collection[str] | None = None, default: object = REQUIRED) -> object:
        """Text, one of choices where these are given."""
        value = self.get(key, default)
        if value is default and default is not REQUIRED:
            return default
        if not isinstance(value, str) or (not choices and not value):
            self.refuse(key, "text", value)
        if choices and value not in choices:
            self.refuse(key, f"one of {', '.join(map(repr, choices))}", value)
        return value

    def whole(self, key: Key, least: int, default: object = REQUIRED, most: int = LARGEST_WHOLE) -> int:
        """A whole number of at least `least` and at most `most`."""
        value = self.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            limits = f"at least {least}" + (f" and at most {most}" if isinstance(value, int) and value > most else "")
            self.refuse(key, f"a whole number of {limits}", value)
        return value

    @overload
    def number(
        self, key: Key, default: float | Required = ..., *, nulls: bool = False, **limits: Unpack[Limits]
    ) -> float: ...

    @overload
    def number(
        self, key: Key, default: float | Required | None, *, nulls: bool = False, **limits: Unpack[Limits]
    ) -> float | None: ...

    def number(
        self, key: Key, default: object = REQUIRED, *, nulls: bool = False, **limits: Unpack[Limits]
    ) -> float | None:
        """A finite number within limits; None where that is the default.
        nulls : whether it may be null, and then is NaN; limits : least, most, above, unit; in the SI unit
        """
        value = self.get(key, default)
        if value is None and default is None:
            return None
        self.numbers(value, (), key, (), nulls=nulls)
        if not isinstance(value, int | float):
            return math.nan
        found = float(self._si(key, value, limits.get("unit", "")))
        self._within(found, (key,), **limits)
        return found

    @overload
    def each(self, key: Key, count: int, default: float | Required = ..., **limits: Unpack[LimitsOfEach]) -> Floats: ...

    @overload
    def each(self, key: Key, count: int, default: None, **limits: Unpack[LimitsOfEach]) -> Floats | None: ...

    def each(
        self, key: Key, count: int, default: float | Required | None = REQUIRED, **limits: Unpack[LimitsOfEach]
    ) -> Floats | None:
        """(count,) finite numbers within limits, stated one by one or one for all; None where that is the default."""
        stated = self.get(key, default)
        if stated is None and default is None:
            return None
        units = limits.pop("units", [limits.get("unit", "")] * count)
        of_each = [cast(Limits, {**limits, "unit": unit}) for unit in units]
        if not isinstance(stated, list):
            return np.array([self.number(key, default, **one) for one in of_each], float)
        values = self.array(key, (count,), unit=units)
        for i, value in enumerate(values):
            self._within(value, (key, i), **of_each[i])
        return values

    def _within(
        self,
        value: float,
        keys: tuple[Key, ...],
        least: float = -math.inf,
        most: float = math.inf,
        above: float = -math.inf,
        unit: str = "",
    ) -> None:
        if not (value < least or value > most or value <= above):  # true for NaN, which stands for null
            return
        stated = ((">=", least), (">", above), ("<=", most))
        scale = self.units.per_si(unit)
        unit = unit if scale == 1 else self.units.name(unit.split(" (is")[0])
        shown = value if scale == 1 else float(f"{value * scale:.12g}")
        limits = " and ".join(f"{sign} {limit * scale:.15g}" for sign, limit in stated if math.isfinite(limit))
        label = self._label(keys[0], cast(tuple[int, ...], keys[1:]))
        self.fail(f"{label} must be {limits} {unit}".rstrip() + f", not {short_repr(shown)}", *keys, value=shown)

    @overload
    def array(
        self, key: Key, shape: Shape, default: list[float] | Required = ..., **options: Unpack[ArrayOptions]
    ) -> Floats: ...

    @overload
    def array(self, key: Key, shape: Shape, default: None, **options: Unpack[ArrayOptions]) -> Floats | None: ...

    def array(
        self, key: Key, shape: Shape, default: object = REQUIRED, **options: Unpack[ArrayOptions]
    ) -> Floats | None:
        """Numbers nested as shape says (None: any length), in SI."""
        length_limit, nulls = options.get("length_limit"), options.get("nulls", False)
        value = self.get(key, default)
        if value is None and default is None:
            return None
        self.numbers(value, shape, key, (), length_limit, nulls)
        found = np.array(value, float)
        if not found.size:
            return found.reshape([n or 0 for n in shape])
        return self._si(key, found, options.get("unit") or ("m" if length_limit else ""))

    def _si(self, key: Key, value: Floats | float, unit: UnitNames) -> Floats:
        """A value in SI. unit : SI unit of it; a default, which is not in the file, is in SI already"""
        if key in self.tree and self.unit_log is not None:
            self.unit_log[(*self.path, key)] = unit
        return self.units.si(value, unit) if key in self.tree else np.asarray(value, float)

    def numbers(
        self,
        value: object,
        shape: Shape,
        key: Key,
        index: tuple[int, ...],
        length_limit: float | None = None,
        nulls: bool = False,
    ) -> None:
        """Check that a value is a number, or numbers nested as shape says; index : where in the key's value it is."""

        def fail(message: str) -> NoReturn:
            self.fail(f"{self._label(key, index)} {message}", key, *index, value=value)

        if shape:
            if not isinstance(value, list) or (shape[0] is not None and len(value) != shape[0]):
                got = f"{len(value)} entries" if isinstance(value, list) else short_repr(value)
                fail(f"must have {'x'.join('n' if n is None else str(n) for n in shape)} numbers, got {got}")
            for i, item in enumerate(value):
                self.numbers(item, shape[1:], key, (*index, i), length_limit, nulls)
        elif isinstance(value, bool) or not isinstance(value, int | float):
            if not (nulls and value is None):
                fail(f"must be a number, not {short_repr(value)}")
        elif nulls and value != value:
            return
        elif not -LARGEST_NUMBER <= value <= LARGEST_NUMBER:  # true for what is not a number, too
            finite = isinstance(value, int) or math.isfinite(value)
            fail(f"is {'too large to compute with' if finite else 'not finite'}: {short_repr(value)}")
        elif length_limit is not None and abs(value) > length_limit * self.units.per_si("m"):
            limit, metres = self.units.shown(length_limit, "m"), self.units.length == "m"
            hint = f"lengths are in metres; is this in millimetres ({value / 1000:g} m)?" if metres else self._stated()
            fail(f"= {short_repr(value)} {self.units.length} is implausible (more than {limit}): {hint}")

    def _stated(self) -> str:
        return f'the file states units = "{self.units}"'

    def _label(self, key: Key, index: tuple[int, ...]) -> str:
        return self.name(key) + "".join(f"[{i + 1}]" for i in index)

    def pose(self, key: Key) -> RigidTransform:
        """RigidTransform of a table with position (m) and one of rotvec (rad), look_at (m), or euler with degrees;
        in the file's units but for the degrees.

        look_at : point that the z axis points to, as a camera's; up : direction against the y axis, z if absent
        euler : order of the turns, xyz about fixed axes, XYZ about those already turned; degrees : (3,), in that order
        Raises FileError for a table that states none or several of these, or a look_at without a direction
        """
        inner = self.table(key)
        inner.refuse_misspelt(("position", "rotvec", "look_at", "up", "euler", "degrees"))
        position = inner.array("position", (3,), length_limit=LARGEST_RIG)
        stated = [name for name in ("rotvec", "look_at", "euler") if name in inner.tree]
        if len(stated) > 1:
            self.fail(f"{self.name(key)} states its rotation {len(stated)} times: {', '.join(stated)}", key)
        for name, owner in (("up", "look_at"), ("degrees", "euler")):
            if name in inner.tree and owner not in inner.tree:
                inner.fail(f"{inner.name(name)} goes with {owner}, which is missing", name)
        if "look_at" in inner.tree:
            return RigidTransform.from_components(position, inner._facing(position))
        if "euler" in inner.tree:
            order = inner.text("euler")
            if not re.fullmatch(r"[xyz]{3}|[XYZ]{3}", order) or any(a == b for a, b in pairwise(order)):
                inner.refuse("euler", "three axes, as xyz (fixed) or ZYX (turned)", order)
            return RigidTransform.from_components(
                position, Rotation.from_euler(order, inner.array("degrees", (3,)), degrees=True)
            )
        return pose(position, inner.turn("rotvec"))

    def _facing(self, position: Floats) -> Rotation:
        """Rotation whose z axis points from a position (3,) m to look_at, and whose y axis is down."""
        up = self.array("up", (3,)) if "up" in self.tree else np.array([0.0, 0.0, 1.0])
        z = self.array("look_at", (3,), length_limit=LARGEST_RIG) - position
        x = np.cross(z, up)
        if np.linalg.norm(x) < 1e-6 * np.linalg.norm(z) * np.linalg.norm(up) or not z.any() or not up.any():
            self.fail(
                f"{self.name('look_at')} gives no direction beside up = {up.tolist()}: it is the position itself, or "
                "straight above or below it; state another up",
                "look_at",
            )
        x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
        return Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1))

    def turn(self, key: Key) -> Floats:
        """(3,) rad, a rotation vector."""
        value = self.array(key, (3,), unit="rad")
        if np.abs(value).max() > LARGEST_TURN:
            hint = "it is in radians; is this in degrees?" if self.units.angle == "rad" else self._stated()
            self.fail(f"{self.name(key)} = {self.get(key)} turns more than once round: {hint}", key, value=value)
        return value

    def refuse_misspelt(self, known: Collection[str]) -> None:
        """Raise FileError at the first key that is not known, with the nearest that is: a figure that nobody reads must
        not look as if it counted.
        """
        for key in self.tree:
            if key not in known:
                near = nearest_known_word(str(key), known, NEAREST)
                known_words = f"there {'are' if len(known) > 1 else 'is'} {', '.join(known)}"
                hint = f"is {near!r} meant?" if near else known_words
                self.fail(f"unknown key {short_repr(self.name(key))}; {hint}", key, value=key)
