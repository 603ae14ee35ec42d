"""Correction of a hexapod as C source, and parts that C files of all machines share.

One C99 file, for a controller that computes its own commands.

The file does what `rig correct` does for poses without times: inverse kinematics of the fitted geometry, the summand
over the configuration space at its fixed point, maps in pose space, and the effects that say how a controller computes
them, play with its state. It is put together of the parts in C beside this file, those alone that a calibration needs,
and of its tables. Here is what all machines have in common, and the file of a hexapod.
Source: configuration-space patent, [0024]-[0031], [0130]-[0137]
"""

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from calib.correction.correction_fields_as_c_functions import (
    CTables,
    c_number_lines,
    define_c_function_of_gaussian_process,
    define_c_functions_of_field,
)
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import Field
from calib.correction.machine_correction import AnyCorrection
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from rig.array_and_json_types import Floats
from rig.effects.framework.parameters_covariates_and_marker_table import ControllerTerm
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.machine_motion_simulation import motion_of_commands
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod
from rig.recording.recording_folder import Commands

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")  # of a sensor channel that is a name in C too
FIELDS = ("grid", "simplex", "linear", "axes", "polynomial", "radial", "within", "profile")


@dataclass(frozen=True, slots=True)
class CSource:
    """text : of the C file; notes : what a controller has to see to itself, in words; channels : sensor channels with
    their medians; gaps : (axes,) m or rad, play of each axis
    """

    text: str
    notes: tuple[str, ...]
    channels: dict[str, float]
    gaps: Floats


@dataclass(frozen=True, slots=True)
class CCall:
    """How a machine's C file is called, for its head comment. title; prototype : of rig_correct; arguments : lines on
    what is wanted and what is commanded; axes : what its axes are called; wanted, commands : words of the statuses
    """

    title: str
    prototype: str
    arguments: tuple[str, ...]
    axes: str
    wanted: str
    commands: str


HEXAPOD = CCall(
    "Corrected strut lengths of a hexapod, as `rig correct` computes them.",
    "int rig_correct(const double pose[6], const double *channels, struct rig_state *state, double lengths[6]);",
    (
        "  pose: wanted T_base_platform, position x y z (m) and rotation vector rx ry rz (rad)",
        "  lengths: of the struts to command, m",
    ),
    "strut",
    "the pose",
    "lengths",
)


@dataclass(frozen=True, slots=True)
class EffectsInC:
    """What a controller computes of the effects of a calibration. terms : of each; channels : sensor channels with
    their medians; plays : (axes,) m or rad of each axis
    """

    terms: tuple[ControllerTerm, ...]
    channels: dict[str, float]
    plays: Floats

    @property
    def notes(self) -> tuple[str, ...]:
        """What a controller has to see to itself, in words."""
        return tuple(
            f"{', '.join(term.channels)}: pass what a first-order lag of {term.lag:g} s makes of the sensor"
            for term in self.terms
            if term.lag
        )


def correction_c_source(
    correction: AnyCorrection, physics: Physics | None, origin: str, play_elsewhere: bool = False
) -> CSource:
    """C source of a hexapod's correction (CSource).

    Of the Correction and the Physics besides, or None.
    origin : of which file and by which version it is made, for its head
    play_elsewhere : whether the controller itself adds half of a strut's play in the direction of its motion: lengths
        are then those without, and ranges are half a play narrower at both ends
    Raises RigError for another machine, for a way to extend corrections and for an effect that no C file states
    """
    fitted = require_hexapod(
        correction.fitted,
        "a controller's C file holds a hexapod's calibration, or with --format c an arm's, not one of kind {kind!r}",
    )
    nominal = require_hexapod(correction.nominal)
    if correction.posed and correction.physics:
        raise RigError(
            f"maps in pose space together with {', '.join(correction.physics)} are in no C file; use `rig correct`"
        )
    effects = controller_terms_of_compensable_effects(correction, physics)
    plays = effects.plays
    if play_elsewhere and plays.any() and any("sin(" in line for term in effects.terms for line in term.statements):
        raise RigError("play together with a cyclic error needs the play in the C file itself; use --format c")
    gaps = np.zeros(6) if play_elsewhere else plays
    geometry, tables = CTables(6), CTables(6)
    for name, values in (
        ("BASE", fitted.base_joints),
        ("PLATFORM", fitted.platform_joints),
        ("RANGE", nominal.strut_range + 0.5 * (plays - gaps)[:, None] * [1, -1]),
    ):
        geometry.array(name, values, shape=f"[6][{values.shape[1]}]")
    geometry.array("ZERO", fitted.strut_zeros, shape="[6]")
    geometry.array("GAP", gaps, shape="[6]")
    parts = [define_c_function_of_gaussian_process(tables, one) for one in correction.remainder if one is not None]
    settled = append_add_remainder_if_any(tables, correction.extension, parts)
    maps = _pose_maps(tables, correction)
    return CSource(
        joined_c_parts(
            *c_file_head_interface_and_constants(HEXAPOD, correction, effects, gaps, origin),
            "\n".join(geometry.lines),
            *(c_source_part(name) for name in FIELDS if name in tables.parts),
            "\n".join(tables.lines),
            c_source_part("settle" if settled else "no remainder"),
            c_source_part("rotation"),
            *([c_source_part("rotation vector"), c_source_part("pose maps")] if maps else []),
            *effect_compensation_c_functions(effects),
            c_source_part("ranges"),
            c_source_part("correct").replace("    /* insert: pose maps */\n", "".join(maps)),
        ),
        effects.notes,
        effects.channels,
        plays,
    )


