"""Mechanism entries of rig.toml."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Json
from rig.errors import FileError
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, Entries, nearest_known_word
from rig.formats.json_toml_and_yaml_loading import json_data
from rig.formats.local_and_remote_input_files import read_text, short_repr
from rig.formats.output_files import write_text
from rig.formats.rig_toml.hexapod_and_two_strut_entries import (
    hexapod_of_table,
    message_of_disordered_limits,
    two_strut_plane_of_table,
)
from rig.model.arm_hands_effect_places_and_tolerances import Branch, Coupling, Hand, coupling_matrix, hand_names
from rig.model.mechanism_geometry_classes import Arm, Chain, FileMechanism, Free, Stage
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, target_bodies
from rig.model.mechanisms.user_kinematics_file_mechanism import nominal_mechanism_of_kinematics_file

UNSUITED = {
    "tilt_sensor": "tilt sensors are for arms with one hand",
    "platform": "with [[mechanism.hand]] each hand states its own mass and centre_of_mass there",
}  # {table of rig.toml: why an arm with several hands has none}


def refuse_tables_unsuited_to_several_hands(root: Entries) -> None:
    """Raise FileError for a table of a rig.toml that an arm with several hands cannot have."""
    if "hand" not in root.table("mechanism").tree:
        return
    for name, reason in UNSUITED.items():
        if root.tree.get(name):
            root.fail(reason, name)
    for camera in root.tables("camera"):
        if camera.tree.get("mount", "fixed") != "fixed":
            camera.fail("cameras that see several hands stand still", "mount")
    instrument = root.table("instrument", optional=True)
    if instrument.tree.get("kind", "pose") != "pose":
        instrument.fail("the poses or positions of several hands are calibrated, no other part of a pose", "kind")


def bodies_by_name_in_rig_toml(mechanism: Mechanism) -> dict[str, str]:
    """Bodies of targets by their names in rig.toml, {name: body}.

    Of an arm with several hands a name is the hand's; the first one's targets are the platform's, those of others are
    measured as the stages of a chain are.
    """
    names = hand_names(mechanism)
    if not names:
        return {body: body for body in target_bodies(mechanism)}
    return {"base": "base", **{name: f"stage {k}" if k else "platform" for k, name in enumerate(names)}}


def branches_of_tables(table: Entries, joint_count: int) -> tuple[Branch, ...]:
    """Branches of an arm from its table [mechanism]. Raises FileError for what makes no tree."""
    out: list[Branch] = []
    for one in table.tables("branch"):
        one.refuse_misspelt(("joint", "parent", "mount"))
        joint, parent = _joint(one, 2, joint_count), one.whole("parent", 0)
        if parent >= joint:
            one.fail(f"{one.name('parent')} must be a joint before joint {joint}, or 0 for the base", "parent")
        if joint - 1 in [branch.joint for branch in out]:
            one.fail(f"{one.name('joint')}: joint {joint} has a [[mechanism.branch]] already", "joint", value=joint)
        mount = one.pose("mount") if "mount" in one.tree else RigidTransform.identity()
        out.append(Branch(joint - 1, parent - 1, mount))
    return tuple(out)


def _joint(table: Entries, least: int, joints: int, key: str = "joint") -> int:
    """Number of a joint, from `least`, of an arm with so many joints."""
    number = table.whole(key, least)
    if number > joints:
        table.fail(f"{table.name(key)}: there is no joint {number}, the arm has {joints}", key, value=number)
    return number


def hands_of_tables(table: Entries, joint_count: int, branches: tuple[Branch, ...]) -> tuple[Hand, ...]:
    """Hands of an arm from its table [mechanism].

    None where it states no [[mechanism.hand]].
    Raises FileError for a single hand, names given twice, a tool stated elsewhere, and branches without hands
    """
    out: list[Hand] = []
    for one in table.tables("hand"):
        one.refuse_misspelt(("name", "joint", "tool", "mass", "centre_of_mass"))
        name = one.identifier("name")
        if name in [hand.name for hand in out]:
            one.fail(f"{one.name('name')}: hand {name!r} is listed twice", "name", value=name)
        out.append(
            Hand(
                name,
                _joint(one, 1, joint_count) - 1,
                one.pose("tool") if "tool" in one.tree else RigidTransform.identity(),
                one.number("mass", None, least=0, unit="kg"),
                one.array("centre_of_mass", (3,), None, length_limit=LARGEST_RIG),
            )
        )
    if len(out) == 1:
        table.fail(f"{table.name('hand')}: an arm with one hand states none; write its tool in [mechanism]", "hand")
    if out and "tool" in table.tree:
        table.fail(f"{table.name('tool')}: with [[mechanism.hand]] each hand states its own tool there", "tool")
    if branches and not out:
        table.fail(f"{table.name('branch')}: an arm with branches states its hands, [[mechanism.hand]] each", "branch")
    return tuple(out)


def couplings_of_tables(table: Entries, is_prismatic: Booleans) -> tuple[Coupling, ...]:
    """Couplings of an arm's joints from its table [mechanism].

    Its joints are prismatic where is_prismatic (n,) is true.
    Raises FileError for what couples nothing
    """
    out: list[Coupling] = []
    for one in table.tables("coupling"):
        one.refuse_misspelt(("joint", "leader", "multiplier", "offset"))
        joint, leader = (_joint(one, 1, len(is_prismatic), key) - 1 for key in ("joint", "leader"))
        units = ["m" if slide else "rad" for slide in is_prismatic[[joint, leader]]]
        multiplier = one.number("multiplier", 1.0) * one.units.per_si(units[1]) / one.units.per_si(units[0])
        out.append(Coupling(joint, leader, multiplier, one.number("offset", 0.0, unit=units[0])))
        try:
            coupling_matrix(len(is_prismatic), tuple(out))
        except ValueError as error:
            one.fail(f"{one.name('joint')}: {error}", "joint")
    return tuple(out)


def json_of_branches_hands_and_couplings(arm: Arm) -> Json:
    """JSON of the branches, hands and couplings of an arm.

    The functions above read them; nothing of one hand without couplings.
    """
    coupled: Json = {}
    if arm.couplings:
        coupled["coupling"] = [
            {"joint": c.joint + 1, "leader": c.leader + 1, "multiplier": c.multiplier, "offset": c.offset}
            for c in arm.couplings
        ]
    branches, hands = arm.branches, arm.hands
    if not hands:
        return coupled
    listed = []
    for hand in hands:
        one: Json = {"name": hand.name, "joint": hand.joint + 1, "tool": json_data(hand.tool)}
        if hand.mass is not None:
            one["mass"] = hand.mass
        if hand.centre_of_mass is not None:
            one["centre_of_mass"] = hand.centre_of_mass.tolist()
        listed.append(one)
    stands = [{"joint": b.joint + 1, "parent": b.parent + 1, "mount": json_data(b.mount)} for b in branches]
    return {"branch": stands, "hand": listed, **coupled}


FILE = "file:"  # before the name of a kinematics file
LARGEST_SOURCE = 1 << 20  # bytes of one
KINDS = {"revolute": False, "prismatic": True}
ROW_UNITS = ("rad", "m", "m", "rad", "rad")  # of theta, d, a, alpha, beta


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint of an arm, written as a table of its own.

    joint : "revolute" or "prismatic"; theta : rad; d : m; a : m; alpha : rad; beta : rad, Hayati's
    limits : rad, of a slide m; of every joint here, or of all in [mechanism]
    """

    joint: str
    theta: float
    d: float
    a: float
    alpha: float
    beta: float
    limits: tuple[float, float] | None

    @property
    def row(self) -> tuple[float, ...]:
        """theta, d, a, alpha, beta."""
        return self.theta, self.d, self.a, self.alpha, self.beta


