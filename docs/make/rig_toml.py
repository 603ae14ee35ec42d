"""docs/rig-toml.md out of the reader itself: what it asks of every table is written down while it reads rigs that state
everything.

`python -m docs.make.rig_toml > docs/rig-toml.md`
"""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit

from docs.make.field_texts import headline, texts_of_fields
from rig.formats.checked_toml_and_json_entries import REQUIRED, Entries, Key
from rig.formats.json_toml_and_yaml_loading import toml_value_positions
from rig.formats.numbers_and_units import UnitNames
from rig.formats.rig_toml import arm_dynamics_entries, design_from_rig_toml
from rig.formats.rig_toml.arm_dynamics_entries import ArmDynamics
from rig.formats.rig_toml.mechanism_entries import Joint
from rig.model.arm_hands_effect_places_and_tolerances import Branch, Coupling, Hand
from rig.model.base_and_link_tilt_sensors import BaseTilt, TiltSensor
from rig.model.design import (
    FACES,
    Actuator,
    Arm,
    Camera,
    CaptureSettings,
    Controller,
    Design,
    Hexapod,
    Instrument,
    Marker,
    MeasuringLimbs,
    Permission,
    Planar2,
    Platform,
    Sensor,
    SensorPort,
    Target,
)
from rig.model.mechanisms.mechanism_kinds_and_kinematics import axis_units, has_links
from rig.planning.layout import hexapod_layout_and_camera_placement, shipped_arms_and_layouts

HEAD = """# rig.toml, table by table

Made from what reads the file (`python -m docs.make.rig_toml`). Lengths are in metres, angles in radians, times in \
seconds. A rotation is a
rotation vector, `rotvec`. In its place a pose may state `look_at = [x, y, z]`, the point that its z axis points to with
y down, as a camera's (`up = [..]` where that is not the base's z). Or it states `euler = "xyz"` with
`degrees = [a, b, c]`: turns about fixed axes x, y, z in this order; in capitals about axes already turned.
A key that the reader does not know is an error, with its line and the nearest key that is
known; remarks are TOML comments. `rig new design` writes a file to begin with, in mm and degrees with \
`--units mm,deg`; [conventions](conventions.md) say how frames, faces and corners are meant.

`schema = "rig/1"` stands first. After it `units = "mm, deg"` may state that the whole file has millimetres and degrees
wherever this page has m and rad: in rotation vectors, `look_at`, tolerances, speeds (mm/s), gravity (mm/s^2).
Lengths may be in m, mm, cm, um or in, angles in rad, deg or mrad. Forces, torques, masses and inertias stay in N, N m,
kg and kg m^2; `degrees` are degrees in any file.
"""
TABLES = {  # as it is headed: (the dataclass that it becomes, what is said of it)
    "name and [environment]": (Design, "Of the rig as a whole. All of it may be left out."),
    "[[environment.tilt]]": (BaseTilt, "One for each axis by which the base turns; the first carries the others."),
    '[mechanism] kind = "hexapod"': (Hexapod, ""),
    '[mechanism] kind = "planar2"': (Planar2, ""),
    '[mechanism] kind = "arm"': (Arm, ""),
    "[[mechanism.joints]]": (Joint, "In place of a row of `joints`."),
    "[[mechanism.branch]]": (
        Branch,
        "Of an arm with several hands on one trunk; [several hands](several-hands.md) says more.",
    ),
    "[[mechanism.hand]]": (Hand, "Two or more, in place of `tool`; joints are counted from 1, as q1 .."),
    "[[mechanism.coupling]]": (
        Coupling,
        "One for each joint of an arm that follows another, as a mimic joint of a URDF.",
    ),
    '[mechanism] kind = "chain"': (
        None,
        "Two tables `[[mechanism.stage]]` or more, each of a kind above, each on the last; [chains](chains.md) "
        "say more.",
    ),
    '[mechanism] kind = "file:NAME.py"': (
        None,
        "A machine of another kind, by a Python file beside this one that states its axes, parameters and inverse "
        "kinematics; [kinematics of your own](own-kinematics.md) says more.",
    ),
    '[mechanism] kind = "free"': (
        None,
        "Moved by hand or by somebody else: there is nothing to command, and nothing else to state.",
    ),
    "[[camera]]": (Camera, "One for each camera."),
    "[camera.capture]": (CaptureSettings, "May be left out; of `uvc` and `genicam` cameras."),
    "[[target]]": (
        Target,
        "One for each cube, board, or other body with markers. A board has `board`, `first`, `legacy` and `pose` "
        "in place of `dictionary`, `edge`, `marker` and `faces`; [measuring](measuring.md#boards) says more.",
    ),
    "[target.faces]": (
        None,
        'Of a cube: which marker is on which face, `"+x" = 3`. Faces that are not stated carry none.',
    ),
    "[[target.marker]]": (
        Marker,
        "In place of `edge`, `marker`, `faces` and `pose`, for a target that is no cube: each marker by itself.",
    ),
    "[platform]": (Platform, "May be left out."),
    "[actuator]": (Actuator, "May be left out."),
    "[instrument]": (
        Instrument,
        "Only where poses.csv comes from an outside instrument (a laser tracker, a coordinate measuring machine).",
    ),
    "[[tilt_sensor]]": (
        TiltSensor,
        "One for each; [arms](arms.md#tilt-sensors) and [measuring](measuring.md#tilt-sensors-on-a-platform) say more.",
    ),
    "[controller]": (
        Controller,
        "Only where `rig run` and the like drive the machine; [controllers](controllers.md) say more.",
    ),
    "[sensors]": (
        SensorPort,
        "Only where a run reads thermometers or measuring limbs; [operating](operating.md) says more.",
    ),
    "[insitu]": (MeasuringLimbs, "Only where there are measuring limbs; [measuring](measuring.md) says more."),
    "[experiment]": (Permission, "Only where [experiments](investigate.md) may do more than move."),
    "[turned]": (
        None,
        "Cubes that were taken off and put back since their `pose` was stated, each with its quarter turns "
        "about its own z, "
        "right-handed: `P1 = 1`; 0 for one that looks as before. Their places are known only to what "
        "remounting may do, so that "
        "their markers determine no pose; several recordings [together](investigate.md) find them.",
    ),
    "[dynamics]": (ArmDynamics, "Of arms, only where forces at the hand are asked for; [forces](force.md) say more."),
    "[sensor]": (Sensor, "What simulated cameras do to light; real ones need none of it."),
}


