"""The catalogue for a terminal and for programs: what `rig effects` shows."""

import textwrap
from collections.abc import Iterable
from typing import Any

from rig.effects.framework.effect import AXES, Effect
from rig.effects.framework.parameter import Parameter
from rig.effects.framework.place_names import axis_neutral_text
from rig.formats.number_rounding import range_text

HEADS = ("name", "stage", "sits at", "parameters, usual size", "exposed by", "what to do")
SHARES = (0.14, 0.08, 0.1, 0.21, 0.24, 0.23)  # of the width, by column
NARROWEST = 100  # characters, below which columns are no longer read


def effect_dict(effect: type[Effect]) -> dict[str, Any]:
    """One effect as a tree of plain values; a parameter's usual size and bounds are in its unit."""
    return {
        "name": effect.name,
        "stage": effect.stage,
        "places": list(effect.places),
        "model": _flat(effect.__doc__ or ""),
        "parameters": [_parameter(p) for p in effect.parameters],
        "exposed_by": _said(effect.experiment),
        "action": _said(effect.action),
    }


def effect_table(effects: Iterable[type[Effect]], width: int) -> str:
    """Effects as a table, a row each, wrapped. width : characters of a line"""
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
                    _said(effect.experiment),
                    _said(effect.action),
                ),
                widths,
            ),
        ]
    return "\n".join(lines) + "\n"


def effect_description(effect: type[Effect], width: int) -> str:
    """All of one effect, for a terminal. width : characters of a line"""
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
        f"Exposed by: {_said(effect.experiment)}",
        f"What to do: {_said(effect.action)}",
        f"To simulate it: rig simulate RIG.toml {first}",
    ]
    return (
        "\n".join(textwrap.fill(part, width, subsequent_indent="    ", break_on_hyphens=False) for part in parts) + "\n"
    )


def _parameter(p: Parameter) -> dict[str, Any]:
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


def _said(text: str) -> str:
    return _flat(axis_neutral_text(text))


def _flat(text: str) -> str:
    return " ".join(text.split())
