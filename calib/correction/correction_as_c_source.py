"""The correction of a hexapod's calibration as one C99 file, for a controller that computes its own strut lengths.

The file does what `rig correct` does for poses without times: inverse kinematics of the fitted geometry, the summand
over the configuration space at its fixed point, maps in pose space, and the effects that say how a controller computes
them, play with its state. It is put together of the parts in C beside this file, those alone that a calibration needs,
and of its tables. Source: configuration-space patent, [0024]-[0031], [0130]-[0137]
"""

import re
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files

import numpy as np

from calib.correction.correction import AnyCorrection
from calib.correction.interpolation.field_interface_and_combinations import Field, RestrictedMap, SummedPasses
from calib.correction.interpolation.gaussian_process import Radial, RadialMap
from calib.correction.interpolation.interpolation_on_grid_of_samples import Grid
from calib.correction.interpolation.polynomial_and_axis_sum_fields import AxisFunctions, Polynomial
from calib.correction.physics_compensation import Physics
from rig.array_and_json_types import Floats
from rig.effects.framework.effect_parameters_and_covariates import ControllerTerm
from rig.errors import RigError
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod
from rig.model.motion_simulation import motion_of_commands
from rig.recording.recording_folder import Commands

A_LINE = 100  # characters of a line of numbers
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")  # of a sensor channel that is a name in C too
STATUS = """  0 RIG_OK: lengths[6] are written, and the state moved on: command these lengths, or restore the state
  1 RIG_BAD_POSE: a number of the pose is not finite
  2 RIG_OUT_OF_STROKE: a corrected length leaves its strut's range
  3 RIG_NOT_CONVERGED: no lengths were found within the bounded number of iterations
  4 RIG_SENSOR_MISSING: channels are absent, or one is not finite
  5 RIG_NO_STATE: the state is absent or not finite, and a strut has play
  Where it is not 0, neither lengths nor state are changed."""


@dataclass(frozen=True, slots=True)
class CSource:
    """text : of the C file; notes : what a controller has to see to itself, in words; channels : sensor channels with
    their medians; gaps : (6,) m, play of each strut
    """

    text: str
    notes: tuple[str, ...]
    channels: dict[str, float]
    gaps: Floats


@dataclass(slots=True)
class _Tables:
    """Definitions written so far, the parts that they use, and how many functions have a number."""

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
        rows = _rows(numbers) if shape.count("[") < 2 else _nested(numbers, np.shape(values)[-1])
        self.lines += [opening, *rows, "};"]

    def function(self, name: str, *statements: str) -> None:
        """Define a function that adds weight times a field's value at x to out."""
        head = f"static void {name}(const double *x, double weight, double *out)"
        self.lines += [head, "{", *(f"    {line}" for line in statements), "}", ""]


def correction_c_source(
    correction: AnyCorrection, physics: Physics | None, origin: str, play_elsewhere: bool = False
) -> CSource:
    """CSource of a hexapod's Correction and the Physics besides, or None.

    origin : of which file and by which version it is made, for its head
    play_elsewhere : whether the controller itself adds half of a strut's play in the direction of its motion: lengths
        are then those without, and ranges are half a play narrower at both ends
    Raises RigError for another machine, for a way to extend corrections and for an effect that no C file states
    """
    fitted = require_hexapod(
        correction.fitted, "a controller's C file holds a hexapod's calibration, not one of kind {kind!r}"
    )
    nominal = require_hexapod(correction.nominal)
    if correction.posed and correction.physics:
        raise RigError(
            f"maps in pose space together with {', '.join(correction.physics)} are in no C file; use `rig correct`"
        )
    tables = _Tables()
    terms = _terms(correction, physics)
    channels = tuple(dict.fromkeys(name for term in terms for name in term.channels))
    plays = _gaps(terms)
    if play_elsewhere and plays.any() and any("sin(" in line for term in terms for line in term.statements):
        raise RigError("play together with a cyclic error needs the play in the C file itself; use --format c")
    gaps = np.zeros(6) if play_elsewhere else plays
    for name, values in (
        ("BASE", fitted.base_joints),
        ("PLATFORM", fitted.platform_joints),
        ("RANGE", nominal.strut_range + 0.5 * (plays - gaps)[:, None] * [1, -1]),
    ):
        tables.array(name, values, shape=f"[6][{values.shape[1]}]")
    tables.array("ZERO", fitted.strut_zeros, shape="[6]")
    tables.array("GAP", gaps, shape="[6]")
    geometry, tables.lines = tables.lines, []
    settled = _remainder(tables, correction)
    maps = _pose_maps(tables, correction)
    medians = {} if physics is None else {name: float(physics.channels[name][0]) for name in channels}
    home = ", ".join(map(repr, hexapod.home_values(nominal).tolist()))
    text = [
        _head(correction, terms, channels, gaps, origin),
        _part("api"),
        _channel_source(channels, list(medians.values()), home),
        "\n".join(geometry) + "\n",
        *(_part(name) for name in _FIELDS if name in tables.parts),
        "\n".join(tables.lines),
        _part("settle" if settled else "no remainder"),
        _part("rotation"),
        *([_part("pose maps")] if maps else []),
        *([_deviations(terms, channels), _part("effects")] if terms else [_part("no effects")]),
        _part("correct").replace("    /* insert: pose maps */\n", "".join(maps)),
    ]
    return CSource("\n".join(line.rstrip("\n") + "\n" for line in text if line), _notes(terms), medians, plays)