@dataclass
class RequestedEntry:
    """What is asked of one key. takes : in words; default : None where it is required; unit : SI, of the reader"""

    takes: str
    default: str | None
    limits: str = ""
    unit: UnitNames = ""


@dataclass
class Log(Entries):
    """Entries that write down what they are asked, by table and key."""

    found: dict[tuple[str, Key], RequestedEntry] = field(default_factory=dict)

    def _note(self, key: Key, takes: str, default: Any, limits: str = "", unit: UnitNames = "") -> None:
        at = (self._heading(), key)
        if at not in self.found:
            self.found[at] = RequestedEntry(takes, None if default is REQUIRED else _shown(default), limits, unit)

    def _heading(self) -> str:
        names = [str(part) for part in self.path if not isinstance(part, int)]
        if names in ([], ["environment"]):
            return "name and [environment]"
        if names == ["mechanism"]:
            return f'[mechanism] kind = "{self.tree["kind"]}"'
        dotted = ".".join(names)
        return f"[[{dotted}]]" if isinstance(self.path[-1], int) else f"[{dotted}]"

    def get(self, key: Key, default: Any = REQUIRED) -> Any:
        self._note(key, KINDS_OF_GET.get(str(key), "list"), default)
        return super().get(key, default)

    def text(self, key: Key, choices: Any = None, default: Any = REQUIRED) -> Any:
        self._note(
            key, "one of " + ", ".join(f"`{c}`" for c in choices) if choices and len(choices) < 9 else "text", default
        )
        return super().text(key, choices, default)

    def whole(self, key: Key, least: int, default: Any = REQUIRED, most: int = 1 << 53) -> int:
        self._note(key, "whole number", default, f"from {least}" + (f" to {most}" if most < 1 << 53 else ""))
        return super().whole(key, least, default, most)

    def number(
        self,
        key: Key,
        default: Any = REQUIRED,
        least: float | None = None,
        most: float | None = None,
        above: float | None = None,
        unit: str = "",
        nulls: bool = False,
    ) -> Any:
        self._note(key, "number", default, _limits(least, most, above, unit), unit)
        limits = {"least": least, "most": most, "above": above, "unit": unit or None}
        stated = {name: value for name, value in limits.items() if value is not None}
        return super().number(key, default, nulls=nulls, **stated)

    def each(self, key: Key, count: int, default: Any = REQUIRED, **limits: Any) -> Any:
        within = _limits(*(limits.get(name) for name in ("least", "most", "above")), limits.get("unit", ""))
        self._note(key, "number, or one for each axis", default, within, limits.get("units", limits.get("unit", "")))
        return super().each(key, count, default, **limits)

    def array(self, key: Key, shape: Any, default: Any = REQUIRED, **options: Any) -> Any:
        length_limit = options.get("length_limit")
        if str(self.tree.get("kind")) == "arm" or self.path == ("dynamics",):
            shape = (None, *shape[1:])
        self._note(
            key,
            "x".join("n" if n is None else str(n) for n in shape) + " numbers",
            default,
            f"none beyond {length_limit:g} m" if length_limit else "",
            options.get("unit") or ("m" if length_limit else ""),
        )
        return super().array(key, shape, default, **options)

    def pose(self, key: Key) -> Any:
        self._note(key, "{position = [x, y, z], rotvec = [rx, ry, rz]}, m and rad; or look_at, or euler", REQUIRED)
        return Entries(self.tree, self.path, self.file, self.places, self.units).pose(key)


