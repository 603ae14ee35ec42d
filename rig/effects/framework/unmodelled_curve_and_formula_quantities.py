"""Smooth curve as an unmodelled effect, and quantities that a formula may use.

A curve stands for what no effect of the catalogue explains: over time, travel, a loop or a sensor. Curves act as
effects do, and are stored with a calibration as such; no search for names knows of them. A quantity of a machine's
motion has name, unit, values and Python code.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from rig.effects.framework.effect_base_class import REFERENCE_TEMPERATURE, Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion, play_deviation
from rig.effects.framework.parameters_covariates_and_marker_table import COUNT, Context, Linear, Node, Parameter
from rig.model.arm_hands_effect_places_and_tolerances import AXES

POSE = ("x", "y", "z", "rx", "ry", "rz")
OWN = ("own travel", "own step", "own direction", "own speed", "own way", "own load")


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """name : as people read it; symbol : as Python does; unit : "" for a sign; code : Python that gives it of a
    `motion`
    values : the same as a function, (n, axes) where each axis has its own, else (n, 1); apart : how to see what depends
        on it, in words
    powers : the greatest that makes sense; waves : whether a sinusoid of it does; on_pose : whether it depends on the
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
    on_pose: bool = False
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
            on_pose=True,
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
        on_pose=True,
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


TIME, TRAVEL, HISTORY = "time", "recent_travel", "history"
OWN_COVARIATES = (TIME, TRAVEL, HISTORY, *POSE)  # covariates that are no sensor's
PREFIX = "unmodelled_over_"
FINER = 1.5  # power of its number by which a function is smaller than the first
ROOM = 0.05  # of the recorded span, by which a covariate may lie beyond it
TERMS = 8  # functions of a curve
PLAYS = 8  # of a loop, each half as wide as the next
REACHES = (0.02, 0.1, 0.5)  # shares of the recorded travel that the widest play takes
FADES = (0.01, 0.03, 0.1, 0.3)  # shares of the recorded time that travel is remembered for; longer, and it is the time
LAGS = (0.0, 0.01, 0.03, 0.1, 0.3)  # shares of the recorded time by which the metal follows a sensor
LEAST = 1e-9  # of a covariate's greatest value, by which it must vary


