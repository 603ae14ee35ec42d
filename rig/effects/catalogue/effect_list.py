"""List of all effects.

A file and a line here add one everywhere. Effects are described as text, JSON and Markdown.
"""

import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Json
from rig.effects.catalogue.axis_coupling import AxisCoupling
from rig.effects.catalogue.backlash import Backlash
from rig.effects.catalogue.base_expansion import BaseExpansion
from rig.effects.catalogue.base_lean import BaseLean
from rig.effects.catalogue.base_lean import lean_under_link_weight as lean_under_link_weight
from rig.effects.catalogue.camera_bump import CameraBump
from rig.effects.catalogue.camera_drift import CameraDrift
from rig.effects.catalogue.camera_sag import CameraSag
from rig.effects.catalogue.clock_drift import ClockDrift
from rig.effects.catalogue.compliance import Compliance
from rig.effects.catalogue.creep import Creep
from rig.effects.catalogue.cube_misplacement import CubeMisplacement
from rig.effects.catalogue.cyclic_error import CyclicError
from rig.effects.catalogue.edge_bias import EdgeBias
from rig.effects.catalogue.encoder_interpolation import EncoderInterpolation
from rig.effects.catalogue.face_misplacement import FaceMisplacement
from rig.effects.catalogue.focal_drift import FocalDrift
from rig.effects.catalogue.hysteresis import Hysteresis
from rig.effects.catalogue.joint_clearance import JointClearance
from rig.effects.catalogue.joint_offset import JointOffset
from rig.effects.catalogue.lens_distortion import LensDistortion
from rig.effects.catalogue.link_bending import LinkBending
from rig.effects.catalogue.marker_flatness import MarkerFlatness
from rig.effects.catalogue.marker_swap import MarkerSwap
from rig.effects.catalogue.missed_steps import MissedSteps
from rig.effects.catalogue.print_scale import PrintScale
from rig.effects.catalogue.refraction import Refraction
from rig.effects.catalogue.rolling_shutter import RollingShutter
from rig.effects.catalogue.scale_error import ScaleError
from rig.effects.catalogue.screw_coupling import ScrewCoupling
from rig.effects.catalogue.servo_lag import ServoLag
from rig.effects.catalogue.settling_error import SettlingError
from rig.effects.catalogue.thermal_expansion import ThermalExpansion
from rig.effects.catalogue.time_offset import TimeOffset
from rig.effects.catalogue.transmission_error import TransmissionError
from rig.effects.catalogue.travel_heating import TravelHeating
from rig.effects.catalogue.vibration import Vibration
from rig.effects.catalogue.warm_up import WarmUp
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Parameter, replace_axis_placeholder_in_text
from rig.errors import FileError
from rig.formats.numbers_and_units import range_text
from rig.model.arm_hands_effect_places_and_tolerances import AXES, Tolerance

ALL: tuple[type[Effect], ...] = (
    ScaleError,
    CyclicError,
    TransmissionError,
    Backlash,
    Hysteresis,
    MissedSteps,
    ServoLag,
    Creep,
    ThermalExpansion,
    WarmUp,
    ScrewCoupling,
    Compliance,
    JointClearance,
    BaseExpansion,
    Vibration,
    TimeOffset,
    ClockDrift,
    LensDistortion,
    FocalDrift,
    CameraDrift,
    CameraSag,
    CameraBump,
    RollingShutter,
    Refraction,
    EdgeBias,
    PrintScale,
    FaceMisplacement,
    CubeMisplacement,
    MarkerSwap,
    AxisCoupling,
    SettlingError,
    JointOffset,
    TravelHeating,
    MarkerFlatness,
    EncoderInterpolation,
    BaseLean,
    LinkBending,
)
BY_NAME: dict[str, type[Effect]] = {effect.name: effect for effect in ALL}


@dataclass(frozen=True, slots=True, eq=False)
class Plugin:
    """A file of effects. sha256 : of its bytes; kinds : classes of its effects."""

    path: Path
    sha256: str
    kinds: tuple[type[Effect], ...]


def effect_catalogue_with_user_files(plugins: Iterable[Plugin]) -> dict[str, type[Effect]]:
    """Catalogue {name: class} with the effects of user files (plugins) added.

    Raises FileError for a name twice.
    """
    out: dict[str, type[Effect]] = dict(BY_NAME)
    where: dict[str, Path] = {}
    for plugin in plugins:
        for kind in plugin.kinds:
            if kind.name in out:
                from rig.formats.user_python_file_reading_and_running import line_of_class

                raise FileError(
                    plugin.path,
                    f"there is an effect {kind.name!r} already, in {where[kind.name]}",
                    line_of_class(plugin.path.read_text(encoding="utf-8"), kind.__name__),
                )
            out[kind.name], where[kind.name] = kind, plugin.path
    return out


