"""Arm read from a URDF, or from a table of Denavit-Hartenberg rows or of screw axes.

Also the rig.toml text of the arm.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.errors import RigError
from rig.formats.importers.arm_joint_tables_of_dh_rows_or_screw_axes import (
    JointTable,
    load_denavit_hartenberg_table,
    load_product_of_exponentials_table,
)
from rig.formats.importers.urdf_hands_and_dh_rows_of_joint_axes import (
    couplings_and_limits_of_joints,
    denavit_hartenberg_rows_of_joint_axes,
    urdf_arm_with_several_hands_and_its_joint_chains,
)
from rig.formats.importers.urdf_joint_chain import MOVING, limits_text, load_joint_chain
from rig.model.mechanism_geometry_classes import Arm
from rig.model.pose import pose


@dataclass(frozen=True, slots=True, eq=False)
class ReadArm:
    """An Arm read from a file. name : of the machine; joint_names : as the file has them; source : where it comes from
    lines : what was read of each joint, and what does not count
    """

    arm: Arm
    name: str
    joint_names: tuple[str, ...]
    source: str
    lines: tuple[str, ...]

    def rig_toml(self, name: str | None = None) -> str:
        """rig.toml text of it, with its joints' names as comments. name : of the machine, None for the file's"""
        arm, lines = self.arm, [f"# {_comment(line)}" for line in self.lines]
        columns = 5 if arm.rows[:, 4].any() else 4
        joints = [
            f"  {json.dumps([*(['prismatic'] if slide else []), *row[:columns]])},  # {axis}: {_comment(name)}"
            for row, slide, axis, name in zip(arm.rows.tolist(), arm.slides, arm.axes, self.joint_names)
        ]
        limits = [f"  [{low!r}, {high!r}]," for low, high in arm.limits.tolist()]
        stands = [
            f"{key} = {_pose(T)}   # {text}"
            for key, T, text in (
                ("base", arm.base, "frame 0 of the rows, in the frame of poses"),
                ("tool", arm.tool, "what is measured, in the last frame of the rows"),
            )
            if not _is_identity(T) and not (key == "tool" and arm.hands)
        ]
        return "\n".join(
            [
                'schema = "rig/1"',
                f"name = {json.dumps(name or self.name)}",
                f"# from {_comment(self.source)}",
                *lines,
                "",
                "[mechanism]",
                'kind = "arm"',
                "# Denavit-Hartenberg, distal: theta (rad), d (m), a (m), alpha (rad)"
                + (", Hayati's beta (rad)" if columns == 5 else ""),
                "joints = [",
                *joints,
                "]",
                *([f"joint_names = {json.dumps(self.joint_names)}"] if self.joint_names != arm.axes else []),
                "limits = [",
                *limits,
                "]",
                *stands,
                *_branch_and_hand_tables(arm),
                "",
            ]
        )


def _branch_and_hand_tables(arm: Arm) -> list[str]:
    """Lines of the tables of an arm's branches, hands and couplings; none of an arm with one hand and none coupled."""
    out: list[str] = []
    for branch in arm.branches:
        out += ["", "[[mechanism.branch]]", f"joint = {branch.joint + 1}", f"parent = {branch.parent + 1}"]
        out += [] if _is_identity(branch.mount) else [f"mount = {_pose(branch.mount)}"]
    for hand in arm.hands:
        out += ["", "[[mechanism.hand]]", f"name = {json.dumps(hand.name)}", f"joint = {hand.joint + 1}"]
        out += [] if _is_identity(hand.tool) else [f"tool = {_pose(hand.tool)}"]
    for one in arm.couplings:
        out += ["", "[[mechanism.coupling]]", f"joint = {one.joint + 1}", f"leader = {one.leader + 1}"]
        out += [f"multiplier = {one.multiplier!r}", f"offset = {one.offset!r}"]
    return out


def _pose(T: RigidTransform) -> str:
    return f"{{ position = {T.translation.tolist()}, rotvec = {T.rotation.as_rotvec().tolist()} }}"