@cache
def _parts() -> dict[str, str]:
    """{name: text} of the parts of the C files of this folder."""
    names = ("", "field_", "arm_", "pose_")
    text = "".join(files(__package__).joinpath(f"controller_{name}parts.c").read_text() for name in names)
    found = re.split(r"^/\* part: (.*) \*/\n", text, flags=re.MULTILINE)
    return dict(zip(found[1::2], found[2::2]))


def c_source_part(name: str) -> str:
    """Text of a part of the C files."""
    return _parts()[name]


def joined_c_parts(*texts: str) -> str:
    """Text of a C file, joined from its parts, empty ones left out."""
    return "\n".join(text.rstrip("\n") + "\n" for text in texts if text)


def c_file_head_interface_and_constants(
    call: CCall, correction: AnyCorrection, effects: EffectsInC, gaps: Floats, origin: str
) -> tuple[str, str, str]:
    """Opening of a C file: head comment, interface, home and channels.

    Its head comment, its interface, home and channels.
    gaps : (axes,) m or rad, play
    """
    home = mechanisms.kinematics_of(correction.nominal).home_values(correction.nominal)
    interface = f"enum {{ RIG_AXES = {len(home)} }};\n\n{c_source_part('api')}"
    return _head(call, correction, effects, gaps, origin), interface, _constants(effects.channels, home)


def _head(call: CCall, correction: AnyCorrection, effects: EffectsInC, gaps: Floats, origin: str) -> str:
    """Head comment: what the file computes, and how it is called."""
    places, units = mechanisms.axis_place_texts(correction.nominal), mechanisms.axis_units(correction.nominal)
    ways = [
        *(f"remainder of {place}" for place, part in zip(places, correction.remainder) if part is not None),
        *([] if correction.extension is None else [f"extension {correction.extension.kind!r}"]),
        *(f"map {one.field.kind!r} in pose space" for one in correction.posed),
    ]
    listed = [f"    channels[{i}] {name}" for i, name in enumerate(effects.channels)]
    play = [f"{place} {gap * 1e6:.3f} u{unit}" for place, gap, unit in zip(places, gaps.tolist(), units) if gap]
    lines = [
        call.title,
        f"Made by {origin}",
        "C99, double precision, <math.h> only. Nothing is allocated, every loop is bounded.",
        "",
        f"int rig_start(struct rig_state *state, const double {call.commands}[{len(places)}]);",
        call.prototype,
        "",
        *call.arguments,
        f"  state: where the {call.axes}s were commanded to last; 0 is allowed where no {call.axes} has play.",
        "    rig_start sets it to where they stand, in the middle of their play, or for 0 to home (rig_home)",
        "  channels: sensor values, degrees Celsius, in this order",
        *(listed or ["    none: channels may be 0"]),
        *(["    not measured: pass rig_channel_medians, medians of the recording"] if listed else []),
        "  calls are in the order of the moves, each held until the machine has come to rest",
        "",
        "Returned:",
        f"  0 RIG_OK: {call.commands} are written, and the state moved on: command these, or restore the state",
        f"  1 RIG_BAD_POSE: a number of {call.wanted} is not finite",
        f"  2 RIG_OUT_OF_STROKE: a corrected {call.axes} leaves its range",
        f"  3 RIG_NOT_CONVERGED: no {call.commands} were found within the bounded number of iterations",
        "  4 RIG_SENSOR_MISSING: channels are absent, or one is not finite",
        f"  5 RIG_NO_STATE: the state is absent or not finite, and a {call.axes} has play",
        f"  Where it is not 0, neither {call.commands} nor state are changed.",
        "",
        f"Over the configuration space: {'; '.join(ways) or 'the fitted geometry alone'}",
        f"Effects: {', '.join(correction.physics) or 'none'}",
        f"Play: {', '.join(play) or 'none'}",
        *effects.notes,
    ]
    return "/*\n" + "\n".join(f" * {line}".rstrip() for line in lines).replace("*/", "* /") + "\n */\n"