def effect_of_tolerance(tolerance: Tolerance | tuple[float, float]) -> type[Effect]:
    """Effect of the catalogue that corresponds to a manufacturing tolerance.

    The tolerance is exceeded.
    """
    return next(kind for kind in ALL if kind.tolerance == tolerance)


HEADS = ("name", "stage", "sits at", "parameters, usual size", "exposed by", "what to do")
SHARES = (0.14, 0.08, 0.1, 0.21, 0.24, 0.23)  # of the width, by column
NARROWEST = 100  # characters, below which columns are no longer read


def compliance_under_link_weight(place: str, moments: tuple[float, ...]) -> Effect:
    """Compliance (effect) of a joint under the weight of its links.

    Mass and mass moments over its stiffness.
    """
    return Compliance(place, moments=moments)


def mass_and_moments_over_stiffness(effect: Effect) -> tuple[float, ...]:
    """Mass and mass moments over stiffness of an effect.

    Of a `compliance_under_link_weight`; none of any other effect.
    """
    return effect.moments if isinstance(effect, Compliance) else ()


def effect_description_dict(effect: type[Effect]) -> Json:
    """Description of an effect class as a dict of plain values, for JSON.

    Places, parameters, experiment.
    """
    return {
        "name": effect.name,
        "stage": effect.stage,
        "places": list(effect.places),
        "model": _flat(effect.__doc__ or ""),
        "parameters": [_parameter(p) for p in effect.parameters],
        "exposed_by": _flat_text(effect.experiment),
        "action": _flat_text(effect.action),
    }


def effect_table(effects: Iterable[type[Effect]], width: int) -> str:
    """Table of effects as text, a row each, wrapped to a width in characters."""
    widths = [max(8, int(share * max(width, NARROWEST)) - 2) for share in SHARES]
    lines = _row(HEADS, widths)
    for effect in effects:
        sizes = "; ".join(_size(p) for p in effect.parameters)
        lines += [
            "",
            *_row(
                (
                    effect.name,
                    effect.stage,
                    ", ".join(effect.places),
                    sizes,
                    _flat_text(effect.experiment),
                    _flat_text(effect.action),
                ),
                widths,
            ),
        ]
    return "\n".join(lines) + "\n"


def effect_description(effect: type[Effect], width: int) -> str:
    """Description of one effect in full, as text wrapped to a width in characters."""
    parts = [f"{effect.name}, stage {effect.stage}, sits at {', '.join(effect.places)}", _flat(effect.__doc__ or "")]
    for p in effect.parameters:
        joint, ends = (
            p.at(f"{AXES[1]} 1"),
            f", bounds {range_text(*p.bounds, p.unit)}" if p.bounds[0] > -float("inf") else "",
        )
        parts.append(
            f"  {_written(p)}{ends}" + (f"; at a joint{_written(joint).removeprefix(p.name)}" if joint is not p else "")
        )
    first = f"--effect {effect.name}:PLACE:" + ",".join(f"{p.name}=.." for p in effect.parameters)
    parts += [
        f"Exposed by: {_flat_text(effect.experiment)}",
        f"What to do: {_flat_text(effect.action)}",
        f"To simulate it: rig simulate RIG.toml {first}",
    ]
    return (
        "\n".join(textwrap.fill(part, width, subsequent_indent="    ", break_on_hyphens=False) for part in parts) + "\n"
    )


def _parameter(p: Parameter) -> Json:
    return {
        "name": p.name,
        "unit": p.unit,
        "usual": list(p.usual) if _has_usual(p) else None,
        "bounds": list(p.bounds),
        "numbers": p.size,
        "role": p.role,
    }


def _has_usual(p: Parameter) -> bool:
    return p.role not in ("choice", "moment") and all(abs(end) < float("inf") for end in p.usual)


def _size(p: Parameter) -> str:
    return f"{p.name} {range_text(*p.usual, p.unit)}" if _has_usual(p) else p.name + (f" ({p.unit})" if p.unit else "")


def _written(p: Parameter) -> str:
    """A parameter with the unit in which it is written, and its usual size."""
    return (
        p.name + (f", in {p.unit}" if p.unit else "") + (f": {range_text(*p.usual, p.unit)}" if _has_usual(p) else "")
    )


