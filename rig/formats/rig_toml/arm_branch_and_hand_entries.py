"""Tables [[mechanism.branch]] and [[mechanism.hand]] of rig.toml, of an arm with several hands on one trunk."""

from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Json
from rig.formats.checked_entries import LARGEST_RIG, Entries
from rig.formats.json_toml_and_yaml_loading import json_data
from rig.model.arm_branches_and_hands import Branch, Hand, hand_names
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, target_bodies

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


def bodies_by_word(mechanism: Mechanism) -> dict[str, str]:
    """{word in rig.toml: body of a Target}: of an arm with several hands the hand's name; the first one's targets are
    the platform's, those of others are measured as the stages of a chain are.
    """
    names = hand_names(mechanism)
    if not names:
        return {body: body for body in target_bodies(mechanism)}
    return {"base": "base", **{name: f"stage {k}" if k else "platform" for k, name in enumerate(names)}}


def branches_of_tables(table: Entries, joints: int) -> tuple[Branch, ...]:
    """Branches of a table [mechanism] of an arm with so many joints. Raises FileError for what makes no tree."""
    out: list[Branch] = []
    for one in table.tables("branch"):
        one.refuse_misspelt(("joint", "parent", "mount"))
        joint, parent = _joint(one, 2, joints), one.whole("parent", 0)
        if parent >= joint:
            one.fail(f"{one.name('parent')} must be a joint before joint {joint}, or 0 for the base", "parent")
        if joint - 1 in [branch.joint for branch in out]:
            one.fail(f"{one.name('joint')}: joint {joint} has a [[mechanism.branch]] already", "joint", value=joint)
        mount = one.pose("mount") if "mount" in one.tree else RigidTransform.identity()
        out.append(Branch(joint - 1, parent - 1, mount))
    return tuple(out)


def _joint(table: Entries, least: int, joints: int) -> int:
    """Number of a joint, from `least`, of an arm with so many joints."""
    number = table.whole("joint", least)
    if number > joints:
        table.fail(f"{table.name('joint')}: there is no joint {number}, the arm has {joints}", "joint", value=number)
    return number


def hands_of_tables(table: Entries, joints: int, branches: tuple[Branch, ...]) -> tuple[Hand, ...]:
    """Hands of a table [mechanism] of an arm with so many joints; none where it states no [[mechanism.hand]].

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
                _joint(one, 1, joints) - 1,
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


def branch_and_hand_dicts(branches: tuple[Branch, ...], hands: tuple[Hand, ...]) -> Json:
    """The tables of branches and hands as JSON holds them, which the functions above read; nothing of one hand."""
    if not hands:
        return {}
    listed = []
    for hand in hands:
        one: Json = {"name": hand.name, "joint": hand.joint + 1, "tool": json_data(hand.tool)}
        if hand.mass is not None:
            one["mass"] = hand.mass
        if hand.centre_of_mass is not None:
            one["centre_of_mass"] = hand.centre_of_mass.tolist()
        listed.append(one)
    stands = [{"joint": b.joint + 1, "parent": b.parent + 1, "mount": json_data(b.mount)} for b in branches]
    return {"branch": stands, "hand": listed}