_FIELDS = ("grid", "simplex", "linear", "axes", "polynomial", "radial", "within")


@cache
def _parts() -> dict[str, str]:
    """{name: text} of the parts of the C files of this folder."""
    text = "".join(files(__package__).joinpath(f"controller_{name}parts.c").read_text() for name in ("", "field_"))
    found = re.split(r"^/\* part: (.*) \*/\n", text, flags=re.MULTILINE)
    return dict(zip(found[1::2], found[2::2]))


def _part(name: str) -> str:
    return _parts()[name]


def _rows(numbers: list[str]) -> list[str]:
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


def _head(
    correction: AnyCorrection, terms: tuple[ControllerTerm, ...], channels: tuple[str, ...], gaps: Floats, origin: str
) -> str:
    """Head comment: what the file computes, and how it is called."""
    ways = [
        *(f"remainder of strut {i + 1}" for i, part in enumerate(correction.remainder) if part is not None),
        *([] if correction.extension is None else [f"extension {correction.extension.kind!r}"]),
        *(f"map {one.field.kind!r} in pose space" for one in correction.posed),
    ]
    listed = [f"    channels[{i}] {name}" for i, name in enumerate(channels)] or ["    none: channels may be 0"]
    effects = ", ".join(correction.physics) or "none"
    play = ", ".join(f"strut {i + 1} {gaps[i] * 1e6:.3f} um" for i in np.flatnonzero(gaps).tolist()) or "none"
    lines = [
        "Corrected strut lengths of a hexapod, as `rig correct` computes them.",
        f"Made by {origin}",
        "C99, double precision, <math.h> only. Nothing is allocated, every loop is bounded.",
        "",
        "int rig_start(struct rig_state *state, const double lengths[6]);",
        "int rig_correct(const double pose[6], const double *channels, struct rig_state *state, double lengths[6]);",
        "",
        "  pose: wanted T_base_platform, position x y z (m) and rotation vector rx ry rz (rad)",
        "  lengths: of the struts to command, m",
        "  state: where the struts were commanded to last; 0 is allowed where no strut has play. rig_start sets it",
        "    to lengths at which the struts stand, in the middle of their play, or for 0 to those of home (rig_home)",
        "  channels: sensor values, degrees Celsius, in this order",
        *listed,
        *(["    not measured: pass rig_channel_medians, medians of the recording"] if channels else []),
        "  calls are in the order in which the poses are commanded, each held until the machine has come to rest",
        "",
        "Returned:",
        *STATUS.splitlines(),
        "",
        f"Over the configuration space: {'; '.join(ways) or 'the fitted geometry alone'}",
        f"Effects: {effects}",
        f"Play: {play}",
        *_notes(terms),
    ]
    return "/*\n" + "\n".join(f" * {line}".rstrip() for line in lines).replace("*/", "* /") + "\n */\n"


