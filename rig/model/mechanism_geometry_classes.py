"""Geometry classes of mechanisms.

Hexapod, planar, arm, chain, of a file, free: frozen dataclasses in m and rad.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers, freeze_array, read_only_float_array_of_shape
from rig.model.arm_hands_effect_places_and_tolerances import (
    Branch,
    Coupling,
    Hand,
    coupling_matrix,
    hand_number,
    joint_carries_joint_matrix,
    joint_parent_indices,
)
from rig.model.checked_loading_of_user_kinematics_file import load_checked_kinematics_source
from rig.model.mechanism_base_class import StatedMechanism
from rig.model.user_kinematics_file import KinematicsFile

WORDS = {"m": "slide", "rad": "joint"}  # what an axis of a kinematics file is called, by its unit


STRUT_COUNTS = (6, 7, 8)  # of a Gough-Stewart platform


@dataclass(frozen=True, slots=True, eq=False)
class Hexapod(StatedMechanism):
    """Gough-Stewart platform: six to eight struts of variable length between a base and a platform.

    base_joints : (s, 3) m, base frame; platform_joints : (s, 3) m, platform frame
    strut_range : (s, 2) m, shortest and longest commanded length; home : T_base_platform
    strut_zeros : (s,) m, what a strut is longer than its command says (zero as the owner believes it); none by default
    followers : numbers, from 0, of the struts beyond six that bear no force and follow the platform, so that their
        commanded lengths are those that they read; () where every strut is driven
    """

    base_joints: Floats
    platform_joints: Floats
    strut_range: Floats
    home: RigidTransform
    strut_zeros: Floats = field(default_factory=lambda: np.zeros(0))
    followers: tuple[int, ...] = ()
    kind: ClassVar[Literal["hexapod"]] = "hexapod"
    closes_loops: ClassVar[bool] = True

    def __post_init__(self) -> None:
        count = len(self.base_joints)
        if count not in STRUT_COUNTS:
            raise ValueError(f"base_joints: expected six, seven or eight struts, got {count}")
        if not np.size(self.strut_zeros):
            object.__setattr__(self, "strut_zeros", np.zeros(count))
        for name, shape in (
            ("base_joints", (count, 3)),
            ("platform_joints", (count, 3)),
            ("strut_range", (count, 2)),
            ("strut_zeros", (count,)),
        ):
            freeze_array(self, name, shape)
        if self.followers and (len(set(self.followers)) != count - 6 or not set(self.followers) <= set(range(count))):
            raise ValueError(
                f"followers: expected {count - 6} of {count} struts, numbered from 0, got {self.followers}"
            )

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the commanded axes, as commands.csv heads its columns."""
        return tuple(f"l{i + 1}" for i in range(len(self.base_joints)))

    @property
    def axis_words(self) -> tuple[str, ...]:
        """What each of its axes is called."""
        return ("strut",) * len(self.base_joints)

    @property
    def stages(self) -> tuple["Stage", ...]:
        """The mechanisms stacked on its base: only itself."""
        return (self,)

    @property
    def home_pose(self) -> RigidTransform:
        """T_base_platform at home, as its owner states it."""
        return self.home

    @property
    def plates(self) -> tuple[Floats, Floats]:
        """(base joints, platform joints) (s, 3) m, each in its own plate's frame."""
        return self.base_joints, self.platform_joints

    @property
    def strut_joints(self) -> tuple[Floats, Floats]:
        """(base joints, platform joints) (s, 3) m, each in its own plate's frame."""
        return self.base_joints, self.platform_joints

    @property
    def reach(self) -> float:
        """m, its longest strut at full length."""
        return float(self.strut_range.max())

    @property
    def geometry_arrays(self) -> dict[str, Floats]:
        """{name: array} of the figures of its geometry that a calibration fits, m."""
        return {name: getattr(self, name) for name in ("base_joints", "platform_joints", "strut_zeros")}


