"""Fields of a correction as functions in C.

In C99, with their tables: the summand over configurations, and maps of poses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.correction.interpolation.gaussian_process_interpolation import Radial, RadialMap
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    Field,
    RestrictedMap,
    SummedPasses,
)
from calib.correction.interpolation.interpolation_on_grid_of_samples import Grid
from calib.correction.interpolation.polynomial_and_axis_sum_fields import AxisFunctions, Polynomial
from rig.array_and_json_types import Floats
from rig.errors import RigError

A_LINE = 100  # characters of a line of numbers


@dataclass(slots=True)
class CTables:
    """Definitions for a machine of so many axes, the parts that they use, and how many functions have a number."""

    axes: int
    lines: list[str] = field(default_factory=list)
    parts: set[str] = field(default_factory=set)
    count: int = 0

    def number(self) -> int:
        """The next number of a field."""
        self.count += 1
        return self.count

    def array(self, name: str, values: Floats, kind: str = "double", shape: str = "[]") -> None:
        """Define an array of all values, a row after the other; shape : its dimensions in C."""
        flat = np.asarray(values).ravel()
        numbers = [str(int(v)) if kind == "int" else repr(float(v)) for v in flat]
        if kind == "double" and not np.isfinite(flat).all():
            numbers = ["HUGE_VAL" if n == "inf" else "-HUGE_VAL" if n == "-inf" else n for n in numbers]
        opening = f"static const {kind} {name}{shape} = {{"
        rows = c_number_lines(numbers) if shape.count("[") < 2 else _nested(numbers, np.shape(values)[-1])
        self.lines += [opening, *rows, "};"]

    def function(self, name: str, *statements: str) -> None:
        """Define a function that adds weight times a field's value at x to out."""
        head = f"static void {name}(const double *x, double weight, double *out)"
        self.lines += [head, "{", *(f"    {line}" for line in statements), "}", ""]

    def structure(self, part: str, numbers: Sequence[float], arrays: Mapping[str, Floats]) -> list[str]:
        """Name of the function that adds what a part computes, of its structure of numbers and then of arrays, which
        are defined.
        """
        number = self.number()
        for name, values in arrays.items():
            self.array(f"{name}_{number}", values)
        held = ", ".join([*map(str, numbers), *(f"{name}_{number}" for name in arrays)])
        name = f"add_field_{number}"
        self.function(name, f"static const struct {part} f = {{{held}}};", f"add_{part}(&f, x, weight, out);")
        self.parts.add(part)
        return [name]


def c_number_lines(numbers: list[str]) -> list[str]:
    """Lines of numbers, none too long."""
    rows, line = [], "   "
    for number in numbers:
        if len(line) + len(number) + 2 > A_LINE:
            rows.append(line)
            line = "   "
        line += f" {number},"
    return [*rows, line]


def _nested(numbers: list[str], width: int) -> list[str]:
    """Lines of numbers, a row of a matrix each."""
    return [f"    {{{', '.join(numbers[i : i + width])}}}," for i in range(0, len(numbers), width)]


def define_c_functions_of_field(tables: CTables, correction_field: Field) -> list[str]:
    """Define the C functions that add a Field's value.

    Returns their names.
    Raises RigError for a kind that no C file states.
    """
    if isinstance(correction_field, SummedPasses):
        return [name for part in correction_field.fields for name in define_c_functions_of_field(tables, part)]
    if isinstance(correction_field, RadialMap):
        return [
            name
            for part in correction_field.parts
            if part is not None
            for name in define_c_function_of_gaussian_process(tables, part)
        ]
    if isinstance(correction_field, RestrictedMap):
        return _restricted(tables, correction_field)
    number = tables.number()
    name = f"add_field_{number}"
    if isinstance(correction_field, Grid):
        shape = [len(level) for level in correction_field.levels]
        for i, level in enumerate(correction_field.levels):
            tables.array(f"levels_{number}_{i}", level)
        tables.array(f"values_{number}", correction_field.values)
        levels = ", ".join(f"levels_{number}_{i}" for i in range(len(shape)))
        cells, strides = (", ".join(map(str, v)) for v in ([n - 1 for n in shape], correction_field.strides().tolist()))
        struct = f"struct grid f = {{{{{levels}}}, {{{cells}}}, {{{strides}}}, values_{number}}}"
        tables.parts |= {"grid", correction_field.kind}
    elif isinstance(correction_field, AxisFunctions):
        tables.array(f"knots_{number}", correction_field.knots)
        tables.array(f"coefficients_{number}", correction_field.coefficients)
        struct = f"struct axis_sum f = {{{correction_field.knots.shape[1]}, knots_{number}, coefficients_{number}}}"
        tables.parts.add(correction_field.kind)
    elif isinstance(correction_field, Polynomial):
        for part, values in (
            ("low", correction_field.low),
            ("high", correction_field.high),
            ("coefficients", correction_field.coefficients),
        ):
            tables.array(f"{part}_{number}", values)
        tables.array(f"powers_{number}", correction_field.powers, "int")
        named = ", ".join(f"{part}_{number}" for part in ("low", "high", "powers", "coefficients"))
        struct = f"struct polynomial f = {{{len(correction_field.powers)}, {named}}}"
        tables.parts.add(correction_field.kind)
    else:
        raise RigError(
            f"an extension of kind {correction_field.kind!r} is in no C file, as it has no table that a controller can "
            "hold; calibrate with --extend simplex, linear, axes, radial or polynomial, or use `rig correct`"
        )
    tables.function(name, f"static const {struct};", f"add_{correction_field.kind}(&f, x, weight, out);")
    return [name]


def _restricted(tables: CTables, one: RestrictedMap) -> list[str]:
    """Name of the function that adds a map that fades beyond a part of the space."""
    names, number = define_c_functions_of_field(tables, one.field), tables.number()
    bounds = (("low", one.part.low), ("high", one.part.high), ("fade", one.part.fade))
    for part, values in bounds:
        tables.array(f"{part}_{number}", np.broadcast_to(values, tables.axes))
    tables.parts.add("within")
    arguments = ", ".join(f"{part}_{number}" for part, _ in bounds)
    tables.function(
        f"add_field_{number}",
        f"const double share = weight * within(x, {arguments});",
        "if (share > 0.0) {",
        *(f"    {name}(x, share, out);" for name in names),
        "}",
    )
    return [f"add_field_{number}"]


def define_c_function_of_gaussian_process(tables: CTables, part: Radial) -> list[str]:
    """Define the C function of a Gaussian process.

    It adds radial functions.
    Returns the name of the one; its samples and weights stand in a table
    """
    own, whole = part.sizes**2
    samples = np.column_stack([part.inputs, own * part.weights, whole * part.weights])
    rates = [0.5 / float(length) ** 2 for length in part.lengths]
    arrays = {"centre": part.centre, "half": part.half, "samples": samples}
    return tables.structure("radial", (part.axis, len(part.weights), *rates), arrays)