HANGS_ON_ANOTHER = {
    ("[[camera]]", "row_time"): "`0`; of a rolling shutter, found from exposures in motion",
    ("[controller]", "max_speed"): "`[actuator]` `max_speed`",
    ("[controller]", "work"): "the platform at home",
    ("[controller]", "tool"): "the platform itself",
    ("[[target.marker]]", "margin"): "an eighth of `side`",
    ("[[target]]", "board"): "a cube, or listed markers",
    ("[[target.marker]]", "pose"): "found from the recording",
    ('[mechanism] kind = "arm"', "base"): "the frame of poses itself",
    ('[mechanism] kind = "arm"', "tool"): "the last frame itself",
    ("[[mechanism.branch]]", "mount"): "the frame of that link itself",
    ("[[mechanism.hand]]", "tool"): "the frame of that link itself",
}
FIRST = "identity of a board's first marker"
LEGACY = "whether a charuco's first square holds a marker where its rows are even"
KEY_TEXTS = {  # of keys that are not fields, or not those alone
    ('[mechanism] kind = "arm"', "joint_names"): "as other files call them: findings show them behind the numbers",
    ("[[mechanism.branch]]", "joint"): "its number: 4 is q4",
    ("[[mechanism.branch]]", "parent"): "number of the joint whose link carries it, 0 for the base",
    ("[[mechanism.hand]]", "joint"): "number of the joint whose link holds it",
    ("[[mechanism.coupling]]", "joint"): "number of the joint that follows",
    ("[[mechanism.coupling]]", "leader"): "number of the joint that it follows",
    ("[[target]]", "board"): "description of a board with the lengths of its print",
    ("[[target]]", "pose"): "T_body_cube, of the cube's centre, or T_body_board, of the board's lower left corner: x "
    "right, y up, z out of the paper",
    ("[[target]]", "first"): FIRST,
    ("[controller]", "work"): "T_base_work, the frame in which a hexapod's own controller (gcs-hexapod, hxp, "
    "symetrie, epics-hexapod) takes poses",
    ("[controller]", "tool"): "T_platform_tool, the frame whose poses these are",
    ("[[target]]", "legacy"): LEGACY,
    ('[mechanism] kind = "hexapod"', "followers"): "numbers, from 1, of the struts beyond six that bear no force while "
    "poses are measured and read their own lengths: [more struts](more-struts.md)",
}
KINDS_OF_GET = {
    "legacy": "true or false",
    "followers": "list of one or two numbers",
    "homing": "true or false",
    "joint_names": "list of names, one for each joint",
    "axes": "list of names",
    "may": "list of `payload`, `wait`, `turn cube NAME`",
    "channels": "list of names",
    "joints": 'rows `[theta, d, a, alpha]`, or five numbers with beta; a slide\'s begins with `"prismatic"`; or tables '
    "`[[mechanism.joints]]`",
}


def _shown(value: Any) -> str:
    if value is None or (isinstance(value, str | list) and not value):
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _limits(least: float | None, most: float | None, above: float | None, unit: str) -> str:
    words = [
        f"above {above:g}" if above is not None else "",
        f"from {least:g}" if least is not None else "",
        f"to {most:g}" if most is not None else "",
    ]
    return " ".join(filter(None, [*words, unit.split(" (")[0]])) if any(words) else ""


