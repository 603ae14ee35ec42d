"""The catalogue as a page, made from the effects themselves, as `rig catalogue` writes it."""

from collections.abc import Iterable, Mapping

import numpy as np

from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect import AXES, Effect
from rig.effects.framework.parameter import Parameter
from rig.effects.framework.place_names import axis_neutral_text
from rig.formats.number_rounding import range_text

STAGES = {
    "command": "what the axes are told, and when",
    "struts": "what the axes do beyond their command",
    "structure": "what the frame and the platform do",
    "targets": "where markers sit",
    "view": "what a camera makes of it",
}
HEAD = """# The catalogue of left-out physics

This page is made from the effects themselves (`rig catalogue`). An effect is one file in `rig/effects`: its model, its
parameters, the places where it can sit, what is tried of it, what shows it, the experiment that would expose it and \
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
that makes struts pull. Grey is what was told, orange what is done, with errors enlarged; below, the error over what \
gives the effect away, as a
diagnosis draws residuals. What a camera sees is drawn over its whole image, at the end of the time below it: grey the \
markers as stated, orange
as seen, near ones (large) and farther ones, a stroke at each marker's first corner.
"""


def catalogue_markdown(effects: Iterable[type[Effect]] = ALL, sketches: Mapping[str, str] | None = None) -> str:
    """The catalogue in Markdown, stage by stage. sketches : {name: Markdown of the sketch}, where there are any"""
    found, drawn = list(effects), sketches or {}
    parts = [HEAD, SKETCHED if drawn else ""]
    for stage, meaning in STAGES.items():
        members = [effect for effect in found if effect.stage == stage]
        if members:
            parts.append(f"\n## {stage.capitalize()}: {meaning}\n")
            parts += [effect_markdown(effect, drawn.get(effect.name, "")) for effect in members]
    return "".join(parts)


def effect_markdown(effect: type[Effect], sketch: str = "") -> str:
    """One effect's part of the page. sketch : Markdown"""
    rows = [parameter_markdown_row(p, effect) for p in effect.parameters]
    return (
        f"\n### {effect.name}\n\n{_prose(effect.__doc__ or '')}\n\n"
        f"Sits at: {', '.join(_place(kind) for kind in effect.places)}.\n\n"
        + (f"{sketch}\n\n" if sketch else "")
        + "| parameter | unit | what rigs show | bounds | at a joint |\n|---|---|---|---|---|\n"
        + "\n".join(rows)
        + "\n\n"
        f"Shown by: {axis_neutral_text(effect.experiment)}.\n\nWhat to do: {axis_neutral_text(effect.action)}\n"
    )


def parameter_markdown_row(p: Parameter, effect: type[Effect]) -> str:
    """One parameter as a row of the table."""
    name = p.name if p.size == 1 else f"{p.name} ({p.size or 'any'})"
    joint = p.at(f"{AXES[1]} 1")
    turned = range_text(*joint.usual, joint.unit) if joint is not p and p.role != "choice" else ""
    usual = "" if p.role in ("choice", "moment") else range_text(*p.usual, p.unit)
    bounds = "" if np.isinf(p.bounds[0]) else range_text(*p.bounds, p.unit)
    return f"| {name} | {p.unit} | {usual} | {bounds} | {turned} |"


def _place(kind: str) -> str:
    return {
        "axis": "`strut N` or `joint N`",
        "camera": "`camera NAME`",
        "marker": "`marker ID`",
        "target": "`target NAME`",
    }.get(kind, f"`{kind}`")


def _prose(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