def _comment(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _is_identity(T: RigidTransform) -> bool:
    return not T.translation.any() and T.rotation.magnitude() == 0


@dataclass(frozen=True, slots=True)
class ArmFileOptions:
    """The file that states an arm. urdf : with tips and root, links of it, none for its only end and its first; several
    tips are the hands of one arm
    dh : table of Denavit-Hartenberg rows, with modified, whether in Craig's convention
    poe : table of screw axes, with home, the hand's pose x y z rx ry rz (6,) m and rad while all joint values are 0
    units : of either table's figures without a unit in the header, as "mm,deg"
    Raises RigError for options that do not belong to each other
    """

    urdf: Path | None = None
    tips: tuple[str, ...] = ()
    root: str | None = None
    dh: Path | None = None
    modified: bool = False
    units: str | None = None
    poe: Path | None = None
    home: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        given = [f"--{name}" for name in ("urdf", "dh", "poe") if getattr(self, name) is not None]
        if len(given) > 1:
            raise RigError(f"{' and '.join(given)} both state the arm; give only one")
        if (self.poe is None) != (self.home is None):
            raise RigError(
                "--poe FILE.csv states the screw axes, --home X Y Z RX RY RZ where the hand is at 0 (m, rad): give both"
            )
        if (self.tips or self.root is not None) and self.urdf is None:
            raise RigError("--tip and --root name links of a URDF; give --urdf FILE.urdf")
        if self.modified and self.dh is None:
            raise RigError("--modified applies to a table of Denavit-Hartenberg rows; give --dh FILE.csv")
        if self.units is not None and self.dh is None and self.poe is None:
            raise RigError("--units applies to a table of joints; give --dh FILE.csv or --poe FILE.csv")

    @property
    def file(self) -> Path | None:
        """The file, None where none is named."""
        return self.urdf or self.dh or self.poe


def read_arm_file(options: ArmFileOptions) -> ReadArm | None:
    """ReadArm (arm, joint names, source, lines) of the file that the options name, or None.

    Raises FileError as load_joint_chain of rig.formats.importers.urdf_joint_chain, and as
        rig.formats.importers.arm_joint_tables_of_dh_rows_or_screw_axes
    """
    if options.urdf is not None:
        return read_urdf_arm(options.urdf, options.tips, options.root)
    if options.poe is not None and options.home is not None:
        T_home = pose(options.home[:3], options.home[3:])
        table = load_product_of_exponentials_table(options.poe, T_home, options.units)
        return _arm_of_table(options.poe, table, "screw axes, converted to distal rows")
    return None if options.dh is None else read_dh_table_arm(options.dh, options.modified, options.units)


def read_urdf_arm(path: Path, tips: tuple[str, ...] = (), root: str | None = None) -> ReadArm:
    """ReadArm (arm, joint names, source, lines) of a URDF.

    Its joints are those from a root link to a tip, or to several; its forward kinematics is the URDF's.
    Raises FileError as rig.formats.importers.urdf_joint_chain.load_joint_chain
    """
    if len(tips) > 1:
        return _read_urdf_arm_with_several_hands(path, tips, root)
    chain = load_joint_chain(path, tips[0] if tips else None, root)
    placed = denavit_hartenberg_rows_of_joint_axes(*chain.axes_at_zero())
    moving = chain.moving
    couplings, limits = couplings_and_limits_of_joints(path, moving)
    arm = Arm(
        placed.rows,
        limits,
        placed.base,
        placed.tool,
        np.array([joint.kind == "prismatic" for joint in moving]),
        couplings=couplings,
    )
    source = f"{path.name}, link {chain.root} to link {chain.tip}"
    lines = (*(joint.line_of_text for joint in chain.joints), *chain.remarks)
    return ReadArm(arm, chain.name, tuple(joint.name for joint in moving), source, lines)


def _read_urdf_arm_with_several_hands(path: Path, tips: tuple[str, ...], root: str | None) -> ReadArm:
    """The same of an arm whose hands are several tips."""
    arm, chains = urdf_arm_with_several_hands_and_its_joint_chains(path, tips, root)
    joints = {joint.name: joint for chain in chains for joint in chain.joints}
    names = [joint.name for joint in joints.values() if joint.kind in MOVING]
    shared = [name for name in names if all(name in [joint.name for joint in chain.moving] for chain in chains)]
    lines = [joint.line_of_text for joint in joints.values()]
    lines.append(f"joints that all hands share: {', '.join(shared) or 'none'}")
    remarks = dict.fromkeys(line for chain in chains for line in chain.remarks if not _names_any(line, names))
    source = f"{path.name}, link {chains[0].root} to links {', '.join(tips)}"
    return ReadArm(arm, chains[0].name, tuple(names), source, (*lines, *remarks))


def _names_any(remark: str, names: list[str]) -> bool:
    """Whether a remark on a joint that is left out names one that another hand has."""
    return any(remark.startswith(f"ignored joint {name}:") for name in names)


def read_dh_table_arm(path: Path, is_modified: bool = False, units: str | None = None) -> ReadArm:
    """ReadArm (arm, joint names, source, lines) of a table of Denavit-Hartenberg rows.

    Raises FileError as rig.formats.importers.arm_joint_tables_of_dh_rows_or_screw_axes.load_denavit_hartenberg_table
    """
    convention = "modified (Craig) rows, converted to distal ones" if is_modified else "distal rows"
    return _arm_of_table(path, load_denavit_hartenberg_table(path, is_modified, units), convention)


def _arm_of_table(path: Path, table: JointTable, convention: str) -> ReadArm:
    """ReadArm of a table. convention : of the file's rows, in words"""
    arm = Arm(table.placed.rows, table.limits, table.placed.base, table.placed.tool, table.slides)
    lines = [
        f"read joint {name}: {MOVING[2] if slide else MOVING[0]}, {read}limits{' assumed' if assumed else ''} "
        f"{limits_text(limits, slide)}"
        for name, slide, assumed, limits, read in zip(
            table.names, table.slides, table.assumed, table.limits, table.axis_texts or [""] * len(table.names)
        )
    ]
    return ReadArm(arm, path.stem, table.names, f"{path.name}, {convention}", tuple(lines))