def _row(cells: Iterable[str], widths: list[int]) -> list[str]:
    wrapped = [textwrap.wrap(cell, wide, break_on_hyphens=False) for cell, wide in zip(cells, widths)]
    deep = max(map(len, wrapped))
    return [
        "  ".join((column[k] if k < len(column) else "").ljust(wide) for column, wide in zip(wrapped, widths)).rstrip()
        for k in range(deep)
    ]


def _flat_text(text: str) -> str:
    return _flat(replace_axis_placeholder_in_text(text))


def _flat(text: str) -> str:
    return " ".join(text.split())


STAGES = {
    "command": "axis commands and their times",
    "struts": "what the axes do beyond their command",
    "structure": "what the frame and the platform do",
    "targets": "where markers sit",
    "view": "how a camera images it",
}
HEAD = """# The catalogue of unmodelled effects

This page is made from the effects themselves (`rig effects document`). An effect is one file in `rig/effects`: its
model, its parameters, the places where it can sit, what is tried of it, what shows it, the \
experiment that would expose it and \
what to do about it.
A value of `rig simulate --effect` reads `NAME:PLACE:PARAMETER=VALUE,..` in the parameter's unit, the numbers of a \
vector parted by slashes. An
axis is a strut (m) or a joint (rad); `rig` stands for all axes, `cameras` for all cameras, `markers` for all markers.
"""

SKETCHED = """
A sketch is drawn by the effect's own model, as large as rigs show at the most. What moves the machine does so on a \
hexapod of 0.3 m radius:
strut 3 goes to and fro, farther every time, and rests in between, the other struts swing, all warms by 20 K, and \
halfway a payload is put on
that makes struts pull. What acts on links does so on a UR10 that holds 10 kg, its joints \
swinging.
Grey is what was commanded, orange what is done, with errors enlarged; below, the error over \
what gives the effect away, as a diagnosis draws residuals. What a camera sees is drawn over its whole image, at the \
end of the time below it: grey the markers as stated, orange
as seen, near ones (large) and farther ones, a stroke at each marker's first corner.
"""


def catalogue_markdown(effects: Iterable[type[Effect]] = ALL, sketches: Mapping[str, str] | None = None) -> str:
    """The catalogue of effects in Markdown.

    Stage by stage.
    sketches : {name: Markdown of its sketch}
    """
    found, drawn = list(effects), sketches or {}
    parts = [HEAD, SKETCHED if drawn else ""]
    for stage, meaning in STAGES.items():
        members = [effect for effect in found if effect.stage == stage]
        if members:
            parts.append(f"\n## {stage.capitalize()}: {meaning}\n")
            parts += [_effect_markdown(effect, drawn.get(effect.name, "")) for effect in members]
    return "".join(parts)


def _effect_markdown(effect: type[Effect], sketch: str = "") -> str:
    """One effect's part of the page. sketch : Markdown"""
    rows = [_parameter_markdown_row(p, effect) for p in effect.parameters]
    return (
        f"\n### {effect.name}\n\n{_prose(effect.__doc__ or '')}\n\n"
        f"Sits at: {', '.join(_place(kind, effect.of_links) for kind in effect.places)}.\n\n"
        + (f"{sketch}\n\n" if sketch else "")
        + "| parameter | unit | what rigs show | bounds | at a joint |\n|---|---|---|---|---|\n"
        + "\n".join(rows)
        + "\n\n"
        f"Shown by: {replace_axis_placeholder_in_text(effect.experiment)}.\n\n"
        f"What to do: {replace_axis_placeholder_in_text(effect.action)}\n"
    )


def _parameter_markdown_row(p: Parameter, effect: type[Effect]) -> str:
    """One parameter as a row of the table."""
    name = p.name if p.size == 1 else f"{p.name} ({p.size or 'any'})"
    joint = p.at(f"{AXES[1]} 1")
    turned = range_text(*joint.usual, joint.unit) if joint is not p and p.role != "choice" else ""
    usual = "" if p.role in ("choice", "moment") else range_text(*p.usual, p.unit)
    bounds = "" if np.isinf(p.bounds[0]) else range_text(*p.bounds, p.unit)
    return f"| {name} | {p.unit} | {usual} | {bounds} | {turned} |"


def _place(kind: str, of_links: bool) -> str:
    return {
        "axis": "`joint N` or `slide N`, the link that it moves" if of_links else "`strut N` or `joint N`",
        "camera": "`camera NAME`",
        "marker": "`marker ID`",
        "target": "`target NAME`",
    }.get(kind, f"`{kind}`")


def _prose(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
