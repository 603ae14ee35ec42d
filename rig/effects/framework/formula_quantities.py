"""Quantities that a formula may use.

Of a machine's motion: name, unit, values and Python code of each.
"""

from collections.abc import Callable
from dataclasses import dataclass

from rig.array_and_json_types import Floats
from rig.effects.framework.effect import REFERENCE_TEMPERATURE
from rig.effects.framework.machine_motion_and_play import Motion
from rig.model.hands_places_and_tolerances import AXES

POSE = ("x", "y", "z", "rx", "ry", "rz")
OWN = ("own travel", "own step", "own direction", "own speed", "own way", "own load")


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """name : as people read it; symbol : as Python does; unit : "" for a sign; code : Python that gives it of a
    `motion`
    values : the same as a function, (n, axes) where each axis has its own, else (n, 1); apart : how to see what depends
        on it, in words
    powers : the greatest that makes sense; waves : whether a sinusoid of it does; posed : whether it depends on the
        pose
    lacking : Python that says why a `motion` lacks it, or None, "" for what none lacks"""

    name: str
    symbol: str
    unit: str
    code: str
    values: Callable[[Motion], Floats]
    apart: str
    powers: int = 3
    waves: bool = False
    posed: bool = False
    lacking: str = ""


def quantity_by_name(name: str, axis_word: str) -> Quantity:
    """The Quantity of a name on a machine.

    Its axes are called axis_word (strut, joint, slide); or a channel.
    """
    unit = "rad" if axis_word == "joint" else "m"
    if name in OWN:
        return _own(name, unit, axis_word)
    if name in POSE:
        i = POSE.index(name)
        return Quantity(
            name,
            name,
            "m" if i < 3 else "rad",
            f"motion.displaced[:, [{i}]]",
            lambda m: m.displaced[:, [i]],
            f"move the platform {'along' if i < 3 else 'about'} {name[-1]} alone",
            waves=True,
            posed=True,
        )
    if name == "time":
        return Quantity(
            name,
            "t",
            "s",
            "motion.t[:, None]",
            lambda m: m.t[:, None],
            "return to the same poses repeatedly",
            waves=True,
        )
    kind, _, number = name.removeprefix("travel of ").partition(" ")
    if name.startswith("travel of ") and kind in AXES and number.isdigit():
        i = int(number) - 1
        return Quantity(
            name,
            f"q{i + 1}",
            "m" if kind != "joint" else "rad",
            f"motion.stroke[:, [{i}]]",
            lambda m: m.stroke[:, [i]],
            f"move {kind} {number} over its whole travel, the others still",
            waves=True,
            lacking=f'None if len(motion.places) > {i} else "takes {i + 1} axes"',
        )
    warm = name.endswith("temperature_C")
    zero = REFERENCE_TEMPERATURE if warm else 0.0
    code = f"motion.channel({name!r})[:, None]" + (" - REFERENCE_TEMPERATURE" if warm else "")
    return Quantity(
        name,
        _symbol(name),
        "K" if warm else "kg" if name.endswith("_kg") else "unit",
        code,
        lambda m: m.channel(name)[:, None] - zero,
        f"let {name} change while the poses repeat",
        2,
        lacking=f"motion.no_channel({name!r})",
    )


def _own(name: str, unit: str, word: str) -> Quantity:
    if name == "own travel":
        return Quantity(
            name, "q", unit, "motion.stroke", lambda m: m.stroke, f"move that {word} over its whole travel", waves=True
        )
    if name == "own step":
        return Quantity(
            name,
            "step",
            unit,
            "motion.path.last_step",
            lambda m: m.path.last_step,
            "approach by small and by large steps",
            2,
        )
    if name == "own direction":
        return Quantity(
            name, "direction", "", "motion.path.direction", lambda m: m.path.direction, "approach from both sides", 1
        )
    if name == "own speed":
        return Quantity(
            name,
            "speed",
            f"{unit}/s",
            "motion.path.speed",
            lambda m: m.path.speed,
            "expose during motion at several speeds",
            2,
        )
    if name == "own way":
        return Quantity(
            name,
            "way",
            unit,
            "motion.path.way",
            lambda m: m.path.way,
            f"move that {word} to and fro between the same poses",
            2,
        )
    return Quantity(
        name,
        "load",
        "N m" if unit == "rad" else "N",
        "motion.loads()",
        lambda m: m.loads(),
        "change the payload",
        2,
        posed=True,
        lacking="motion.no_loads()",
    )


def quantities_of_motion(motion: Motion, per_axis: bool) -> list[Quantity]:
    """Quantities of a Motion.

    Per axis, or of the platform's pose; with time and logged channels.
    """
    word = motion.kind.AXIS
    names = [name for name in OWN if name != "own load" or motion.no_loads() is None] if per_axis else []
    names += [f"travel of {place}" for place in motion.places] if per_axis else []
    names += list(POSE) if word == "strut" else []
    names += ["time", *(motion.sensors.channels if motion.sensors is not None else ())]
    return [quantity_by_name(name, word) for name in names]


def _symbol(name: str) -> str:
    """A channel's name as one of Python's."""
    plain = "".join(c if c.isalnum() and c.isascii() else "_" for c in name.removesuffix("_C").lower())
    return f"logged_{plain}"
