"""Reachable poses of the stated and of the corrected machine: poses lost and gained.

Source: configuration-space patent, [0029] and claim 5 (the poses that the control function can give, and those that the
    machine really takes)
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.correction import AnyCorrection, commands_with_pose, filter_closed_commands
from rig.arrays import Booleans, Floats
from rig.errors import NotConverged
from rig.model import mechanisms
from rig.model.pose import pose_difference

SAME = 1e-6  # m and rad, within which a command gives the pose that it was found for


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """What one machine reaches. commands : (n, axes) m or rad, all over its strokes, those that close on a pose;
    T_base_platform : RigidTransform (n,), the poses; needed : (n, axes) what the other machine is to be commanded for
    them, NaN where nothing was found; out : (n,) bool, whether the other machine does not reach them"""

    commands: Floats
    T_base_platform: RigidTransform
    needed: Floats
    out: Booleans


def uncorrected_machine(correction: AnyCorrection) -> AnyCorrection:
    """The uncorrected machine: nominal, as a Correction that corrects nothing."""
    return replace(
        correction, fitted=correction.nominal, remainder=(None,) * len(correction.remainder), extension=None, posed=()
    )


def reachable_side(machine: AnyCorrection, other: AnyCorrection, commands: Floats) -> Side:
    """Reachable poses (Side) of one machine at commands (m, axes), compared with another's.
    Raises NotConverged where none of them closes on a pose.
    """
    commands, T = commands_with_pose(commands, machine)
    needed = other.near(T, commands)
    return Side(commands, T, needed, ~_reached(needed, T, other))


def is_pose_lost(correction: AnyCorrection, configurations: Floats) -> Booleans:
    """Whether the nominal pose at configurations (n, axes) is lost: out of the corrected machine's reach.

    True as well for those that close on no pose
    """
    configurations = np.asarray(configurations, float)
    out = np.ones(len(configurations), bool)
    try:
        index, T = filter_closed_commands(configurations, uncorrected_machine(correction).predict)
    except NotConverged:
        return out
    out[index] = ~_reached(correction.near(T, configurations[index]), T, correction)
    return out


def _reached(needed: Floats, T: RigidTransform, machine: AnyCorrection) -> Booleans:
    """(n,) bool: whether commands (n, axes) are within the strokes and give the poses (n,), in the assembly in which
    the machine stands.
    """
    known = cast(Booleans, np.isfinite(needed).all(axis=1))
    known[known] = (mechanisms.kinematics_of(machine.nominal).limits(needed[known], machine.nominal) == 0).all(axis=1)
    inside, reached = np.flatnonzero(known), np.zeros(len(needed), bool)
    if not len(inside):
        return reached
    try:
        index, given = filter_closed_commands(needed[inside], machine.predict)
    except NotConverged:
        return reached
    there = inside[index]
    reached[there] = np.abs(pose_difference(given, T[there])).max(axis=1) < SAME
    return reached