def samples() -> list[dict[str, Any]]:
    """Rigs as tables, which between them state everything that the reader asks for."""
    whole = tomllib.loads(
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1, cubes=1, legs=(6, 6))
    )
    whole["camera"][0] |= {
        "shutter": "rolling",
        "row_time": 1e-5,
        "source": "uvc:0",
        "mount": "fixed",
        "capture": {"gain": 1.0},
    }
    whole["environment"]["tilt"] = [{"channel": "elevation_deg", "axis": [0.0, 1.0, 0.0], "zero": 0.0}]
    stands = {"position": [0.0, 0.0, 0.0], "rotvec": [0.0, 0.0, 0.0]}
    whole["controller"] = {"protocol": "gcs-hexapod", "port": "/dev/ttyACM0", "max_speed": 0.01}
    whole["controller"] |= {"work": stands, "tool": stands}
    whole["sensors"] = {"port": "/dev/ttyUSB1", "channels": ["ambient_temperature_C"]}
    whole["experiment"] = {"may": ["payload", "wait"]}
    whole["instrument"] = {"base": "rig", "tool": "rig", "position_sigma": 1e-5, "rotation_sigma": 1e-4}
    whole["sensor"] = {name: getattr(Sensor(), name) for name in Sensor.__slots__}
    listed = tomllib.loads(hexapod_layout_and_camera_placement.two_strut_layout_rig_toml(0.3, cameras=1, cubes=1))
    marker = {"id": 90, "side": 0.03, "pose": {"position": [0.0, 0.0, 0.1], "rotvec": [0.0, 0.0, 0.0]}}
    listed["target"].append(
        {"name": "board", "body": "base", "board": "aruco:2x2:0.03:0.01:DICT_6X6_250", "first": 200, "pose": stands}
    )
    listed["target"].append({"name": "plate", "body": "base", "dictionary": "DICT_5X5_100", "marker": [marker]})
    arms = [
        tomllib.loads(shipped_arms_and_layouts.shipped_arm_rig_toml(name))
        for name in shipped_arms_and_layouts.shipped_arm_names()
    ]
    joint = {"joint": "prismatic", "theta": 0.0, "d": 0.0, "a": 0.0, "alpha": 0.0, "limits": [0.0, 0.2]}
    stands = {"position": [0.0, 0.0, 0.1], "rotvec": [0.0, 0.0, 0.0]}
    leans = {"name": "column", "link": 0, "sigma": 2e-4, "mount": [0.0, 0.0, 0.0], "mount_sigma": 0.02}
    arms.append(
        {
            "schema": "rig/1",
            "mechanism": {
                "kind": "arm",
                "joints": [joint, joint],
                "base": stands,
                "tool": stands,
                "coupling": [{"joint": 2, "leader": 1, "multiplier": 1.0, "offset": 0.0}],
            },
            "tilt_sensor": [leans],
        }
    )
    hands = tomllib.loads(Path("docs/hands/humanoid.toml").read_text())
    return [whole, listed, *arms, hands, {**whole, "mechanism": {"kind": "free"}, "controller": None}]


def requested_entries() -> dict[tuple[str, Key], RequestedEntry]:
    """What the reader asks of each key of each table, in the order in which it asks."""
    found: dict[tuple[str, Key], RequestedEntry] = {}
    for tree in samples():
        text = tomlkit.dumps({key: value for key, value in tree.items() if value is not None})
        root = Log(tomllib.loads(text), (), Path("rig.toml"), toml_value_positions(text), found=found)
        mechanism = design_from_rig_toml.design_of_entries(root).mechanism
        if has_links(mechanism):
            arm_dynamics_entries.dynamics_of_table(root.table("dynamics", optional=True), axis_units(mechanism))
    return {at: what for at, what in found.items() if at[1] not in TABLE_KEYS or at == ("[instrument]", "kind")}


TABLE_KEYS = (
    "schema",
    "units",
    "environment",
    "tilt",
    "mechanism",
    "branch",
    "coupling",
    "hand",
    "camera",
    "capture",
    "target",
    "platform",
    "actuator",
    "instrument",
    "controller",
    "sensors",
    "insitu",
    "experiment",
    "turned",
    "sensor",
    "tilt_sensor",
    "dynamics",
    "faces",
    "position",
    "rotvec",
    "kind",
    *FACES,
)


def page() -> str:
    """The page in Markdown."""
    found = requested_entries()
    parts = [HEAD]
    for heading, (kind, words) in TABLES.items():
        about = "" if kind is None else headline(kind)
        parts.append(
            f"\n## {heading}\n\n" + " ".join(filter(None, [about if kind is not Design else "", words])) + "\n"
        )
        field_texts = {} if kind is None else texts_of_fields(kind)
        rows = [_row(at, what, field_texts) for at, what in found.items() if at[0] == heading]
        if rows:
            parts.append("\n| key | takes | if left out | what |\n|---|---|---|---|\n" + "\n".join(rows) + "\n")
    whole = _indented(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1, cubes=1))
    return (
        "".join(parts)
        + f"\n## A whole one\n\nAs `rig new design --radius 0.3 --cameras 1 --cubes 1` writes it:\n\n{whole}"
    )


def _row(at: tuple[str, Key], what: RequestedEntry, field_texts: dict[str, str]) -> str:
    limits = f" ({what.limits})" if what.limits else ""
    default = HANGS_ON_ANOTHER.get((at[0], str(at[1])), "**required**" if what.default is None else f"`{what.default}`")
    words = KEY_TEXTS.get((at[0], str(at[1])), field_texts.get(str(at[1]), ""))
    return f"| `{at[1]}` | {what.takes}{limits} | {default} | {words} |"


def _indented(text: str) -> str:
    return "".join(f"    {line}\n" if line else "\n" for line in text.splitlines())


if __name__ == "__main__":
    print(page(), end="")