def _constants(channels: dict[str, float], home: Floats) -> str:
    """Definitions of the home commands (m or rad) and of the channels with their medians."""
    lines = [
        "extern const double rig_home[RIG_AXES];",
        f"const double rig_home[RIG_AXES] = {{{', '.join(map(repr, home.tolist()))}}};",
        "",
    ]
    if channels:
        lines += [
            "enum {",
            *(f"    RIG_{name.upper()}," for name in channels),
            "    RIG_CHANNELS",
            "};",
            "extern const double rig_channel_medians[RIG_CHANNELS];",
            "const double rig_channel_medians[RIG_CHANNELS] = {",
            *c_number_lines([repr(median) for median in channels.values()]),
            "};",
        ]
    else:
        lines.append("enum { RIG_CHANNELS = 0 };")
    return "\n".join(lines)


def controller_terms_of_compensable_effects(correction: AnyCorrection, physics: Physics | None) -> EffectsInC:
    """Controller terms (EffectsInC) of effects that commands can compensate.

    Raises RigError for one that has no such form, and for two plays of an axis.
    """
    places = mechanisms.axis_place_texts(correction.fitted)
    effects = () if physics is None else physics.compensable_effects()
    if physics is None or not effects:
        return EffectsInC((), {}, np.zeros(len(places)))
    design, home = (
        physics.machine(correction.fitted),
        mechanisms.kinematics_of(correction.fitted).home_values(correction.fitted),
    )
    motion = motion_of_commands(design, Commands(np.zeros(1), home[None]), np.zeros(1))
    found = [effect.in_controller(motion) for effect in effects]
    lacking = [f"{e.label()} at {e.place}" for e, term in zip(effects, found) if term is None]
    if lacking:
        raise RigError(
            f"no C file states {', '.join(lacking)}, which this calibration compensates; use `rig correct`, or a "
            "calibration without it"
        )
    terms = tuple(term for term in found if term is not None)
    channels = tuple(dict.fromkeys(name for term in terms for name in term.channels))
    wrong = [name for name in channels if not NAME.fullmatch(name)]
    if wrong:
        raise RigError(f"the sensor channel {wrong[0]!r} is no name in C: letters, digits and _ only")
    every = np.array([term.gaps for term in terms if term.gaps]).reshape(-1, len(places))
    twice = np.flatnonzero((every > 0).sum(axis=0) > 1)
    if len(twice):
        raise RigError(f"{places[twice[0]]} has two plays in this calibration, which no C file states")
    return EffectsInC(terms, {name: float(physics.channels[name][0]) for name in channels}, every.sum(axis=0))


def effect_compensation_c_functions(effects: EffectsInC) -> tuple[str, ...]:
    """C functions that compensate effects in commands."""
    if not effects.terms:
        return (c_source_part("no effects"),)
    statements = [line for term in effects.terms for line in term.statements]
    used = "\n".join(statements)
    unused = [name for name in ("c", "tip", "channels", "d") if not re.search(rf"\b{name}\[", used)]
    lines = [
        "/* What the axes do beyond what is commanded, c (m or rad), but for play. */",
        "static void add_deviations(const double c[RIG_AXES], const double tip[6][3], const double *channels, "
        "double d[RIG_AXES])",
        "{",
        *(f"    (void){name};" for name in unused),
        *(f"    {line}" for line in statements),
        "}",
    ]
    return "\n".join(lines), c_source_part("effects")


def append_add_remainder_if_any(tables: CTables, extension: Field | None, axis_functions: list[list[str]]) -> bool:
    """Append the C function add_remainder where there is a remainder; return whether there is.

    It is the residual correction over joint space.
    axis_functions : names of the functions that add the remainder of each axis that has one
    Returns whether there is any
    """
    names = [name for names in axis_functions for name in names]
    if extension is not None:
        names += define_c_functions_of_field(tables, extension)
    if names:
        tables.lines += [
            "/* The summand over the configuration space at commands x, m or rad. */",
            "static void add_remainder(const double *x, double *out)",
            "{",
            *(f"    {name}(x, 1.0, out);" for name in names),
            "}",
            "",
        ]
    return bool(names)


def _pose_maps(tables: CTables, correction: AnyCorrection) -> list[str]:
    """Define the maps in pose space; returns the statements that undo them, the last first."""
    statements = []
    for one in reversed(correction.posed):
        if one.coordinates != tuple(range(6)):
            raise RigError("a map in pose space over fewer than six coordinates is in no C file")
        number = tables.number()
        names = define_c_functions_of_field(tables, one.field)
        tables.function(f"map_{number}", *(f"{name}(x, weight, out);" for name in names))
        tables.array(f"home_{number}", one.home.rotation.as_matrix(), shape="[3][3]")
        statements.append(
            f"    status = compensate(map_{number}, home_{number}, &T);\n"
            "    if (status != RIG_OK)\n        return status;\n"
        )
    return statements
