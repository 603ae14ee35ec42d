"""Joint chain read from a URDF.

The joints from a root link to a tip link, read with checks; what they are, in words.

Sources: the URDF specification, <joint>, <origin>, <axis>, <limit>, <mimic>; xacro, "Command line"
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.errors import FileError
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, nearest_known_word
from rig.formats.local_and_remote_input_files import read_bytes, short_repr
from rig.formats.numbers_and_units import parse_numbers

LARGEST = 1 << 26  # bytes
DEEPEST = 100  # elements within each other
MOVING = ("revolute", "continuous", "prismatic")
TYPES = (*MOVING, "fixed", "floating", "planar")
ENDLESS = 2 * np.pi  # rad to either side, of a joint that turns without end
LISTED = 12


@dataclass(slots=True)
class Element:
    """An element of XML. name; values : its attributes; line : of the file, from 1; inside : Elements"""

    name: str
    values: dict[str, str]
    line: int
    inside: list["Element"] = field(default_factory=list)

    def first(self, name: str) -> "Element | None":
        """The first element of a name inside, or None."""
        return next((one for one in self.inside if one.name == name), None)


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A joint of a URDF. kind : of TYPES; parent, child : links; T : the child's frame in the parent's at 0
    axis : (3,) of length 1, in the child's frame; limits : rad or m, None of a joint that does not move
    mimicked : joint that it follows, or None, with multiplier and offset (rad, m); line : of the file
    """

    name: str
    kind: str
    parent: str
    child: str
    T: RigidTransform
    axis: Floats
    limits: tuple[float, float] | None
    mimicked: tuple[str, float, float] | None
    line: int

    @property
    def line_of_text(self) -> str:
        """What was read of it, in a line."""
        if self.limits is None:
            return f"read joint {self.name}: fixed, part of the geometry"
        if self.mimicked is not None:
            leader, multiplier, offset = self.mimicked
            by = f"{multiplier:.6g} x {leader} {'-' if offset < 0 else '+'} "
            by += f"{abs(offset) * 1e3:.6g} mm" if self.kind == "prismatic" else f"{abs(np.degrees(offset)):.6g} deg"
            return f"read joint {self.name}: {self.kind}, follows {leader} (mimic): {by}"
        stated = "turns without end; limits assumed" if self.kind == "continuous" else "limits"
        return f"read joint {self.name}: {self.kind}, {stated} {limits_text(self.limits, self.kind == 'prismatic')}"


def limits_text(limits: Sequence[float], is_slide: bool) -> str:
    """Text of a joint's limits, in degrees or, of a slide, in mm.


    limits : (2,) m or rad
    """
    low, high = np.asarray(limits) * (1e3 if is_slide else 180 / np.pi)
    return f"{low:.6g} .. {high:.6g} {'mm' if is_slide else 'deg'}"


@dataclass(frozen=True, slots=True, eq=False)
class JointChain:
    """The joints from a link to another. name : of the robot; root, tip : links; joints : from the root on
    remarks : sentences on what of the file does not count
    """

    name: str
    root: str
    tip: str
    joints: tuple[UrdfJoint, ...]
    remarks: tuple[str, ...]

    @property
    def moving(self) -> tuple[UrdfJoint, ...]:
        """Its joints that move."""
        return tuple(joint for joint in self.joints if joint.kind in MOVING)

    def axes_at_zero(self) -> tuple[Floats, Floats, RigidTransform]:
        """(points (n, 3) m, directions (n, 3), T_root_tip) of its moving joints, all joint values 0."""
        T, points, directions = RigidTransform.identity(), [], []
        for joint in self.joints:
            T = T * joint.T
            if joint.kind in MOVING:
                points.append(T.translation)
                directions.append(T.rotation.apply(joint.axis))
        return np.array(points), np.array(directions), T


def load_joint_chain(path: Path, tip: str | None = None, root: str | None = None) -> JointChain:
    """Load the joint chain (JointChain) of a URDF file, from a root link to a tip.

    From its root link, or the one that is named, to the tip that is named.
    tip : may be None where only one link is at an end
    Raises FileError, with the line, for what is no URDF, Xacro that is not expanded, links and joints that make no
        tree, a joint on the way that an arm cannot have, and an unknown or missing link
    """
    robot = _robot(path)
    links = {_text(path, one, "name"): one.line for one in robot.inside if one.name == "link"}
    named = [one for one in robot.inside if one.name == "joint"]
    if not links or not named:
        raise FileError(path, f"has no {'joints' if links else 'links'}: it is no robot with an arm", robot.line)
    above: dict[str, Element] = {}
    for one in named:
        parent, child = (_link(path, one, end, links) for end in ("parent", "child"))
        if child in above:
            _fail(
                path,
                one,
                f"link {child!r} is the child of joint {_text(path, above[child], 'name')!r} already: "
                "the links make a loop, not a tree",
            )
        above[child] = one
    parents = {_link(path, one, "parent", links) for one in named}
    ends = [name for name in links if name not in parents]
    tip = _known(path, "--tip", tip, links) if tip is not None else _only_end(path, ends, above, links)
    start = None if root is None else _known(path, "--root", root, links)
    joints_to_tip, link = list[Element](), tip
    while link != start and link in above:
        if len(joints_to_tip) > len(above):
            raise FileError(path, f"the links above {tip!r} make a loop, not a tree", above[tip].line)
        joints_to_tip.insert(0, above[link])
        link = _link(path, above[link], "parent", links)
    if start is not None and link != start:
        raise FileError(path, f"--root {start!r} is not above --tip {tip!r}, whose first link is {link!r}")
    joints = tuple(_joint(path, one, links) for one in joints_to_tip)
    if not any(joint.kind in MOVING for joint in joints):
        raise FileError(
            path, f"no joint between {link!r} and {tip!r} moves; {_ends_in_words(path, ends, above, links)}"
        )
    return JointChain(robot.values.get("name", "arm"), link, tip, joints, _remarks(path, robot, joints))


