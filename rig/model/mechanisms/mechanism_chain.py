"""Chain of mechanisms, each on the one before.

Each stands on the platform of the one before: forward and inverse kinematics, Jacobian.

T_base_platform = T_1(x_1) T_2(x_2) .. T_n(x_n): the platform of each stage is the base of the next. More axes than six
leave the inverse a choice: the configuration nearest to the middle of all travels, each axis in shares of its own.
"""

from collections.abc import Iterator
from types import ModuleType
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers
from rig.errors import NotConverged, Unreachable
from rig.model.mechanism_geometry_classes import Arm, Chain, Hexapod, Stage
from rig.model.mechanisms import arm_kinematics_limits_and_loads as arm
from rig.model.mechanisms import hexapod, two_strut_planar_mechanism
from rig.model.pose import pose_difference, skew

AXIS, UNIT = "axis", "m"
KINDS: dict[str, ModuleType] = {"hexapod": hexapod, "planar2": two_strut_planar_mechanism, "arm": arm}
TOLERANCE = 1e-12  # m and rad
GOOD = 1e-10  # m and rad; what counts as solved
MAX_ITERATIONS = 60
CENTRED = 0.5  # of the way to the middle that one step goes within what leaves the pose as it is
LONGEST = 0.25  # of a travel, of one step


def stages_and_values(values: Floats, chain: Chain) -> Iterator[tuple[Stage, Floats]]:
    """Stages of a chain, each with its values (..., axes).

    From commanded values (..., axes of all).
    Raises ValueError for another number of values
    """
    values = np.asarray(values, float)
    if values.shape[-1:] != (len(chain.axes),):
        raise ValueError(f"expected values (..., {len(chain.axes)}) m or rad, got shape {values.shape}")
    at = 0
    for stage in chain.stages:
        yield stage, values[..., at : at + len(stage.axes)]
        at += len(stage.axes)


def stage_transforms(values: Floats, chain: Chain) -> list[RigidTransform]:
    """Transforms (...) of every stage's platform in the stage's own base at commanded values."""
    return [KINDS[stage.kind].forward(own, stage) for stage, own in stages_and_values(values, chain)]


def stage_poses(values: Floats, chain: Chain) -> list[RigidTransform]:
    """Poses T_base_stage (...) of every stage's platform in the chain's base at commanded values."""
    out: list[RigidTransform] = []
    for T in stage_transforms(values, chain):
        out.append(out[-1] * T if out else T)
    return out


def forward(values: Floats, chain: Chain, guess: RigidTransform | None = None) -> RigidTransform:
    """Forward kinematics: T_base_platform (...) of commanded values (..., axes of all).

    guess : unused.
    """
    return stage_poses(values, chain)[-1]


def stage_tangent_maps(transforms: list[RigidTransform]) -> list[Floats]:
    """Maps (..., 6, 6) of each stage's tangent to the chain's tangent.

    From the stages' transforms.
    """
    after, out = np.broadcast_to(np.eye(4), transforms[0].as_matrix().shape), []
    for T in reversed(transforms):
        R, t = after[..., :3, :3], after[..., :3, 3]
        back = np.zeros((*R.shape[:-2], 6, 6))
        back[..., :3, :3] = back[..., 3:, 3:] = np.swapaxes(R, -1, -2)
        back[..., :3, 3:] = np.swapaxes(R, -1, -2) @ -skew(t)
        out.append(back)
        after = T.as_matrix() @ after
    return out[::-1]


def jacobian(values: Floats, chain: Chain) -> Floats:
    """Jacobian (..., 6, axes of all) of the pose's tangent with the commanded values."""
    parts = stage_transforms(values, chain)
    columns = [
        back @ _stage_jacobian(own, T, stage)
        for (stage, own), T, back in zip(stages_and_values(values, chain), parts, stage_tangent_maps(parts))
    ]
    return np.concatenate(columns, axis=-1)


def _stage_jacobian(values: Floats, T: RigidTransform, stage: Stage) -> Floats:
    if isinstance(stage, Arm):
        return arm.jacobian(values, stage)
    if isinstance(stage, Hexapod):
        return cast(Floats, np.linalg.inv(hexapod.jacobian(T, stage)))
    return cast(Floats, np.linalg.pinv(two_strut_planar_mechanism.jacobian(T, stage)))