@dataclass(frozen=True, slots=True, eq=False)
class Planar2(StatedMechanism):
    """Two struts from two base joints to one common hinge in the plane z = 0 (configuration-space patent, fig. 1).

    base_joints : (2, 2) m; strut_range : (2, 2) m; strut_zeros : (2,) m. The hinge is on the left of base joint 1 -> 2.
    """

    base_joints: Floats
    strut_range: Floats
    strut_zeros: Floats = field(default_factory=lambda: np.zeros(2))
    kind: ClassVar[Literal["planar2"]] = "planar2"
    closes_loops: ClassVar[bool] = True
    pose_coordinates: ClassVar[tuple[int, ...]] = (0, 1)

    def __post_init__(self) -> None:
        for name, shape in (("base_joints", (2, 2)), ("strut_range", (2, 2)), ("strut_zeros", (2,))):
            freeze_array(self, name, shape)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the commanded axes, as commands.csv heads its columns."""
        return ("l1", "l2")

    @property
    def axis_words(self) -> tuple[str, ...]:
        """What each of its axes is called."""
        return ("strut", "strut")

    @property
    def stages(self) -> tuple["Stage", ...]:
        """The mechanisms stacked on its base: only itself."""
        return (self,)

    @property
    def strut_joints(self) -> tuple[Floats, Floats]:
        """(base joints (2, 3) m in the base frame, the hinge once for each strut (2, 3) m in its own)."""
        return np.pad(self.base_joints, ((0, 0), (0, 1))), np.zeros((2, 3))

    @property
    def reach(self) -> float:
        """m, its longest strut at full length."""
        return float(self.strut_range.max())

    @property
    def geometry_arrays(self) -> dict[str, Floats]:
        """{name: array} of the figures of its geometry that a calibration fits, m."""
        return {name: getattr(self, name) for name in ("base_joints", "strut_zeros")}


@dataclass(frozen=True, slots=True, eq=False)
class Arm(StatedMechanism):
    """Serial arm: T_base_platform = base A_1(q_1) .. A_n(q_n) tool.

    joints : (n, 4 or 5) theta (rad), d (m), a (m), alpha (rad), optional Hayati beta (rad): distal Denavit-Hartenberg,
    A_i = Rot_z(theta_i + q_i) Trans_z(d_i) Trans_x(a_i) Rot_x(alpha_i) Rot_y(beta_i); limits : (n, 2) rad
    base : where the arm's own frame 0 stands in the frame of poses; tool : the platform (hand, target) in frame n
    slides : (n,) bool, joints that are prismatic: Rot_z(theta_i) Trans_z(d_i + q_i), q_i and its limits in m; none by
        default
    branches : joints that stand on another link than that of the joint before them; hands : of an arm with several, the
        tool then that of hand number `hand`, from 0, of which forward kinematics and Jacobians are
    couplings : joints that follow others; their values are computed from the leaders', whatever is given for them
    """

    joints: Floats
    limits: Floats
    base: RigidTransform = field(default_factory=RigidTransform.identity)
    tool: RigidTransform = field(default_factory=RigidTransform.identity)
    slides: Booleans = field(default_factory=lambda: np.zeros(0, bool))
    branches: tuple[Branch, ...] = ()
    hands: tuple[Hand, ...] = ()
    hand: int = 0
    couplings: tuple[Coupling, ...] = ()
    kind: ClassVar[Literal["arm"]] = "arm"
    axis_unit: ClassVar[Literal["m", "rad"]] = "rad"
    placements: ClassVar[tuple[str, ...]] = ("base", "tool")

    def __post_init__(self) -> None:
        freeze_array(self, "joints", (None, None))
        if self.joints.shape[1] not in (4, 5):
            raise ValueError(f"joints: expected rows of 4 or 5 figures, got {self.joints.shape[1]}")
        freeze_array(self, "limits", (len(self.joints), 2))
        slides = self.slides if np.size(self.slides) else np.zeros(len(self.joints))
        object.__setattr__(self, "slides", read_only_float_array_of_shape(slides, (len(self.joints),), "slides") > 0)
        joint_parent_indices(len(self.joints), self.branches)
        coupling_matrix(len(self.joints), self.couplings)
        if self.hands:
            object.__setattr__(self, "tool", self.hands[self.hand].tool)

    @property
    def parents(self) -> Integers:
        """(n,) index of the joint whose link carries each joint, -1 for the base."""
        return joint_parent_indices(len(self.joints), self.branches)

    @property
    def followers(self) -> Booleans:
        """(n,) bool, the joints that follow others."""
        return np.isin(np.arange(len(self.joints)), [one.joint for one in self.couplings])

    @property
    def coupled(self) -> Booleans:
        """(n,) bool, the joints that follow others or lead them."""
        return self.followers | np.isin(np.arange(len(self.joints)), [one.leader for one in self.couplings])

    @property
    def motion_by_command(self) -> Floats:
        """(n, n) motion of the joints by commanded motion: 0 from followers, which their leaders move."""
        return coupling_matrix(len(self.joints), self.couplings)

    def with_followers(self, q: Floats) -> Floats:
        """Joint values (..., n) rad or m with those of followers as their leaders have them."""
        if not self.couplings:
            return q
        out = np.array(q, float)
        for one in self.couplings:
            out[..., one.joint] = one.multiplier * out[..., one.leader] + one.offset
        return out

    @property
    def moving(self) -> Booleans:
        """(n,) bool, the joints that move the hand."""
        last = self.hands[self.hand].joint if self.hands else len(self.joints) - 1
        return np.asarray(joint_carries_joint_matrix(self.parents)[:, last])

    def of_hand(self, hand: str | int) -> Self:
        """The arm seen at one of its hands, by name or number (from 0). Raises RigError for a hand that it lacks."""
        return replace(self, hand=hand_number(self, hand))

    def with_ends(self, base: RigidTransform | None = None, tool: RigidTransform | None = None) -> Self:
        """The arm with another base, or another tool of the hand that it is seen at; None leaves an end."""
        base, tool = (self.base if base is None else base), (self.tool if tool is None else tool)
        hands = tuple(replace(one, tool=tool) if k == self.hand else one for k, one in enumerate(self.hands))
        return replace(self, base=base, tool=tool, hands=hands)

    @property
    def rows(self) -> Floats:
        """(n, 5) theta, d, a, alpha, beta; beta is 0 where it is not stated."""
        return np.pad(self.joints, ((0, 0), (0, 5 - self.joints.shape[1])))

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the commanded axes, as commands.csv heads its columns."""
        return tuple(f"q{i + 1}" for i in range(len(self.joints)))

    @property
    def axis_words(self) -> tuple[str, ...]:
        """What each of its axes is called."""
        return tuple("slide" if slide else "joint" for slide in self.slides)

    @property
    def stages(self) -> tuple["Stage", ...]:
        """The mechanisms stacked on its base: only itself."""
        return (self,)

    @property
    def link_rows(self) -> Floats:
        """(n, 5) theta, d, a, alpha, beta of the links between its joints."""
        return self.rows

    @property
    def reach(self) -> float:
        """m, how far links and slides reach at the most."""
        return float(np.abs(self.joints[:, 1:3]).sum() + np.abs(self.limits[self.slides]).max(axis=1).sum())

    @property
    def geometry_arrays(self) -> dict[str, Floats]:
        """{name: array} of the figures of its geometry that a calibration fits, m and rad."""
        return {"joints": self.rows}


