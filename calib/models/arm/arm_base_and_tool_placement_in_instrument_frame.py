"""Placement of an arm's base and tool in an instrument's frame.

For given rotation X of the base, what positions say of the target z on the hand and of the base's place t is linear,
and what is then left is a quadratic function of X alone: p = X (F z + f) + t, so X'p - f = F z + X't,
docs/mathematics.md (8), free of X on the right. It is looked at over rotations that cover all of SO(3); measured
rotations add how well X F Z = M holds with the best Z. The best few are refined with base, tool and the joints' zeros,
these held near the maker's; the best of them is the answer. So a hand that turns about one axis alone, whose rotations
leave a whole family of answers, is placed by its positions, and zeros that are off mislead nobody.
Source: Shah, J. Mechanisms Robotics 5, 2013 (robot-world and hand-eye); Alexa, Super-Fibonacci spirals, CVPR 2022
    (rotations that cover)
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_error_model_and_instrument_observations import Observations, tool_parameter_slice
from rig.array_and_json_types import Floats
from rig.errors import NotEnoughData, RigError
from rig.model.arm_hands_effect_places_and_tolerances import selected_hand_name
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import log

LEAST = {"pose": 3, "position": 6, "orientation": 4, "distance": 10, "direction": 4}
TELLS = 1e-6  # of the greatest eigenvalue; orientations whose second least is smaller leave a family of answers
ROTATIONS = 4000  # looked at; none of SO(3) lies farther than some 12 degrees from one
STARTS, LEADING = 12, 3  # refined roughly on few observations; and of these to the end on more
APART = np.radians(25)  # between two of them
LOOKED_AT, ROUGHLY = (
    150,
    (40, 8),
)  # observations that the search uses; and observations and steps of the rough refinement
HUBER = 3.0  # times the median; an observation farther off counts less
ZERO = 0.1  # rad, of a slide m; what a joint's zero may be off by
COARSE = (
    0.03,
    0.05,
)  # m, rad; what an arm with such zeros leaves, for weighing rotations against positions in the search
FINE = (1e-3, 2e-3)  # m, rad; the same once zeros are free
AWAY, REACH = 3.0, 0.3  # m, what bases stand away by and targets on hands reach: what poses leave open goes no farther
TURN = 3.0  # rad, the same of rotations from where the refinement begins
STEPS, SETTLED = 60, 1e-7
FITS = 0.02  # m; a placement that leaves more (median) is none
TWOFOLD = 1.5  # times what the best leaves, up to which another place fits as well
SPREAD = 0.03  # of the greatest singular value of directions; the second of those that hold a rotation is greater
SAME = 0.05  # rad between the bases of placements that are one


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """arm : Arm with base and tool found and its zeros moved; left : m, the median that it leaves in position."""

    arm: Arm
    left: float


def place_base_and_tool_of_arm(
    observations: Observations, arm: Arm, is_base_unknown: bool, is_tool_unknown: bool
) -> Arm:
    """Arm with its base and tool solved for, each where it is unknown, from observations.

    Good to what the arm's own errors leave; least squares goes on from there. What the observations do not determine
    stays as stated: the base's rotation with distances, where on the hand a direction is seen.

    Raises NotEnoughData for too few observations, RigError where no placement fits or two
    different ones fit alike
    """
    if not (is_base_unknown or is_tool_unknown):
        return arm
    if observations.hand is not None:  # the first measured hand places the base, which then holds for the others
        for k, number in enumerate(np.unique(observations.hand).tolist()):
            own = replace(observations.take(observations.hand == number), hand=None)
            arm = place_base_and_tool_of_arm(own, arm.of_hand(number), is_base_unknown and not k, is_tool_unknown)
        return arm.of_hand(0)
    if len(observations) < LEAST[observations.kind]:
        of_hand = f" of the hand {selected_hand_name(arm)!r}" if arm.hands else ""
        raise NotEnoughData(
            f"{len(observations)} observations of a {observations.kind}{of_hand} cannot locate the instrument; "
            f"it takes {LEAST[observations.kind]}"
        )
    if observations.kind == "distance":
        return _from_distances(observations, arm, is_base_unknown, is_tool_unknown)
    if observations.kind == "orientation":
        return _from_orientations(observations, arm, is_base_unknown, is_tool_unknown)
    if observations.kind == "direction":
        return _from_directions(observations, arm) if is_base_unknown else arm
    some, few = _spread(observations, LOOKED_AT), _spread(observations, ROUGHLY[0])
    rows = arm.rows
    rough = sorted(
        (
            _refined(few, start, rows, (is_base_unknown, is_tool_unknown), ROUGHLY[1])
            for start in _starts(some, arm, is_base_unknown, is_tool_unknown)
        ),
        key=lambda p: p.left,
    )
    found = sorted(
        (_refined(some, one.arm, rows, (is_base_unknown, is_tool_unknown), STEPS) for one in rough[:LEADING]),
        key=lambda p: p.left,
    )
    best = found[0]
    if not best.left < FITS:
        hint = (
            ""
            if is_base_unknown and is_tool_unknown
            else f' Or is [instrument] {"tool" if is_base_unknown else "base"} unknown as well ("free")?'
        )
        raise RigError(
            f"no place of {_unknown(is_base_unknown, is_tool_unknown)} fits: the best of {len(rough)} starts still "
            f"leaves {best.left * 1e3:.0f} mm (median). Are these the joint angles of these poses, in this "
            f"order, with these signs and zeros (within {ZERO} rad), and are [mechanism] joints the maker's "
            f"figures, in metres and radians?{hint}"
        )
    for other in found[1:]:
        if other.left < TWOFOLD * best.left + 1e-6 and not _same(other.arm, best.arm):
            raise RigError(
                f"{_unknown(is_base_unknown, is_tool_unknown)} can be located in two ways that fit equally well "
                f"({best.left * 1e3:.2f} and {other.left * 1e3:.2f} mm, median): the poses differ too "
                "little; move every joint, or state one of the two poses"
            )
    return best.arm


def _unknown(base: bool, tool: bool) -> str:
    return "base and tool" if base and tool else "the base" if base else "the tool"


def _starts(observations: Observations, arm: Arm, base: bool, tool: bool) -> list[Arm]:
    """Arms with different bases, the likeliest first."""
    links = mechanism.forward(observations.q, arm.with_ends(RigidTransform.identity(), RigidTransform.identity()))
    F, f = links.rotation.as_matrix(), links.translation
    value = observations.value
    p, M = (value.translation, value.rotation.as_matrix()) if isinstance(value, RigidTransform) else (value, None)
    X = _covering(ROTATIONS) if base else arm.base.rotation.as_matrix()[None]
    one = np.broadcast_to(np.eye(3), F.shape)
    known_z = None if tool else arm.tool.translation
    if known_z is not None:
        f = f + F @ known_z
    A = (np.concatenate([F, one], axis=2) if tool else one).reshape(3 * len(F), -1)
    if not base:
        A, f = (F if tool else np.zeros((len(F), 3, 0))).reshape(3 * len(F), -1), f + X[0].T @ arm.base.translation
    orthonormal = _span(A)

    def left(columns: Floats) -> Floats:
        return columns - orthonormal @ (orthonormal.T @ columns)

    # (X'p) of all observations is linear in X: columns for its nine entries
    P = left(np.einsum("mi,jk->mkij", p, np.eye(3)).reshape(3 * len(p), 9))
    right = left(f.reshape(-1, 1))
    x = X.reshape(-1, 9)
    square = np.einsum("ri,ij,rj->r", x, P.T @ P, x) - 2 * x @ (P.T @ right)[:, 0] + (right**2).sum()
    cost = np.maximum(square, 0) / COARSE[0] ** 2
    if M is not None:
        K = np.einsum(
            "rkj,jikl->ril", X, np.einsum("mji,mkl->jikl", F, M), optimize=True
        )  # sum of F'X'M, whose nearest rotation is Z
        best = np.linalg.svd(K, compute_uv=False)
        best[:, 2] *= np.sign(np.linalg.det(K))
        known = np.einsum("ril,il->r", K, arm.tool.rotation.as_matrix())
        cost += 2 * (3 * len(M) - (best.sum(axis=1) if tool else known)) / (2 * COARSE[1] ** 2)
    return [_placed_about(X[i], F, f, p, M, A, arm, (base, tool)) for i in _apart(X, cost)]


def _placed_about(
    X: Floats, F: Floats, f: Floats, p: Floats, M: Floats | None, A: Floats, arm: Arm, unknown: tuple[bool, bool]
) -> Arm:
    """Arm with a rotation of the base (3, 3), and what then follows for the rest."""
    base, tool = unknown
    sizes = np.repeat([size for size, free in ((REACH, tool), (AWAY, base)) if free], 3)
    solution = np.linalg.solve(A.T @ A + np.diag((COARSE[0] / sizes) ** 2), A.T @ (p @ X - f).ravel())
    z = solution[:3] if tool else arm.tool.translation
    t = X @ solution[-3:] if base else arm.base.translation
    Z = arm.tool.rotation.as_matrix()
    if tool and M is not None:
        Z = nearest_rotation(np.einsum("mji,kj,mkl->il", F, X, M))
    return arm.with_ends(rigid_transform(X, t), rigid_transform(Z, cast(Floats, z)))


def _apart(X: Floats, cost: Floats) -> list[int]:
    """Indices of the rotations of least cost, each APART from those before."""
    chosen: list[int] = []
    cosine = 1 + 2 * np.cos(APART)
    for i in np.argsort(cost):
        if all(np.einsum("ij,ij->", X[i], X[j]) < cosine for j in chosen):
            chosen.append(int(i))
            if len(chosen) == STARTS:
                break
    return chosen


def _spread(observations: Observations, count: int) -> Observations:
    """At most so many of the observations, from first to last."""
    return observations.take(np.unique(np.linspace(0, len(observations) - 1, count).astype(int)))


def _refined(observations: Observations, arm: Arm, rows: Floats, unknown: tuple[bool, bool], steps: int) -> Placement:
    """Placement by damped, robust least squares over base, tool and the joints' zeros, which a prior holds near the
    maker's rows (n, 5).
    """
    posed, sigma = observations.kind == "pose", _sigma(observations)
    count, tool = len(arm_error_model_and_instrument_observations.parameter_names(arm)), tool_parameter_slice(arm)
    free, prior = np.zeros(count, bool), np.zeros(count)
    free[:6], free[tool] = unknown
    free[tool.stop - 3 : tool.stop] &= posed
    zeros = arm_error_model_and_instrument_observations.joint_zero_indices(arm)[
        1:
    ]  # all but the first, which is the base's
    prior[:6], prior[tool] = 1 / np.repeat([AWAY, TURN], 3), 1 / np.repeat([REACH, TURN], 3)
    free[zeros], prior[zeros] = True, 1 / ZERO
    start = arm
    at = _Misfit.of(observations, arm, start, rows, prior)
    damping = 1e-4
    for _ in range(steps):
        J = (observations.jacobian(arm)[..., free] * at.weight[:, None, None] / sigma[:, None]).reshape(-1, free.sum())
        H = J.T @ J + np.diag(prior[free] ** 2)
        g = J.T @ (at.residual * at.weight[:, None]).ravel() - (prior * at.moved)[free]
        step = np.zeros(len(free))
        while damping < 1e8:
            step[free] = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-9), g)
            trial = arm_error_model_and_instrument_observations.arm_with_parameter_step(arm, step)
            new = _Misfit.of(observations, trial, start, rows, prior)
            if new.cost(at.scale) <= at.cost(at.scale):
                break
            damping *= 8
        else:
            break
        arm, at, damping = trial, new, max(damping / 8, 1e-10)
        if np.abs(step).max() < SETTLED:
            break
    left = observations.residuals(arm)[:, :3]
    return Placement(arm, float(np.median(np.linalg.norm(left, axis=1))))


def _sigma(observations: Observations) -> Floats:
    """(k,) m and rad of FINE, of the rows of an observation."""
    return np.repeat(FINE, 3)[: observations.covariance.shape[1]]


@dataclass(frozen=True, slots=True, eq=False)
class _Misfit:
    """residual : (m, k) in FINE; moved : (p,) times prior, zeros from the maker's and base and tool from where they
    began
    scale : of the residuals, at least 1; weight : (m,) of each observation."""

    residual: Floats
    moved: Floats
    scale: float
    weight: Floats

    @classmethod
    def of(cls, observations: Observations, arm: Arm, start: Arm, rows: Floats, prior: Floats) -> "_Misfit":
        r = observations.residuals(arm) / _sigma(observations)
        size = np.linalg.norm(r, axis=1)
        scale = max(1.0, float(np.median(size)))  # what is far off at first weighs less against the prior
        moved = np.zeros(len(prior))
        moved[:6], moved[tool_parameter_slice(arm)] = log(start.base.inv() * arm.base), log(start.tool.inv() * arm.tool)
        moved[6 : 6 + rows.size] = (arm.rows - rows).ravel()
        return cls(r, prior * moved, scale, np.sqrt(np.minimum(1.0, HUBER * scale / np.maximum(size, 1e-12))) / scale)

    def cost(self, scale: float) -> float:
        """Huber's cost of the residuals over a scale, and the prior's."""
        size = np.linalg.norm(self.residual, axis=1) / scale
        return float(np.where(size < HUBER, size**2, HUBER * (2 * size - HUBER)).sum() + (self.moved**2).sum())


def _same(a: Arm, b: Arm) -> bool:
    """Whether two placements that fit are one: the base's rotation given, all else is linear, and what may differ is
    what poses leave open.
    """
    return bool((a.base.inv() * b.base).rotation.magnitude() < SAME)


def _covering(count: int) -> Floats:
    """(count, 3, 3) rotations that cover SO(3) evenly. Source: Alexa, CVPR 2022 (super-Fibonacci spirals)"""
    phi, psi = np.sqrt(2), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, R = np.sqrt(s / count), np.sqrt(1 - s / count)
    a, b = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    return Rotation.from_quat(
        np.stack([r * np.sin(a), r * np.cos(a), R * np.sin(b), R * np.cos(b)], axis=1)
    ).as_matrix()


def _span(A: Floats) -> Floats:
    """Orthonormal columns that span what A tells of sizes up to AWAY."""
    if not A.shape[1]:
        return A
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return U[:, s > COARSE[0] / AWAY]


def _from_orientations(observations: Observations, arm: Arm, base: bool, tool: bool) -> Arm:
    """X F Z = M in rotations alone, linear in X' and Z; where base and target stand they do not tell, and that stays as
    stated.

    Raises RigError where the hand's rotations leave a family of answers
    """
    none = RigidTransform.identity()
    F = mechanism.forward(observations.q, arm.with_ends(none, none)).rotation.as_matrix()
    value = observations.value
    assert isinstance(value, RigidTransform)
    M, X, Z = value.rotation.as_matrix(), arm.base.rotation.as_matrix(), arm.tool.rotation.as_matrix()
    if base and tool:
        X, Z, determined = solve_robot_world_hand_eye_rotations(M, F)
        if determined < TELLS:
            raise RigError(
                "orientations of a hand that turns about one axis only leave a family of poses of base and "
                "target; move more joints, or "
                "state one of the two poses"
            )
        return arm.with_ends(rigid_transform(X, arm.base.translation), rigid_transform(Z, arm.tool.translation))
    X = nearest_rotation(np.einsum("mij,mkj->ik", M, F @ Z)) if base else X
    Z = nearest_rotation(np.einsum("mji,mjk->ik", X @ F, M)) if tool else Z
    return arm.with_ends(rigid_transform(X, arm.base.translation), rigid_transform(Z, arm.tool.translation))


def _from_directions(observations: Observations, arm: Arm) -> Arm:
    """The base turned to where it sees the directions measured, those that disagree with the others' middle counting
    less; where it stands they do not tell. Source: Wahba, SIAM Review 7, 1965 (by singular values); Huber's weights

    Raises RigError where all point nearly alike
    """
    seen = mechanism.forward(observations.q, replace(arm, base=RigidTransform.identity())).rotation.as_matrix()[..., 2]
    value = observations.value
    assert isinstance(value, RigidTransform)
    wanted, weight = value.rotation.as_matrix()[..., 2], np.ones(len(seen))
    spread = np.linalg.svd(seen, compute_uv=False)
    if spread[1] < SPREAD * spread[0]:
        raise RigError("all directions point nearly alike, which leaves a family of bases; point all over the sky")
    for _ in range(STEPS):
        X = nearest_rotation(np.einsum("m,mi,mj->ij", weight, wanted, seen))
        off = np.linalg.norm(wanted - seen @ X.T, axis=1)
        weight = np.minimum(1.0, HUBER * max(float(np.median(off)), SETTLED) / np.maximum(off, 1e-12))
    return replace(arm, base=rigid_transform(X, arm.base.translation))


def solve_robot_world_hand_eye_rotations(M: Floats, F: Floats) -> tuple[Floats, Floats, float]:
    """Solve M = X F Z for the rotations X and Z, of rotations M and F (m, 3, 3).

    The third is the second least eigenvalue over the greatest, 0 where a family of answers fits. Source: Shah, J.
    Mechanisms Robotics 5, 2013

    Returns (X, Z, how well determined)
    """
    one = np.eye(3)
    rows = np.concatenate(
        [
            np.einsum("mij,kl->mikjl", M, one).reshape(len(M), 9, 9),
            -np.einsum("ij,mlk->mikjl", one, F).reshape(len(M), 9, 9),
        ],
        axis=2,
    ).reshape(-1, 18)
    values, vectors = np.linalg.eigh(rows.T @ rows)
    null = vectors[:, 0] * np.sign(np.linalg.det(vectors[9:, 0].reshape(3, 3)))
    return (
        nearest_rotation(null[9:].reshape(3, 3)),
        nearest_rotation(null[:9].reshape(3, 3).T),
        float(values[1] / values[-1]),
    )


def _from_distances(observations: Observations, arm: Arm, base: bool, tool: bool) -> Arm:
    """length = |F z + f - w|, squared, is linear in the anchor w, the target z on the hand, w z' and |z|^2 + |w|^2; its
    least squares is refined with the joints' zeros. The base's rotation cannot be determined and stays as stated.

    Raises RigError where no such placement fits
    """
    links = mechanism.forward(observations.q, arm.with_ends(RigidTransform.identity(), RigidTransform.identity()))
    F, f = links.rotation.as_matrix(), links.translation
    R, z = arm.base.rotation.as_matrix(), arm.tool.translation
    w = -R.T @ arm.base.translation
    f = f + (0 if tool else F @ z) - (0 if base else w)
    columns = [2 * np.einsum("mij,mi->mj", F, f)] if tool else []
    columns += [-2 * f] if base else []
    columns += [-2 * F.reshape(len(F), 9)] if base and tool else []
    A = np.concatenate([*columns, np.ones((len(f), 1))], axis=1)
    sizes = np.repeat([REACH, AWAY, REACH * AWAY, AWAY**2], [3 * tool, 3 * base, 9 * (base and tool), 1])
    error = 2 * COARSE[0] * np.median(observations.value)  # of a squared length
    right = np.asarray(observations.value) ** 2 - (f**2).sum(axis=1)
    solution = np.linalg.solve(A.T @ A + np.diag((error / sizes) ** 2), A.T @ right)
    z = solution[:3] if tool else z
    w = solution[3 * tool : 3 * tool + 3] if base else w
    start = arm.with_ends(rigid_transform(R, -R @ w), rigid_transform(arm.tool.rotation.as_matrix(), z))
    found = _refined(_spread(observations, LOOKED_AT), start, arm.rows, (base, tool), STEPS)
    if not found.left < FITS:
        raise RigError(
            f"no place of {_unknown(base, tool)} fits: the wire's lengths still miss by {found.left * 1e3:.0f} mm "
            "(median). Are these the joint angles of these lengths, in this order, with these signs and zeros, and are "
            "[mechanism] joints the maker's figures, in metres and radians?"
        )
    return found.arm


def nearest_rotation(matrix: Floats) -> Floats:
    """The rotation nearest to a matrix (3, 3)."""
    U, _, V = np.linalg.svd(matrix)
    return U @ np.diag([1, 1, np.linalg.det(U @ V)]) @ V


def rigid_transform(R: Floats, t: Floats) -> RigidTransform:
    """Rigid transform of a rotation (3, 3) and a translation (3,) m."""
    return RigidTransform.from_components(t, Rotation.from_matrix(R))
