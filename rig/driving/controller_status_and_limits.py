"""Controller status and limits, as the controller reports them.

Limits are of travel, speed and acceleration; a warning names those that are tighter than the rig.toml's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import SHOWN, value_text
from rig.errors import FileError, Unreachable
from rig.formats.local_and_remote_input_files import read_bytes
from rig.formats.numbers_and_units import parse_number
from rig.model import mechanisms
from rig.model.design import Controller
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, has_struts

SLACK = 1e-3  # share by which figures may differ, as controllers print them rounded
EDGE = 1e-5  # m by which a goal may pass a travel's end, for the same reason
INI_UNITS = {"mm": 1e-3, "metric": 1e-3, "cm": 1e-2, "inch": 0.0254, "in": 0.0254, "imperial": 0.0254}  # m
INI_ANGLES = {  # rad
    **dict.fromkeys(("deg", "degree"), np.pi / 180),
    **dict.fromkeys(("rad", "radian"), 1.0),
    **dict.fromkeys(("grad", "gon"), np.pi / 200),
}
INI_TYPES = {"m": "LINEAR", "rad": "ANGULAR"}  # of joints


@dataclass(frozen=True, slots=True, eq=False)
class ControllerLimits:
    """What a controller allows; NaN where it does not say.

    travel : (n, 2) m or rad as it counts; span : (n,) length of the travel, also where its ends are not said
    speed : (n,) m/s or rad/s; acceleration : (n,) m/s^2 or rad/s^2; travel_name, speed_name, acceleration_name : of its
    settings, for messages
    """

    travel: Floats
    span: Floats
    speed: Floats
    acceleration: Floats
    travel_name: str
    speed_name: str
    acceleration_name: str


def tighter_controller_limit_warnings(
    limits: ControllerLimits, controller: Controller, mechanism: Commanded
) -> list[str]:
    """Warnings of controller limits tighter than the rig.toml's.

    A line for each kind of limit, with both figures of the axis that it concerns most.
    """
    lines, ranges = [], mechanisms.kinematics_of(mechanism).travel_ranges(mechanism)
    places, units = mechanisms.axis_place_texts(mechanism), mechanisms.axis_units(mechanism)
    own_range = "strut_range" if has_struts(mechanism) else "its range"
    low, high = (limits.travel + controller.zero[:, None]).T
    short = np.fmax(low - ranges[:, 0], ranges[:, 1] - high)
    if (short > EDGE).any():
        i = int(np.nanargmax(short))
        scale, unit = SHOWN[units[i]]
        lines.append(
            f"{places[i]}: the controller goes from {low[i] * scale:.3f} to {high[i] * scale:.3f} {unit} "
            f"({limits.travel_name}), {own_range} from {ranges[i, 0] * scale:.3f} to {ranges[i, 1] * scale:.3f} "
            f"{unit}: it refuses what lies beyond"
        )
    elif ((lacking := np.ptp(ranges, axis=1) - limits.span) > EDGE).any():
        i = int(np.nanargmax(lacking))
        lines.append(
            f"{places[i]}: the controller travels {value_text(limits.span[i], units[i])} ({limits.travel_name}), "
            f"{own_range} is {value_text(np.ptp(ranges[i]), units[i])} long: it refuses what lies beyond"
        )
    for name, stated, own, setting, per in (
        ("max_speed", controller.max_speed, limits.speed, limits.speed_name, "/s"),
        ("max_acceleration", controller.max_acceleration, limits.acceleration, limits.acceleration_name, "/s^2"),
    ):
        if stated is None or not (stated > own * (1 + SLACK)).any():
            continue
        i = int(np.nanargmax(stated / own))
        scale, unit = SHOWN[units[i]]
        lines.append(
            f"{places[i]}: the controller allows {own[i] * scale:.6g} {unit}{per} ({setting}), {name} is "
            f"{stated[i] * scale:.6g} {unit}{per}: it lowers what exceeds its own, and moves take longer than stated"
        )
    return lines


def require_goals_within_limits(limits: ControllerLimits, goals: Floats, zero: Floats, mechanism: Commanded) -> None:
    """Raise Unreachable for goals (k, n) m or rad outside the controller's limits.

    zero : (n,) m or rad, where it counts 0
    """
    places, units = mechanisms.axis_place_texts(mechanism), mechanisms.axis_units(mechanism)
    low, high = (limits.travel + zero[:, None]).T
    beyond = np.fmax(low - goals, goals - high)
    index = np.flatnonzero((beyond > EDGE).any(axis=1))
    if len(index):
        worst = [int(np.nanargmax(beyond[k])) for k in index]
        raise Unreachable(
            f"{len(index)} of {len(goals)} goals lie beyond the controller's own travel ({limits.travel_name}); "
            "nothing has moved:",
            index,
            [
                f"goal {k + 1}: {places[i]} to {value_text(goals[k, i], units[i])}, the controller goes from "
                f"{value_text(low[i], units[i])} to {value_text(high[i], units[i])}"
                for k, i in zip(index, worst)
            ],
        )
    needed = np.ptp(goals, axis=0)
    if (needed - limits.span > EDGE).any():
        i = int(np.nanargmax(needed - limits.span))
        raise Unreachable(
            "the goals lie further apart than the controller travels; nothing has moved:",
            [int(np.argmax(goals[:, i]))],
            [
                f"{places[i]} needs {value_text(needed[i], units[i])}, the controller travels "
                f"{value_text(limits.span[i], units[i])} ({limits.travel_name})"
            ],
        )


def limits_of_linuxcnc_ini(path: Path, axis_units: Sequence[str]) -> ControllerLimits:
    """Limits (ControllerLimits) of the joints in a LinuxCNC .ini file.

    Those of joints 0 .. n - 1, in its units; angles are in degrees where it names none.

    axis_units : "m" or "rad" of each
    Raises FileError for one that cannot be read, and for a joint whose TYPE is the other.
    """
    sections: dict[str, dict[str, str]] = {}
    entries: dict[str, str] = {}
    for line in read_bytes(path).decode("utf-8", "replace").splitlines():
        text = line.partition("#")[0].partition(";")[0].strip()
        if text.startswith("[") and text.endswith("]"):
            entries = sections.setdefault(text[1:-1].strip().upper(), {})
        elif "=" in text:
            name, _, value = text.partition("=")
            entries.setdefault(name.strip().upper(), value.strip())  # of several, LinuxCNC takes the first

    def unit_size(name: str, default: str, known: dict[str, float]) -> float:
        word = sections.get("TRAJ", {}).get(name, default).lower()
        if word not in known:
            raise FileError(path, f"[TRAJ] {name} = {word!r} is none of {', '.join(known)}")
        return known[word]

    sizes = {"m": unit_size("LINEAR_UNITS", "mm", INI_UNITS), "rad": unit_size("ANGULAR_UNITS", "degree", INI_ANGLES)}
    scales = [sizes[unit] for unit in axis_units]
    for joint, unit in enumerate(axis_units):
        stated = sections.get(f"JOINT_{joint}", {}).get("TYPE", INI_TYPES[unit])
        if stated.upper() != INI_TYPES[unit]:
            raise FileError(
                path, f"[JOINT_{joint}] TYPE = {stated}, but the rig.toml's axis {joint + 1} counts in {unit}"
            )

    def figures(name: str) -> Floats:
        found = []
        for joint, unit in enumerate(scales):
            text = sections.get(f"JOINT_{joint}", {}).get(name)
            try:
                found.append(np.nan if text is None else unit * parse_number(text))
            except ValueError:
                raise FileError(path, f"[JOINT_{joint}] {name} = {text!r} is no number") from None
        return np.array(found)

    travel = np.stack([figures("MIN_LIMIT"), figures("MAX_LIMIT")], axis=1)
    return ControllerLimits(
        travel,
        travel[:, 1] - travel[:, 0],
        figures("MAX_VELOCITY"),
        figures("MAX_ACCELERATION"),
        "MIN_LIMIT, MAX_LIMIT of its ini",
        "MAX_VELOCITY of its ini",
        "MAX_ACCELERATION of its ini",
    )


@dataclass(frozen=True, slots=True, eq=False)
class ControllerStatus:
    """activity : as rig.driving.protocols.protocol_interface_and_user_line_protocol.State
    lengths : (n,) m or rad; known : whether the lengths can be believed; fault, controller_text : text
    homing_required : as of a State
    """

    activity: str
    lengths: Floats
    known: bool
    fault: str
    controller_text: str
    homing_required: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FinishedMove:
    """A move that is done. lengths : (n,) m, as read back; start_time, ended : s on the clock; note : what went wrong
    on the way, or "".
    """

    lengths: Floats
    start_time: float
    ended: float
    note: str


@dataclass(frozen=True, slots=True, eq=False)
class PositionReport:
    """Lengths (n,) m that the controller reported on request. requested, answered : s on the clock"""

    requested: float
    answered: float
    lengths: Floats

    @property
    def t(self) -> float:
        """s, middle of the time in which the lengths were read."""
        return (self.requested + self.answered) / 2


TRUST = "home it (rig home), or, where the lengths reported are true, use --trust (rig run: --no-home)"
ANEW = f"the controller has restarted since the last contact; {TRUST}"
OUT_OF_RANGE = "is [controller] zero the length, joint centre to joint centre, at which the controller counts 0?"
OUT_OF_JOINT_RANGE = "is [controller] zero the value of each axis at which the controller counts 0?"
UNIT_ERROR_RATIOS = (500.0, 2000.0)  # by which a length is off where mm were taken for m, and the like
CANNOT_HOME = (
    "[controller] homing = false: this controller cannot home, so nothing was sent; an alarm is cleared with "
    "rig jog --unlock, "
    "and its position is trusted with --trust once you have verified it"
)
_BY_ACTIVITY = {
    "alarm": "see what is wrong at the machine, then rig home --unlock",
    "off": "see that nobody is in the way, then rig home --unlock, which switches it on",
    "held": "it was put in hold: rig stop drops what is held, then continue",
    "homing": "wait until it is home, or rig stop",
    "moving": "wait until it is at rest, or rig stop",
}


def hint_at_lengths_wrong_by_factor_of_thousand(lengths: Floats, expected: Floats) -> str:
    """Hint at lengths (n,) m that are about 1000 times too large or small.

    It stands after "; "; "" where they are not.

    expected : (n,) or (n, 2) m, of which the largest counts
    """
    size, usual = float(np.abs(lengths).max()), float(np.abs(expected).max())
    for ratio, word in ((size, usual), "large"), ((usual, size), "small"):
        if UNIT_ERROR_RATIOS[0] * ratio[1] < ratio[0] < UNIT_ERROR_RATIOS[1] * ratio[1]:
            return f"; about {ratio[0] / ratio[1]:.0f} times too {word}: units?"
    return ""


def operator_advice(activity: str, can_home: bool, homing_required: bool = False) -> str:
    """Advice to the operator for the controller's activity.

    It is text after "; ", "" where it is ready.
    can_home : whether the controller can home; homing_required : whether it is in alarm for no other reason
    """
    if homing_required and can_home:
        return "; rig home ends that"
    if activity in ("alarm", "off") and not can_home:
        return (
            "; see what is wrong at the machine, then rig jog --unlock, with --trust where the position it reads "
            "is true"
        )
    return f"; {_BY_ACTIVITY[activity]}" if activity in _BY_ACTIVITY else ""