@dataclass(frozen=True, slots=True)
class UnmodelledCurve(Effect):
    """Deviation size * sum(coefficients * functions): cosines of a covariate within low .. high, ever finer and
    smaller; or, over the history, plays of half widths from low to high, alike and growing along the travel.
    memory : s that travel is remembered for, or by which the metal follows a sensor.
    """

    place: str
    low: float = 0.0
    high: float = 1.0
    memory: float = 0.0
    size: float = 0.0
    coefficients: tuple[float, ...] = ()
    over: ClassVar[str] = ""
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("low", "", (-np.inf, np.inf), (0, 1), role="choice"),
        Parameter("high", "", (-np.inf, np.inf), (0, 1), role="choice"),
        Parameter("memory", "s", (0, np.inf), (0, 1), role="choice"),
        Parameter("size", "", (0, 1), (1e-6, 1e-3), role="choice"),
        Parameter("coefficients", "", (-100, 100), (0.01, 1 / 3), 0),  # a normal prior of standard deviation 1 each
    )
    experiment: ClassVar = "what the {axis}'s residual follows, changed alone while the poses repeat"
    action: ClassVar = "Look for the cause at the {axis}; until it has a name, a curve undoes it as recorded."

    def __reduce__(self) -> tuple[object, ...]:
        return _restored, (self.over, self.place, self.values())

    def needs(self, motion: Motion) -> str | None:
        return None if self.over in OWN_COVARIATES else motion.no_channel(self.over)

    def forgets(self) -> float:
        return 2 * self.high if self.over == HISTORY and self.size else 0.0

    def deviation(self, motion: Motion) -> Floats:
        out, terms = np.zeros(motion.lengths.shape), self.size * np.asarray(self.coefficients)
        for i in np.flatnonzero(self.axes(motion.places)).tolist() if terms.any() else ():
            out[:, i] = self.functions(motion, i)[:, : len(terms)] @ terms
        return out

    def functions(self, motion: Motion, axis: int) -> Floats:
        """(n, q) functions of which the curve at an axis is a sum; zeros where the covariate is not covered and nothing
        can be held."""
        if self.over == HISTORY:
            widths = np.geomspace(self.low, self.high, PLAYS)
            loops = np.stack([play_deviation(motion, w)[:, axis] / w for w in widths], axis=1)
            reach = float(np.ptp(motion.kind.travel_ranges(motion.mechanism)[axis]))  # endless of some joints
            return np.concatenate([loops, loops * motion.stroke[:, [axis]] * (2 / reach)], axis=1)
        u = np.clip((self._covariate(motion, axis) - self.low) / (self.high - self.low), 0.0, 1.0)
        order = np.arange(1, TERMS + 1)
        out = np.cos(np.pi * u[:, None] * order) / order**FINER
        if self.over == TIME:  # what it does at other times, nobody knows; elsewhere it stays as at its end
            out[self._beyond(motion, axis)] = 0.0
        return out

    def uncovered(self, motion: Motion) -> Floats:
        out = np.zeros(motion.lengths.shape)
        order = np.arange(1, len(self.coefficients) + 1)
        usual = self.size * float(np.linalg.norm(np.asarray(self.coefficients) / order**FINER)) / np.sqrt(2)
        for i in np.flatnonzero(self.axes(motion.places)).tolist() if self.over != HISTORY else ():
            out[self._beyond(motion, i), i] = usual
        return out

    def _beyond(self, motion: Motion, axis: int) -> Booleans:
        """(n,) bool, exposures where the covariate is beyond what was recorded."""
        x, room = self._covariate(motion, axis), ROOM * (self.high - self.low)
        return (x < self.low - room) | (x > self.high + room)

    def _covariate(self, motion: Motion, axis: int) -> Floats:
        if self.over == TIME:
            return motion.t - motion.path.began
        if self.over == TRAVEL:
            return motion.recent_travel(self.memory)[:, axis]
        if self.over in POSE:
            return motion.displaced[:, POSE.index(self.over)]
        return motion.lagged_channel(self.memory, self.over)

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        motion = context.moved()
        if any(cls.over.startswith(f"{other.replace(' ', '')}_") for other in motion.places if other != place):
            return []  # a sensor of another axis
        if cls.over in POSE and motion.kind.AXIS != "strut":
            return []  # an arm's geometry has too much to say of where its hand is
        axis, span = motion.places.index(place), float(np.ptp(motion.t))
        if cls.over == HISTORY:
            travel = float(np.ptp(motion.lengths[:, axis]))
            nodes: list[Node] = [
                {"low": share * travel / 2.0 ** (PLAYS - 1), "high": share * travel} for share in REACHES if travel > 0
            ]
            count = 2 * PLAYS
        else:
            shares, count = {TRAVEL: FADES, **dict.fromkeys((TIME, *POSE), (0.0,))}.get(cls.over, LAGS), TERMS
            nodes = []
            for memory in (share * span for share in shares):
                x = cls(place, memory=memory)._covariate(motion, axis)
                if np.ptp(x) > LEAST * np.abs(x).max():
                    nodes.append({"low": float(x.min()), "high": float(x.max()), "memory": memory})
        linear = [Linear("coefficients", k, 1.0) for k in range(count)]
        return [Candidate(cls, place, [{**node, COUNT: count}], linear) for node in nodes]

    @classmethod
    def columns(cls, candidate: Candidate, node: Node, motion: Motion) -> Floats:
        own = cls(candidate.place, **{name: value for name, value in node.items() if name != COUNT})
        axis = motion.places.index(candidate.place)
        out = np.zeros((*motion.lengths.shape, node[COUNT]))
        out[:, axis] = own.functions(motion, axis)
        return out

    @classmethod
    def label(cls) -> str:
        return f"a curve over {_words(cls.over)}"


def _words(over: str) -> str:
    return over.replace("_", " ")


def curve_covariate_words(effect: Effect) -> str:
    """Words for the covariate of a curve as an effect."""
    return _words(effect.name.removeprefix(PREFIX))


def _restored(over: str, place: str, values: Mapping[str, object]) -> UnmodelledCurve:
    return curve_class_over_covariate(over)(place, **values)  # type: ignore[arg-type]


@cache
def curve_class_over_covariate(covariate: str) -> type[UnmodelledCurve]:
    """Class of the curves over a covariate.

    TIME, TRAVEL, HISTORY, one of POSE or a sensor channel.
    """
    own = {
        "__slots__": (),
        "over": covariate,
        "name": PREFIX + covariate,
        "on_pose": covariate in POSE,
        "sudden": covariate == TIME,
    }
    return type("UnmodelledCurve", (UnmodelledCurve,), own)


def curve_classes_by_covariate(channels: tuple[str, ...]) -> dict[str, type[UnmodelledCurve]]:
    """Curve classes by covariate, {name: class}.

    Those that sensor channels allow, those over time and motion among them. A channel that is called like one of these
    has none.
    """
    return {kind.name: kind for kind in map(curve_class_over_covariate, dict.fromkeys((*OWN_COVARIATES, *channels)))}