def joint_rows_and_kinds(table: Entries) -> tuple[Floats, Booleans]:
    """Rows of joints (n, 4 or 5) and kinds of joints (n,) of a table.

    Rows (n, 4 or 5) of theta, d, a, alpha, beta (rad, m); kinds (n,) are true where prismatic.

    A row may begin with "revolute", the default, or "prismatic"; or each joint is a table with these figures by name,
    `joint` its kind and perhaps `limits`. Raises FileError for anything else, no rows, or lengths beyond any rig
    """
    rows = table.get("joints")
    if isinstance(rows, list) and rows and all(isinstance(row, dict) for row in rows):
        return _tables(table.tables("joints"))
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        table.fail(
            f"{table.name('joints')} must be a list of rows [theta, d, a, alpha], those of slides "
            '["prismatic", theta, d, a, alpha]',
            "joints",
        )
    if not rows:
        table.fail(f"{table.name('joints')} is empty", "joints")
    slides = np.array([_slides(table, i, row) for i, row in enumerate(rows)])
    has_kind = [isinstance(row[0], str) if row else False for row in rows]
    columns = len(rows[0]) - has_kind[0]
    columns = columns if columns in (4, 5) else 4
    for i, (row, word) in enumerate(zip(rows, has_kind)):
        if len(row) - word != columns:
            table.fail(
                f"{table.name('joints')}[{i + 1}] must have {columns} numbers, theta, d, a, "
                f"alpha{', beta' if columns == 5 else ''}, "
                f"got {len(row) - word} entries",
                "joints",
                i,
            )
        for j in range(columns):
            table.numbers(row[j + word], (), "joints", (i, j + word), LARGEST_RIG if j in (1, 2) else None)
    stated = np.array([row[word:] for row, word in zip(rows, has_kind)], float)
    return table.units.si(stated, ROW_UNITS[:columns]), slides