def _notes(terms: tuple[ControllerTerm, ...]) -> tuple[str, ...]:
    """What a controller has to see to itself, in words."""
    return tuple(
        f"{', '.join(term.channels)}: pass what a first-order lag of {term.lag:g} s makes of the sensor"
        for term in terms
        if term.lag
    )


def _channel_source(channels: tuple[str, ...], medians: list[float], home: str) -> str:
    """Definitions of the home lengths (m) and of the channels with their medians."""
    lines = ["extern const double rig_home[6];", f"const double rig_home[6] = {{{home}}};", ""]
    names = [*(f"RIG_{name.upper()}" for name in channels), "RIG_CHANNELS"]
    if channels:
        lines += [
            "enum {",
            *(f"    {name}," for name in names[:-1]),
            f"    {names[-1]}",
            "};",
            "extern const double rig_channel_medians[RIG_CHANNELS];",
            "const double rig_channel_medians[RIG_CHANNELS] = {",
            *_rows([repr(median) for median in medians]),
            "};",
        ]
    else:
        lines.append("enum { RIG_CHANNELS = 0 };")
    return "\n".join([*lines, ""])


def _terms(correction: AnyCorrection, physics: Physics | None) -> tuple[ControllerTerm, ...]:
    """What a controller computes of each effect that commands undo. Raises RigError for one that has no such form."""
    effects = () if physics is None else physics.compensable_effects()
    if physics is None or not effects:
        return ()
    design, home = physics.machine(correction.fitted), hexapod.home_values(correction.fitted)
    motion = motion_of_commands(design, Commands(np.zeros(1), home[None]), np.zeros(1))
    found = [effect.in_controller(motion) for effect in effects]
    lacking = [f"{e.label()} at {e.place}" for e, term in zip(effects, found) if term is None]
    if lacking:
        raise RigError(
            f"no C file states {', '.join(lacking)}, which this calibration compensates; use `rig correct`, or a "
            "calibration without it"
        )
    terms = tuple(term for term in found if term is not None)
    wrong = [name for term in terms for name in term.channels if not NAME.fullmatch(name)]
    if wrong:
        raise RigError(f"the sensor channel {wrong[0]!r} is no name in C: letters, digits and _ only")
    return terms


def _gaps(terms: tuple[ControllerTerm, ...]) -> Floats:
    """(6,) m, play of each strut. Raises RigError for a strut with two."""
    every = np.array([term.gaps for term in terms if term.gaps]).reshape(-1, 6)
    twice = np.flatnonzero((every > 0).sum(axis=0) > 1)
    if len(twice):
        raise RigError(f"strut {twice[0] + 1} has two plays in this calibration, which no C file states")
    return np.asarray(every.sum(axis=0))


def _deviations(terms: tuple[ControllerTerm, ...], channels: tuple[str, ...]) -> str:
    """The function of what effects add to the struts."""
    statements = [line for term in terms for line in term.statements]
    used = "\n".join(statements)
    unused = [name for name in ("c", "tip", "channels", "d") if not re.search(rf"\b{name}\[", used)]
    return "\n".join(
        [
            "/* What the struts do beyond lengths c that are commanded, m, but for play. */",
            "static void add_deviations(const double c[6], const double tip[6][3], const double *channels, "
            "double d[6])",
            "{",
            *(f"    (void){name};" for name in unused),
            *(f"    {line}" for line in statements),
            "}",
            "",
        ]
    )


def _remainder(tables: _Tables, correction: AnyCorrection) -> bool:
    """Define the summand over the configuration space, add_remainder; returns whether there is any."""
    names = [] if correction.extension is None else _field(tables, correction.extension)
    for part in correction.remainder:
        if part is not None:
            names += _radial(tables, part)
    if names:
        tables.lines += [
            "/* The summand over the configuration space at lengths x, m. */",
            "static void add_remainder(const double *x, double *out)",
            "{",
            *(f"    {name}(x, 1.0, out);" for name in names),
            "}",
            "",
        ]
    return bool(names)