def inverse(T_base_platform: RigidTransform, chain: Chain, guess: Floats | None = None) -> Floats:
    """Inverse kinematics: commanded values (..., axes of all) of poses, nearest to the middle of all travels.

    Damped steps, what leaves the pose as it is spent on the way to the middle (Liegeois 1977)
    Raises Unreachable with the index of poses to which none leads
    """
    target = T_base_platform
    if len(target.shape) != 1:
        target = RigidTransform.from_matrix(target.as_matrix().reshape(-1, 4, 4))
    low, high = travel_ranges(chain).T
    middle, span = (low + high) / 2, high - low
    x = np.broadcast_to(middle if guess is None else guess, (len(target), len(middle))).copy()
    going: Integers
    left, going = np.full(len(x), np.inf), np.arange(len(x))
    for _ in range(MAX_ITERATIONS):
        going, error = _misses(x, target, going, chain)
        left[going] = np.maximum(np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1))
        J = jacobian(x[going], chain) * span
        pseudo = np.linalg.pinv(J, rcond=1e-9)
        centre = CENTRED * (middle - x[going]) / span
        step = (pseudo @ error[..., None])[..., 0] + centre - (pseudo @ (J @ centre[..., None]))[..., 0]
        step /= np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / LONGEST)
        x[going] += span * step
        if np.abs(step).max(initial=0) < TOLERANCE:
            break
    going, error = _misses(x, target, going, chain)
    left[going] = np.maximum(np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1))
    failed = np.flatnonzero(~(left <= GOOD))
    if len(failed):
        raise Unreachable(
            f"{len(failed)} of {len(left)} poses are out of the chain's reach:",
            failed,
            [f"pose {i}: no command comes nearer than {left[i] * 1e3:.3g} mm or mrad" for i in failed],
        )
    return x.reshape(*T_base_platform.shape, -1)


def _misses(x: Floats, target: RigidTransform, going: Integers, chain: Chain) -> tuple[Integers, Floats]:
    """(those of the poses (k,) at whose values all stages close, (m, 6) what they miss their targets by)."""
    while len(going):
        try:
            return going, pose_difference(forward(x[going], chain), target[going])
        except NotConverged as error:
            going = np.delete(going, error.index)
    return going, np.zeros((0, 6))


def signed_limit_excess(values: Floats, chain: Chain) -> Floats:
    """Excess (..., axes) m or rad of commanded values over their limits.

    Negative below, positive above, 0 inside.
    """
    return np.concatenate(
        [KINDS[stage.kind].signed_limit_excess(own, stage) for stage, own in stages_and_values(values, chain)], axis=-1
    )


def travel_ranges(chain: Chain) -> Floats:
    """Travel (axes of all, 2) m or rad of the axes.

    Least and greatest commanded value.
    """
    return np.concatenate([KINDS[stage.kind].travel_ranges(stage) for stage in chain.stages])


def home_values(chain: Chain) -> Floats:
    """Home values (axes of all,) m or rad.

    The home of every stage.
    """
    return np.concatenate([KINDS[stage.kind].home_values(stage) for stage in chain.stages])


def axis_forces_and_torques(T: RigidTransform, values: Floats, chain: Chain, wrench: Floats) -> Floats:
    """Axis forces and torques (n, axes of all) N or N m that hold a wrench.

    Those that hold a wrench (n, 6) on the platform, each alone.
    """
    return -np.einsum("nij,ni->nj", jacobian(values, chain), wrench)


def link_weight_loads(T: RigidTransform, values: Floats, chain: Chain, gravity: Floats) -> Floats:
    """Loads of link weight (n, axes of all, 0), which a chain has none of.

    The weight of a chain's stages is not modelled.
    """
    return np.zeros((*np.shape(values), 0))


def axis_deviation_and_sway_by_member_growth(
    T: RigidTransform, values: Floats, chain: Chain, share: Floats
) -> tuple[Floats, Floats]:
    """Axis deviation and sway by growth of members, which are the stages'.

    Deviation (n, axes of all) and sway (n, 6), by shares (n, axes of all) of the growth.
    """
    parts, at, deviations, sway = stage_transforms(values, chain), 0, [], np.zeros((len(share), 6))
    for (stage, own), part, back in zip(stages_and_values(values, chain), parts, stage_tangent_maps(parts)):
        longer, moved = KINDS[stage.kind].axis_deviation_and_sway_by_member_growth(
            part, own, stage, share[:, at : at + len(stage.axes)]
        )
        deviations.append(longer)
        sway = sway + (back @ moved[..., None])[..., 0]
        at += len(stage.axes)
    return np.concatenate(deviations, axis=1), sway


def inverse_kinematics_jacobian(T: RigidTransform, values: Floats, chain: Chain) -> Floats:
    """Jacobian (n, axes of all, 6) of inverse kinematics.

    Least change of the axes with the pose's tangent.
    """
    return np.asarray(np.linalg.pinv(jacobian(values, chain)))


def jacobian_rows_by_axis(T: RigidTransform, values: Floats, chain: Chain) -> Floats:
    """Rows (n, axes of all, 6) of the Jacobian, one for each axis, at values (n, axes of all)."""
    return np.swapaxes(jacobian(values, chain), 1, 2)


def link_points(values: Floats, chain: Chain) -> None:
    """None for any values (n, axes): a chain is drawn without links."""
    return None


def strut_ends(T: RigidTransform, chain: Chain) -> None:
    """None: a chain is drawn without struts."""
    return None
