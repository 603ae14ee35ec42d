"""Interpolation methods by name: fitting a field, and writing it to and reading it from files."""

from collections.abc import Callable
from dataclasses import fields as parts_of

import numpy as np

from calib.correction.interpolation.delaunay import Delaunay
from calib.correction.interpolation.field import Field, Known
from calib.correction.interpolation.field_combinations import RestrictedMap, SpacePart, SummedPasses
from calib.correction.interpolation.gaussian_process import Radial, RadialMap
from calib.correction.interpolation.grid import Linear, Simplex
from calib.correction.interpolation.regression_fields import AxisFunctions, Polynomial
from rig.arrays import Floats
from rig.errors import RigError
from rig.formats.checked_entries import Entries
from rig.formats.json_tree import Json
from rig.formats.structured_files import json_data

SHAPES = {  # of the arrays: a axes, m outputs, the other letters any number, the same wherever they stand
    **dict.fromkeys(("linear", "simplex"), {"levels": "ragged", "values": "nm", "variances": "nm", "misfit": "m"}),
    "delaunay": {"centre": "a", "half": "a", "samples": "na", "values": "nm", "variances": "nm", "misfit": "m"},
    "axes": {"knots": "ac", "coefficients": "fm", "root": "fk", "noise": "m", "misfit": "m"},
    "polynomial": {
        "low": "a",
        "high": "a",
        "powers": "fa",
        "coefficients": "fm",
        "root": "fk",
        "noise": "m",
        "misfit": "m",
    },
}
METHODS = {one.kind: one for one in (Linear, Simplex, Delaunay, AxisFunctions, RadialMap, Polynomial)}


def fit_field(kind: str, samples: Known) -> Field:
    """Field of a kind fitted to samples. Raises RigError for an unknown kind, and what the kind raises."""
    if kind not in METHODS:
        raise RigError(f"there is no way {kind!r} to extend corrections; there are {', '.join(METHODS)}")
    return METHODS[kind].fit(samples)


def field_to_dict(field: Field) -> Json:
    """dict of a Field, as JSON holds it."""
    if isinstance(field, SummedPasses):
        return {"kind": field.kind, "fields": [field_to_dict(one) for one in field.fields]}
    if isinstance(field, RestrictedMap):
        return {
            "kind": field.kind,
            "field": field_to_dict(field.field),
            "low": _bounds(field.part.low),
            "high": _bounds(field.part.high),
        }
    parts = parts_of(field)  # type: ignore[arg-type]
    return {"kind": field.kind} | {part.name: json_data(getattr(field, part.name)) for part in parts if part.init}


def _bounds(values: Floats) -> list[float | None]:
    """Bounds of a part; null where there is none."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _part(table: Entries, axes: int) -> SpacePart:
    low, high = (table.array(name, (axes,), nulls=True) for name in ("low", "high"))
    try:
        return SpacePart(np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high))
    except ValueError as error:
        table.fail(f"{table.name('low')}: {error}", "low")


def field_from_entries(table: Entries, axes: int) -> Field:
    """Field over so many axes, of what `field_to_dict` gave. Raises FileError for anything else."""
    named = table.text("kind", (*METHODS, SummedPasses.kind, RestrictedMap.kind))
    if named == SummedPasses.kind:
        return SummedPasses(tuple(field_from_entries(one, axes) for one in table.tables("fields")))
    if named == RestrictedMap.kind:
        return RestrictedMap(field_from_entries(table.table("field"), axes), _part(table, axes))
    kind = METHODS[table.text("kind", tuple(METHODS))]
    build: Callable[..., Field] = kind
    if kind is RadialMap:
        parts = _ragged(table, "parts")
        found = [
            None
            if one is None
            else gaussian_process_from_entries(Entries(one, (*table.path, "parts", i), table.file, table.places), axes)
            for i, one in enumerate(parts)
            if one is None or isinstance(one, dict)
        ]
        inflation = table.number("inflation") if "inflation" in table.tree else 1.0
        return RadialMap(tuple(found), table.array("low", (axes,)), table.array("high", (axes,)), inflation)
    sizes: dict[str, int] = {"a": axes}
    read = {
        name: _levels(table, axes) if shape == "ragged" else _array(table, name, shape, sizes)
        for name, shape in SHAPES[kind.kind].items()
    }
    try:
        return build(**read)
    except (ValueError, RigError) as error:
        table.fail(f"{table.name('kind')}: a field of kind {kind.kind!r} cannot be: {error}", "kind")


def gaussian_process_from_entries(table: Entries, axes: int) -> Radial:
    """Gaussian process from its entries in a file. Raises FileError where it is none."""
    inputs = table.array("inputs", (None, axes))
    half, lengths = table.array("half", (axes,)), table.array("lengths", (2,))
    for name, values in (("half", half), ("lengths", lengths)):
        if (values <= 0).any():
            table.fail(f"{table.name(name)} must be positive, not {values.tolist()}", name)
    return Radial(
        table.array("centre", (axes,)),
        half,
        table.whole("axis", 0, most=axes - 1),
        inputs,
        table.array("weights", (len(inputs),)),
        table.array("sizes", (2,)),
        lengths,
        table.number("noise"),
        table.array("variances", (len(inputs),), None) if "variances" in table.tree else None,
    )


def _array(table: Entries, name: str, shape: str, sizes: dict[str, int]) -> Floats:
    found = table.array(name, tuple(sizes.get(letter) for letter in shape))
    sizes.update(zip(shape, found.shape))
    return found


def _levels(table: Entries, axes: int) -> tuple[Floats, ...]:
    listed = _ragged(table, "levels")
    if len(listed) != axes:
        table.fail(f"{table.name('levels')} must list {axes} axes, got {len(listed)}", "levels")
    inner = Entries(dict(enumerate(listed)), (*table.path, "levels"), table.file, table.places)
    return tuple(inner.array(i, (None,)) for i in range(axes))


def _ragged(table: Entries, name: str) -> list[object]:
    value = table.get(name)
    if not isinstance(value, list):
        table.fail(f"{table.name(name)} must be a list", name)
    return value