def _pose_maps(tables: _Tables, correction: AnyCorrection) -> list[str]:
    """Define the maps in pose space; returns the statements that undo them, the last first."""
    statements = []
    for one in reversed(correction.posed):
        if one.coordinates != tuple(range(6)):
            raise RigError("a map in pose space over fewer than six coordinates is in no C file")
        number = tables.number()
        names = _field(tables, one.field)
        tables.function(f"map_{number}", *(f"{name}(x, weight, out);" for name in names))
        tables.array(f"home_{number}", one.home.rotation.as_matrix(), shape="[3][3]")
        statements.append(
            f"    status = compensate(map_{number}, home_{number}, &T);\n"
            "    if (status != RIG_OK)\n        return status;\n"
        )
    return statements


def _field(tables: _Tables, one: Field) -> list[str]:
    """Names of the functions that add a Field, which are defined. Raises RigError for a kind that no C file states."""
    if isinstance(one, SummedPasses):
        return [name for part in one.fields for name in _field(tables, part)]
    if isinstance(one, RadialMap):
        return [name for part in one.parts if part is not None for name in _radial(tables, part)]
    if isinstance(one, RestrictedMap):
        return _restricted(tables, one)
    number = tables.number()
    name = f"add_field_{number}"
    if isinstance(one, Grid):
        shape = [len(level) for level in one.levels]
        for i, level in enumerate(one.levels):
            tables.array(f"levels_{number}_{i}", level)
        tables.array(f"values_{number}", one.values)
        levels = ", ".join(f"levels_{number}_{i}" for i in range(6))
        cells, strides = (", ".join(map(str, v)) for v in ([n - 1 for n in shape], one.strides().tolist()))
        struct = f"struct grid f = {{{{{levels}}}, {{{cells}}}, {{{strides}}}, values_{number}}}"
        tables.parts |= {"grid", one.kind}
    elif isinstance(one, AxisFunctions):
        tables.array(f"knots_{number}", one.knots)
        tables.array(f"coefficients_{number}", one.coefficients)
        struct = f"struct axis_sum f = {{{one.knots.shape[1]}, knots_{number}, coefficients_{number}}}"
        tables.parts.add(one.kind)
    elif isinstance(one, Polynomial):
        for part, values in (("low", one.low), ("high", one.high), ("coefficients", one.coefficients)):
            tables.array(f"{part}_{number}", values)
        tables.array(f"powers_{number}", one.powers, "int")
        named = ", ".join(f"{part}_{number}" for part in ("low", "high", "powers", "coefficients"))
        struct = f"struct polynomial f = {{{len(one.powers)}, {named}}}"
        tables.parts.add(one.kind)
    else:
        raise RigError(
            f"an extension of kind {one.kind!r} is in no C file, as it has no table that a controller can hold; "
            "calibrate with --extend simplex, linear, axes, radial or polynomial, or use `rig correct`"
        )
    tables.function(name, f"static const {struct};", f"add_{one.kind}(&f, x, weight, out);")
    return [name]


def _restricted(tables: _Tables, one: RestrictedMap) -> list[str]:
    """Name of the function that adds a map that fades beyond a part of the space."""
    names, number = _field(tables, one.field), tables.number()
    bounds = (("low", one.part.low), ("high", one.part.high), ("fade", one.part.fade))
    for part, values in bounds:
        tables.array(f"{part}_{number}", np.broadcast_to(values, 6))
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


def _radial(tables: _Tables, part: Radial) -> list[str]:
    """Name of the function that adds a Gaussian process, its samples and weights in a table."""
    number = tables.number()
    own, whole = part.sizes**2
    samples = np.column_stack([part.inputs, own * part.weights, whole * part.weights])
    for name, values in (("centre", part.centre), ("half", part.half), ("samples", samples)):
        tables.array(f"{name}_{number}", values)
    rates = ", ".join(repr(0.5 / float(length) ** 2) for length in part.lengths)
    named = ", ".join(f"{name}_{number}" for name in ("centre", "half", "samples"))
    tables.function(
        f"add_field_{number}",
        f"static const struct radial f = {{{part.axis}, {len(part.weights)}, {rates}, {named}}};",
        "add_radial(&f, x, weight, out);",
    )
    tables.parts.add("radial")
    return [f"add_field_{number}"]