def _tables(tables: list[Entries]) -> tuple[Floats, Booleans]:
    """The same of joints that are written as tables, beta 0 where it is not stated."""
    found = [_table(one) for one in tables]
    betas = any("beta" in one.tree for one in tables)
    return np.array([one.row for one in found])[:, : 4 + betas], np.array([KINDS[one.joint] for one in found])


def _table(table: Entries) -> Joint:
    kind = table.text("joint", tuple(KINDS), "revolute")
    found = Joint(
        kind,
        table.number("theta", unit="rad"),
        table.number("d", unit="m"),
        table.number("a", unit="m"),
        table.number("alpha", unit="rad"),
        table.number("beta", 0.0, unit="rad"),
        _own_limits(table, KINDS[kind]),
    )
    table.refuse_misspelt([one.name for one in fields(Joint)])
    for name in ("d", "a"):
        table.numbers(table.get(name), (), name, (), LARGEST_RIG)
    return found


def _slides(table: Entries, i: int, row: list[object]) -> bool:
    """Whether a row is of a slide."""
    word = row[0] if row else None
    if not isinstance(word, str):
        return False
    if word not in KINDS:
        near = nearest_known_word(word, KINDS)
        table.fail(
            f"{table.name('joints')}[{i + 1}] is of a joint "
            f"{short_repr(word)}{f'; is {near!r} meant?' if near else ''}; there are "
            f"{', '.join(map(repr, KINDS))}",
            "joints",
            i,
            0,
            value=word,
        )
    return KINDS[word]


def joint_limits(table: Entries, is_prismatic: Booleans) -> Floats:
    """Joint limits (n, 2) rad, m for prismatic joints.

    is_prismatic : (n,) bool
    Raises FileError where they do not run from small to large, or a slide's are beyond any rig.
    """
    rows = table.get("joints")
    if not isinstance(rows, list):
        table.fail(f"{table.name('joints')} must be a list of rows or tables", "joints")
    twice = [i for i, row in enumerate(rows) if isinstance(row, dict) and "limits" in row and "limits" in table.tree]
    if twice:
        table.fail(
            f"{table.name('joints')}.{twice[0] + 1}.limits is stated, and so is {table.name('limits')}: which applies?",
            "joints",
            twice[0],
            "limits",
        )
    if "limits" not in table.tree and isinstance(rows[0], dict):
        own = [_table(one).limits for one in table.tables("joints")]
        for i, each in enumerate(own):
            if each is None:
                table.fail(
                    f"{table.name('joints')}.{i + 1}.limits is missing, and so is {table.name('limits')}", "joints", i
                )
        return np.array(own, float)
    units = np.where(is_prismatic, "m", "rad")
    found = table.array("limits", (len(is_prismatic), 2), unit=[[unit] for unit in units.tolist()])
    for i, (low, high) in enumerate(found):
        if not low < high:
            table.fail(message_of_disordered_limits(table, "limits", (low, high), str(units[i]), i), "limits", i)
        if is_prismatic[i]:
            for j in range(2):
                length = float(found[i, j]) * table.units.per_si("m")
                table.numbers(length, (), "limits", (i, j), LARGEST_RIG)
    return found


