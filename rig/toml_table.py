"""A TOML table that checks what it hands out, and complains with file, line and column."""

import difflib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.errors import FileError
from rig.pose import pose

LARGEST_RIG = 50.0  # m; nothing on struts or arms is larger, so a larger figure is in another unit
REQUIRED = object()


@dataclass
class TomlTable:
    """A TOML table that knows where it stands and complains about its values."""

    tree: dict
    path: tuple
    file: Path
    places: dict

    def fail(self, message, *keys, value=None):
        """Raise FileError at the value under keys, or at the nearest thing above it that has a place."""
        at = self.path + keys
        while at not in self.places:
            at = at[:-1]
        raise FileError(self.file, message, *self.places[at], value=value)

    def name(self, key):
        """A key with its path, as in camera.1.width."""
        return ".".join(str(part + 1 if isinstance(part, int) else part) for part in (*self.path, key))

    def get(self, key, default=REQUIRED):
        """A value as TOML has it. Raises FileError where it is missing and no default is given."""
        if key in self.tree:
            return self.tree[key]
        if default is REQUIRED:
            near = difflib.get_close_matches(key, self.tree, n=1, cutoff=0.7)
            hint = f"; is {near[0]!r} meant?" if near else ""
            self.fail(f"{self.name(key)} is missing{hint}", *(near or ()))
        return default

    def table(self, key, optional=False):
        """A table within this one."""
        value = self.get(key, {} if optional else REQUIRED)
        if not isinstance(value, dict):
            self.fail(f"{self.name(key)} must be a table, not {value!r}", key, value=value)
        return TomlTable(value, self.path + (key,), self.file, self.places)

    def tables(self, key):
        """The tables of an array of tables."""
        value = self.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.fail(f"{self.name(key)} must be written as [[{key}]] tables", key, value=value)
        return [TomlTable(item, self.path + (key, i), self.file, self.places) for i, item in enumerate(value)]

    def text(self, key, choices=None, default=REQUIRED):
        """Text, one of choices where these are given."""
        value = self.get(key, default)
        if value is default and default is not REQUIRED:
            return default
        if not isinstance(value, str) or (not choices and not value):
            self.fail(f"{self.name(key)} must be text, not {value!r}", key, value=value)
        if choices and value not in choices:
            self.fail(f"{self.name(key)} must be one of {', '.join(map(repr, choices))}, not {value!r}", key, value=value)
        return value

    def whole(self, key, least, default=REQUIRED):
        """A whole number of at least `least`."""
        value = self.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            self.fail(f"{self.name(key)} must be a whole number of at least {least}, not {value!r}", key, value=value)
        return value

    def number(self, key, default=REQUIRED, least=None, most=None, above=None, unit=""):
        """A finite number within limits; None where the default says so."""
        value = self.get(key, default)
        if value is None:
            return None
        self.numbers(value, (), key, ())
        self._within(value, (key,), least, most, above, unit)
        return float(value)

    def each(self, key, count, default=REQUIRED, **limits):
        """(count,) finite numbers within limits, stated one by one or one for all; None where the default says so."""
        if not isinstance(self.get(key, default), list):
            value = self.number(key, default, **limits)
            return None if value is None else np.full(count, value)
        values = self.array(key, (count,))
        for i, value in enumerate(values):
            self._within(value, (key, i), **limits)
        return values

    def _within(self, value, keys, least=None, most=None, above=None, unit=""):
        if (least is not None and value < least) or (most is not None and value > most) or (above is not None and value <= above):
            limits = [f">= {least}" if least is not None else "", f"> {above}" if above is not None else "",
                      f"<= {most}" if most is not None else ""]
            label = self.name(keys[0]) + "".join(f"[{i + 1}]" for i in keys[1:])
            self.fail(f"{label} must be {' and '.join(filter(None, limits))} {unit}".rstrip() + f", not {value}", *keys, value=value)

    def array(self, key, shape, default=REQUIRED, length_limit=None):
        """Numbers nested as shape says (None: any length). length_limit (m) catches figures in another unit."""
        value = self.get(key, default)
        if value is None:
            return None
        self.numbers(value, shape, key, (), length_limit)
        return np.array(value, float)

    def numbers(self, value, shape, key, index, length_limit=None):
        """Check that a value is a number, or numbers nested as shape says; index : where within the key's value it stands."""
        label = self.name(key) + "".join(f"[{i + 1}]" for i in index)
        if not shape:
            if isinstance(value, bool) or not isinstance(value, int | float):
                self.fail(f"{label} must be a number, not {value!r}", key, *index, value=value)
            if not np.isfinite(value):
                self.fail(f"{label} is not finite: {value}", key, *index, value=value)
            if length_limit is not None and abs(value) > length_limit:
                self.fail(f"{label} = {value} m is implausible (more than {length_limit:g} m): rig.toml is in metres; "
                          f"is this in millimetres ({value / 1000:g} m)?", key, *index, value=value)
            return
        if not isinstance(value, list) or (shape[0] is not None and len(value) != shape[0]):
            got = f"{len(value)} entries" if isinstance(value, list) else repr(value)
            self.fail(f"{label} must have {'x'.join('n' if n is None else str(n) for n in shape)} numbers, got {got}",
                      key, *index, value=value)
        for i, item in enumerate(value):
            self.numbers(item, shape[1:], key, (*index, i), length_limit)

    def pose(self, key):
        """RigidTransform of a table with position (m) and rotvec (rad)."""
        inner = self.table(key)
        position = inner.array("position", (3,), length_limit=LARGEST_RIG)
        return pose(position, inner.array("rotvec", (3,)))

    def refuse_misspelt(self, known):
        """An unknown key one slip away from a known, absent one is a slip; other unknown keys are left alone."""
        for key in self.tree:
            if key not in known:
                near = [k for k in difflib.get_close_matches(key, known, n=1, cutoff=0.8) if k not in self.tree]
                if near:
                    self.fail(f"unknown key {self.name(key)!r}; is {near[0]!r} meant?", key, value=key)