def _fail(path: Path, at: Element, message: str) -> NoReturn:
    named = f"{at.name} {short_repr(at.values['name'])}: " if at.name == "joint" and "name" in at.values else ""
    raise FileError(path, named + message, at.line)


def _robot(path: Path) -> Element:
    """The element <robot> of a file. Raises FileError for entities, and for what is no URDF."""
    parser = expat.ParserCreate()
    above, found = list[Element](), list[Element]()

    def begins(name: str, values: dict[str, str]) -> None:
        one = Element(name, values, parser.CurrentLineNumber)
        _refuse_xacro(path, one)
        if len(above) >= DEEPEST:
            raise FileError(path, f"more than {DEEPEST} elements lie within each other", one.line)
        (above[-1].inside if above else found).append(one)
        above.append(one)

    def ends(_: str) -> None:
        above.pop()

    def declares(*_: object) -> None:
        raise FileError(path, "declares a document type or entities, and a URDF has none", parser.CurrentLineNumber)

    parser.StartElementHandler, parser.EndElementHandler = begins, ends
    parser.StartDoctypeDeclHandler, parser.EntityDeclHandler = declares, declares
    try:
        parser.Parse(read_bytes(path, LARGEST), True)
    except expat.ExpatError as error:
        inside = f"; <{above[-1].name}> of line {above[-1].line} is not closed: the file is cut off" if above else ""
        inside = inside if error.code in CUT_OFF else ""
        text = expat.ErrorString(error.code)
        raise FileError(path, f"is not XML: {text}{inside}", error.lineno, error.offset + 1) from None
    if found[0].name != "robot":
        raise FileError(path, f"is no URDF: it begins with <{found[0].name}>, not <robot>", found[0].line)
    return found[0]


CUT_OFF = tuple(
    expat.errors.codes[text]
    for text in (
        expat.errors.XML_ERROR_NO_ELEMENTS,
        expat.errors.XML_ERROR_UNCLOSED_TOKEN,
        expat.errors.XML_ERROR_PARTIAL_CHAR,
        expat.errors.XML_ERROR_TAG_MISMATCH,
    )
)


def _refuse_xacro(path: Path, one: Element) -> None:
    inserted = next((value for value in one.values.values() if "${" in value or "$(" in value), None)
    if one.name.startswith("xacro:") or inserted is not None:
        whole = path.name.removesuffix(".xacro").removesuffix(".urdf") + ".urdf"
        what = f"<{one.name}>" if inserted is None else short_repr(inserted)
        raise FileError(
            path,
            f"is Xacro that is not expanded: {what}; expand it with `xacro {path} > "
            f"{path.with_name(whole if whole != path.name else 'expanded.urdf')}`, which ROS brings",
            one.line,
        )


def _text(path: Path, one: Element, key: str) -> str:
    if not one.values.get(key):
        _fail(path, one, f"<{one.name}> has no {key}")
    return one.values[key]


def _link(path: Path, joint: Element, end: str, links: Iterable[str]) -> str:
    found = joint.first(end)
    if found is None:
        _fail(path, joint, f"has no <{end}>")
    name = _text(path, found, "link")
    if name not in links:
        near = nearest_known_word(name, links)
        _fail(path, joint, f"its {end} {name!r} is no link" + (f"; is {near!r} meant?" if near else ""))
    return name


def _known(path: Path, option: str, name: str, links: Iterable[str]) -> str:
    if name not in links:
        near, names = nearest_known_word(name, links), list(links)
        listed = ", ".join(names[:LISTED]) + (", .." if len(names) > LISTED else "")
        raise FileError(
            path, f"{option} {name!r} is no link; " + (f"is {near!r} meant?" if near else f"there are {listed}")
        )
    return name


def _only_end(path: Path, ends: list[str], above: dict[str, Element], links: dict[str, int]) -> str:
    if len(ends) != 1:
        raise FileError(path, f"--tip LINK states which link is measured; {_ends_in_words(path, ends, above, links)}")
    return ends[0]