def _own_limits(table: Entries, slide: bool) -> tuple[float, float] | None:
    unit = "m" if slide else "rad"
    found = table.array("limits", (2,), None, length_limit=LARGEST_RIG if slide else None, unit=unit)
    if found is None:
        return None
    low, high = found.tolist()
    if not low < high:
        table.fail(message_of_disordered_limits(table, "limits", (low, high), unit), "limits")
    return low, high


def mechanism_of_table(table: Entries) -> Mechanism:
    """Mechanism of the table [mechanism], lengths in m, angles in rad.

    Raises FileError.
    """
    stated = table.get("kind", "")
    if isinstance(stated, str) and stated.startswith(FILE):
        table.refuse_misspelt(("kind",))
        return mechanism_of_kinematics_file(table, "kind", stated.removeprefix(FILE))
    return WHOLE[table.text("kind", tuple(WHOLE))](table)


def mechanism_of_kinematics_file(table: Entries, key: str, file_name: str) -> FileMechanism:
    """Mechanism of a kinematics file, file_name, that is beside the file of `table`.

    key : of the entry that names it
    Raises FileError.
    """
    if not file_name.endswith(".py") or Path(file_name).name != file_name:
        table.fail(
            f"{table.name(key)} names a Python file beside this one, such as file:delta.py, not {file_name!r}", key
        )
    path = table.file.parent / file_name
    source = read_text(path, LARGEST_SOURCE, f"no such file, which {table.name(key)} of {table.file} names")
    return nominal_mechanism_of_kinematics_file(str(path), source)


def write_kinematics_file(folder: Path, mechanism: Mechanism) -> None:
    """Write the kinematics file of a mechanism into a folder.

    It is beside the file that names it. Nothing is written for other kinds.
    Raises FileError where another file of that name is there
    """
    for name, text in mechanism.files.items():
        path = folder / name
        if not path.exists():
            write_text(path, text)
        elif path.read_text(encoding="utf-8-sig") != text:
            raise FileError(path, "is another kinematics file of the same name; write to another folder")


def _free(table: Entries) -> Free:
    table.refuse_misspelt(("kind",))
    return Free()


def _chain(table: Entries) -> Chain:
    stages = [STAGES[one.text("kind", tuple(STAGES))](one) for one in table.tables("stage")]
    for stage, one in zip(stages, table.tables("stage")):
        if hand_names(stage):
            one.fail("a stage of a chain has one hand, and [[mechanism.hand]] states several", "hand")
        if len(stage.axes) > 6 and stage.strut_joints is not None:
            one.fail(f"a stage of a chain has six struts at most, got {len(stage.axes)}", "base_joints")
    if len(stages) < 2:
        table.fail(
            f"{table.name('stage')}: a chain has two stages or more, [[mechanism.stage]] each, got {len(stages)}",
            "kind",
        )
    table.refuse_misspelt(("kind", "stage"))
    return Chain(tuple(stages))


def _arm(table: Entries) -> Arm:
    table.refuse_misspelt(("kind", "joints", "joint_names", "limits", "base", "tool", "branch", "hand", "coupling"))
    joints, slides = joint_rows_and_kinds(table)
    stands = {key: table.pose(key) for key in Arm.placements if key in table.tree}
    branches = branches_of_tables(table, len(joints))
    hands = hands_of_tables(table, len(joints), branches)
    couplings = couplings_of_tables(table, slides)
    return Arm(
        joints,
        joint_limits(table, slides),
        slides=slides,
        branches=branches,
        hands=hands,
        couplings=couplings,
        **stands,
    )


STAGES: dict[str, Callable[[Entries], Stage]] = {
    "hexapod": hexapod_of_table,
    "planar2": two_strut_plane_of_table,
    "arm": _arm,
}
WHOLE: dict[str, Callable[[Entries], Mechanism]] = {**STAGES, "chain": _chain, "free": _free}