Stage = Hexapod | Planar2 | Arm


@dataclass(frozen=True, slots=True, eq=False)
class Chain(StatedMechanism):
    """Mechanisms one upon the other: the platform of each stage is the base of the next. stages : two or more, from the
    base up.
    """

    stages: tuple[Stage, ...]
    kind: ClassVar[Literal["chain"]] = "chain"

    def __post_init__(self) -> None:
        if len(self.stages) < 2:
            raise ValueError(f"stages: a chain has two or more, got {len(self.stages)}")
        if any(len(stage.axes) > 6 for stage in self.stages if stage.plates is not None):
            raise ValueError("stages: a stage of a chain has six struts at most")

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the commanded axes, as commands.csv heads its columns: s1q1 .., s2l1 .."""
        return tuple(f"s{i + 1}{axis}" for i, stage in enumerate(self.stages) for axis in stage.axes)

    @property
    def axis_words(self) -> tuple[str, ...]:
        """What each of its axes is called in its own stage."""
        return tuple(word for stage in self.stages for word in stage.axis_words)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of what its stages move below the last platform: "stage 1" .."""
        return tuple(f"stage {i + 1}" for i in range(len(self.stages) - 1))


@dataclass(frozen=True, slots=True, eq=False)
class FileMechanism(StatedMechanism):
    """A mechanism of a kinematics file. file : its path, for messages; source : its text
    parameters : (p,) m or rad, in the file's order
    """

    file: str
    source: str
    parameters: Floats
    kind: ClassVar[Literal["file"]] = "file"
    closes_loops: ClassVar[bool] = True

    def __post_init__(self) -> None:
        freeze_array(self, "parameters", (len(self.stated.nominal),))

    @property
    def stated(self) -> KinematicsFile:
        """What the file states. Raises FileError for a file that cannot be used"""
        return load_checked_kinematics_source(self.source, self.file)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the commanded axes, as commands.csv heads its columns."""
        return tuple(axis.name for axis in self.stated.axes)

    @property
    def axis_words(self) -> tuple[str, ...]:
        """What each of its axes is called: "slide" in m, "joint" in rad."""
        return tuple(WORDS[axis.unit] for axis in self.stated.axes)

    @property
    def axis_unit(self) -> Literal["m", "rad"]:  # type: ignore[override]
        """Unit of the travel of its axes, "m" where there are both."""
        return "rad" if all(axis.unit == "rad" for axis in self.stated.axes) else "m"

    @property
    def pose_coordinates(self) -> tuple[int, ...]:  # type: ignore[override]
        """Which of a pose's six coordinates its platform can change."""
        return self.stated.freedoms

    @property
    def stages(self) -> tuple["FileMechanism", ...]:
        """The mechanisms stacked on its base: only itself."""
        return (self,)

    @property
    def home_pose(self) -> RigidTransform:
        """T_base_platform at home, as its owner states it."""
        return RigidTransform.from_matrix(self.stated.home)

    @property
    def geometry_arrays(self) -> dict[str, Floats]:
        """{name: array} of the figures of its geometry that a calibration fits, m or rad."""
        return {"parameters": self.parameters}

    @property
    def files(self) -> dict[str, str]:
        """{name: text} of the file that states its kinematics, beside its rig.toml."""
        return {Path(self.file).name: self.source}


@dataclass(frozen=True, slots=True)
class Free(StatedMechanism):
    """Moved by hand or by another machine: there is nothing to command."""

    kind: ClassVar[Literal["free"]] = "free"
    axes = ()
    stages = ()