def _ends_in_words(path: Path, ends: list[str], above: dict[str, Element], links: dict[str, int]) -> str:
    """Which links are at an end, and how many joints move above each."""
    parts = []
    for end in ends[:LISTED]:
        link, count = end, 0
        for _ in links:
            if link not in above:
                break
            count += above[link].values.get("type") in MOVING
            link = _link(path, above[link], "parent", links)
        parts.append(f"{end} ({count} moving joints)")
    more = f" and {len(ends) - LISTED} more" if len(ends) > LISTED else ""
    return f"its links at an end: {', '.join(parts) or 'none, they make a loop'}{more}"


def _joint(path: Path, one: Element, links: dict[str, int]) -> UrdfJoint:
    name, kind = _text(path, one, "name"), _text(path, one, "type")
    if kind not in TYPES:
        near = nearest_known_word(kind, TYPES)
        _fail(
            path, one, f"type {short_repr(kind)} is unknown; " + (f"is {near!r} meant?" if near else ", ".join(TYPES))
        )
    if kind in ("floating", "planar"):
        _fail(path, one, f"is {kind}, which an arm cannot state; name links with --root and --tip that leave it out")
    origin = one.first("origin")
    xyz, rpy = (_numbers(path, one, origin, key, (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
    if np.abs(xyz).max() > LARGEST_RIG:
        _fail(path, one, f"its origin lies {np.abs(xyz).max():g} m away: a URDF is in metres; is this in millimetres?")
    T = RigidTransform.from_components(xyz, Rotation.from_euler("xyz", rpy))
    axis = _numbers(path, one, one.first("axis"), "xyz", (1.0, 0.0, 0.0))
    length = float(np.linalg.norm(axis))
    if kind in MOVING and length < 1e-6:
        _fail(path, one, "its axis has no direction")
    return UrdfJoint(
        name,
        kind,
        _link(path, one, "parent", links),
        _link(path, one, "child", links),
        T,
        axis / length if length else axis,
        _limits(path, one, kind),
        _mimicked(path, one) if kind in MOVING else None,
        one.line,
    )


def _mimicked(path: Path, one: Element) -> tuple[str, float, float] | None:
    """(joint that a joint follows, multiplier, offset rad or m), or None."""
    mimic = one.first("mimic")
    if mimic is None:
        return None
    multiplier, offset = (
        float(_numbers(path, one, mimic, key, (default,))[0]) for key, default in (("multiplier", 1.0), ("offset", 0.0))
    )
    if not multiplier:
        _fail(path, one, f"multiplier of <mimic>, line {mimic.line}, is 0: write the joint as fixed")
    return _text(path, mimic, "joint"), multiplier, offset


def _limits(path: Path, one: Element, kind: str) -> tuple[float, float] | None:
    if kind == "continuous":
        return -ENDLESS, ENDLESS
    if kind not in MOVING:
        return None
    limit = one.first("limit")
    if limit is None:
        _fail(path, one, f"is {kind} and has no <limit lower=.. upper=..>")
    low, high = (float(_numbers(path, one, limit, key, (0.0,))[0]) for key in ("lower", "upper"))
    if not low < high:
        unit = "m" if kind == "prismatic" else "rad"
        _fail(path, one, f"its limits must run from small to large, not {low:g} .. {high:g} {unit}")
    if kind == "prismatic" and max(-low, high) > LARGEST_RIG:
        _fail(path, one, f"its limits {low:g} .. {high:g} are in metres; are these in millimetres?")
    return low, high


def _numbers(path: Path, joint: Element, one: Element | None, key: str, default: tuple[float, ...]) -> Floats:
    if one is None or key not in one.values:
        return np.array(default)
    try:
        found = parse_numbers(one.values[key].split())
    except ValueError as error:
        _fail(path, joint, f"{key} of <{one.name}>, line {one.line}: {error}")
    if len(found) != len(default):
        _fail(
            path, joint, f"{key} of <{one.name}>, line {one.line}, must have {len(default)} numbers, not {len(found)}"
        )
    return np.array(found)


def _remarks(path: Path, robot: Element, joints: tuple[UrdfJoint, ...]) -> tuple[str, ...]:
    """Sentences on joints that follow others outside the chain, and on transmissions that couple its joints."""
    on = {joint.name for joint in joints}
    out = []
    for one in robot.inside:
        mimic = one.first("mimic") if one.name == "joint" else None
        if mimic is not None and one.values.get("name") not in on:
            out.append(
                f"ignored joint {_text(path, one, 'name')}: it follows {_text(path, mimic, 'joint')} (mimic) and is "
                "not between root and tip"
            )
        coupled = [_text(path, part, "name") for part in one.inside if part.name == "joint"]
        if one.name == "transmission" and len(on & set(coupled)) > 1:
            out.append(
                f"transmission {one.values.get('name', '')} couples {', '.join(coupled)}: joint values are read as the "
                "joints', not as the motors'"
            )
    return tuple(out)
