"""Correction of an arm: commands for wanted poses.

On the joint solution nearest those visited.

A solver that starts far away comes down on one solution or another by how its first steps are rounded; along short
steps, each damped, the joints follow the hand, and the same joints come out in whatever frame poses are given.
Source: Nakamura and Hanafusa, Inverse kinematic solutions with singularity robustness, ASME JDSMC 1986 (the damping)

Source: lecture on the manipulator Jacobian, compensation by the differential error transform (steps (1), (2) and on),
and the configuration-space patent for the summands on top. To make up for any error takes six joints: with fewer the
hand is brought as near as it comes, see rig.model.mechanisms.closed_form_and_numerical_arm_inverse, and what is left
is for `rest` to say.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.machine_correction import Correction, Responses
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_identification_and_joint_profiles import Profile
from rig.array_and_json_types import Floats
from rig.errors import Unreachable
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms import closed_form_and_numerical_arm_inverse as deficient
from rig.model.pose import direction_difference, exp, pose_difference

BRANCH_STEP = (0.05, 0.1)  # m, rad; of the hand
MOST = 60  # steps of a way
REPEATS = 2  # corrections of the joints at each
DAMPING = 0.03  # m or rad, against singular values of a Jacobian


def _solution_from_start(T_base_platform: RigidTransform, arm: Arm, start: Floats) -> tuple[Floats, Floats]:
    """(q (m, n) rad or m, left (m,) m or rad): joint values of poses (m,) to which the joints come from starts (m, n);
    left as `arm.solve`.
    """
    q = np.array(start, float)
    begin = mechanism.forward(q, arm)
    displacement = pose_difference(begin, T_base_platform)
    length = np.stack(
        [
            np.linalg.norm(displacement[:, part], axis=1) / size
            for part, size in zip((slice(0, 3), slice(3, 6)), BRANCH_STEP)
        ]
    )
    steps = np.clip(np.ceil(length.max(axis=0)), 1, MOST)
    for k in range(1, int(steps.max(initial=0)) + 1):
        going = np.flatnonzero(steps >= k)
        at = begin[going] * exp((k / steps[going])[:, None] * displacement[going])
        for _ in range(REPEATS):
            J = mechanism.jacobian(q[going], arm)
            error = pose_difference(mechanism.forward(q[going], arm), at)
            Jt = np.swapaxes(J, 1, 2)
            q[going] += (Jt @ np.linalg.solve(J @ Jt + DAMPING**2 * np.eye(6), error[..., None]))[..., 0]
    q, left = mechanism.damped_least_squares_arm_inverse_and_error(T_base_platform, arm, q, starts=0)
    return mechanism.nearest_equivalent_angles(q, arm, start), left


STARTS = 4  # visited configurations tried as a start before any other
ITERATIONS = 40
TOLERANCE = 1e-11  # m and rad; of the pose that a command is predicted to give
NEAR = 0.05  # m and rad; what the fitted arm may leave of a pose for its joint solution to be a start
STEP = 0.3  # rad; longest single correction
FAR, LIKE, MET = (
    0.05,
    1e-6,
    1e-10,
)  # m and rad; of an arm of few joints: out of reach, as near as any, a position that is met
NEAR_SINGULAR = 1e-6  # of the greatest singular value of a Jacobian; less is a direction that no joint moves in
RADIUS = 0.3  # m; a radian weighs like so much when the nearest visited pose is looked for


@dataclass(frozen=True, slots=True, eq=False)
class ArmCorrection(Correction[Arm, Profile]):
    """nominal, fitted : Arm, bases and tools in the instrument's frames; remainder : per joint a Profile or None
    visited : (n, joints) rad, configurations it was fitted to: a wanted pose is taken as they took it, elbow and wrist
        alike."""

    visited: Floats

    @property
    def deficient(self) -> bool:
        """Whether the arm has too few joints to take any pose."""
        return int((self.nominal.moving & ~self.nominal.followers).sum()) < deficient.WHOLE

    def of_hand(self, hand: str | int) -> Self:
        """The correction of one of an arm's several hands, by name or number; the joints of others stand at home."""
        seen = replace(self, nominal=self.nominal.of_hand(hand), fitted=self.fitted.of_hand(hand))
        return seen.with_other_joints_at(np.clip(0.0, *self.nominal.limits.T))

    def with_other_joints_at(self, values: Floats) -> Self:
        """The correction whose commands leave the joints that do not move its hand at values (joints,) rad or m."""
        return replace(self, visited=np.where(self.nominal.moving, self.visited, values))

    def in_posture_nearest_to(self, T_base_platform: RigidTransform, values: Floats, speed: Floats) -> Self:
        """The correction that takes a pose () in the posture that is reached soonest from joint values (joints,) rad or
        m, of all that are found within the limits; itself where none is, so that `inverse` says why.

        speed : (joints,) rad/s or m/s, greatest of each joint
        """
        posture = deficient.numerical_inverse_solutions(self.target_poses(T_base_platform), self.nominal).q
        guess = np.vstack([values, mechanism.nearest_equivalent_angles(posture, self.nominal, values)])
        poses = RigidTransform.from_matrix(np.tile(T_base_platform.as_matrix(), (len(guess), 1, 1)))
        found = self.near(poses, guess)
        found = found[(mechanism.signed_limit_excess(found, self.nominal) == 0).all(axis=1)]  # NaN is within none
        if not len(found):
            return self
        return replace(self, visited=found[[np.argmin((np.abs(found - values) / speed).max(axis=1))]])

    def summand(self, commands: Floats) -> Floats:
        """KSF (..., joints) rad or m at commands: commanded less what the nominal model says for the pose that it
        gives.

        Raises Unreachable with the index of commands near which the nominal model does not take that pose
        """
        if self.deficient:
            return (
                commands
                - deficient.nearest_joint_values_remaining_error_and_settled(
                    self.predict(commands), self.nominal, commands, deficient.hand_motion_direction_counts(self.nominal)
                )[0]
            )
        flat = commands.reshape(-1, commands.shape[-1])
        found, left = mechanism.damped_least_squares_arm_inverse_and_error(
            self.predict(flat), self.nominal, flat, starts=0
        )
        far = np.flatnonzero(left > mechanism.GOOD)
        if len(far):
            raise Unreachable(
                f"the nominal model does not take {len(far)} of {len(flat)} corrected poses in their posture:",
                far,
                [f"pose {i}: it comes no nearer than {left[i] * 1e3:.3g} mm or mrad" for i in far.tolist()],
            )
        return mechanism.joint_value_difference(flat, found, self.nominal).reshape(commands.shape)

    def poses_pointing_along(self, directions: RigidTransform) -> RigidTransform:
        """Poses (n,) of the corrected arm whose z axes are those of directions (n,), begun at the visited configuration
        that points nearest to each.

        Raises Unreachable with the index of those that no step leads to
        """
        wanted = directions.rotation.as_matrix()[..., 2]
        seen = self.predict(self.visited).rotation.as_matrix()[..., 2]
        q = self.visited[np.argmax(wanted @ seen.T, axis=1)].copy()
        for _ in range(ITERATIONS):
            off = direction_difference(self.reached_by_maps(mechanism.forward(q, self.fitted)), directions)
            J = mechanism.jacobian(q, self.fitted)[:, 3:5]
            q += (np.linalg.pinv(J, rcond=NEAR_SINGULAR) @ off[..., None])[..., 0]
        T = self.reached_by_maps(mechanism.forward(q, self.fitted))
        left = np.linalg.norm(direction_difference(T, directions), axis=1)
        far = np.flatnonzero(left > TOLERANCE)
        if len(far):
            raise Unreachable(
                f"{len(far)} of {len(left)} wanted directions are out of the arm's reach:",
                far,
                [f"direction {i}: no command comes nearer than {left[i] * 1e3:.3g} mrad" for i in far.tolist()],
            )
        return T

    def missed(self, T_base_platform: RigidTransform, commands: Floats) -> Floats:
        """(n, joints) rad or m by which commands (n, joints) differ from those nearest to them that give wanted poses
        (n,), whole turns aside; NaN where none is found."""
        return mechanism.joint_value_difference(commands, self.near(T_base_platform, commands), self.nominal)

    def uncorrected(self, T_base_platform: RigidTransform) -> Floats:
        """Commands (..., joints) rad or m that the nominal model gives for wanted poses (m,), as the nearest visited
        ones took them.
        """
        if self.deficient:
            return self._nearest(T_base_platform, self._near(T_base_platform), self.nominal, None)
        return mechanism.inverse(
            T_base_platform, self.nominal, self._found_from(T_base_platform, self._near(T_base_platform))[0]
        )

    def reached_poses(self, T_base_platform: RigidTransform, commands: Floats) -> RigidTransform:
        """The poses (n,) that commands (n, joints) found for wanted poses (n,) give: with too few joints those nearest
        to them.
        """
        return self.predict(commands) if self.deficient else T_base_platform

    def goal(self, T_base_platform: RigidTransform, near: Floats) -> Floats:
        """(n, joints) rad or m that the fitted arm has to get for poses (n,), nearest to commands (n, joints). Raises
        Unreachable as `inverse`
        """
        commands = self.inverse_without_physics(T_base_platform, near)
        return commands - self.rho(commands)

    def responses(self, T_base_platform: RigidTransform, effective: Floats) -> Responses:
        """Responses of the arm at what its joints get, effective (n, joints) rad or m."""
        axes = arm_error_model_and_instrument_observations.joint_jacobian(effective, self.fitted)
        return Responses(
            axes,
            cast(Floats, np.linalg.pinv(axes, rcond=NEAR_SINGULAR)),
            arm_error_model_and_instrument_observations.parameter_jacobian(effective, self.fitted),
        )

    def scattering(self, scatter: Floats, responses: Responses) -> Floats:
        """(n, 6, 6) m and rad, factor of the covariance by which poses scatter. scatter : (6,) of poses, (3,) of
        positions alone
        """
        return np.broadcast_to(np.diag(np.r_[scatter, np.zeros(6 - len(scatter))]), (len(responses.axes), 6, 6))

    def rest(self, T_base_platform: RigidTransform, commands: Floats) -> Floats:
        """(..., 6) m and rad that commands (..., joints) leave to wanted poses (...), in the hand: what too few joints
        cannot make up for.
        """
        return pose_difference(self.predict(commands), T_base_platform)

    def inverse(self, T_base_platform: RigidTransform, guess: Floats | None = None) -> Floats:
        """Commands (..., joints) rad or m that give wanted poses (...), or come nearest to them; limits are for
        `reachable` to check.

        guess : (..., joints) rad or m, what is near; by default the nearest visited configurations
        The start is where these lead when the hand goes straight to the pose; what the profiles of the joints add there
        is made up for by J^+ dPOS, iterated.
        Raises RigError where a calibration knows physics besides, Unreachable with the index of poses that no start
            leads to
        """
        self._refuse_physics()
        return self.inverse_without_physics(T_base_platform, guess)

    def inverse_without_physics(self, T_base_platform: RigidTransform, guess: Floats | None = None) -> Floats:
        """The commands (..., joints) of `inverse` by the configuration alone, whatever else a calibration knows. Raises
        Unreachable as `inverse`, NotConverged as `target_poses`
        """
        shape = T_base_platform.shape
        T = self.target_poses(RigidTransform.from_matrix(T_base_platform.as_matrix().reshape(-1, 4, 4)))
        n = len(self.nominal.joints)
        starts = self._near(T) if guess is None else np.broadcast_to(guess, (*shape, n)).reshape(-1, n)[:, None]
        if self.deficient:
            return self._nearest(T, starts, self.fitted, self.rho).reshape(*shape, n)
        commands, left = self._found_from(T, starts)
        failed = np.flatnonzero(left > TOLERANCE)
        if len(failed):
            raise Unreachable(
                f"{len(failed)} of {len(T)} wanted poses are out of the arm's reach:",
                failed,
                [f"pose {i}: no command comes nearer than {left[i] * 1e3:.3g} mm or mrad" for i in failed],
            )
        return commands.reshape(*shape, n)

    def _found_from(self, T: RigidTransform, starts: Floats) -> tuple[Floats, Floats]:
        """(commands (m, joints), left (m,) m or rad) for poses T (m,), from starts (m, k, joints) in turn, then from
        anywhere.
        """
        commands, left = np.full((len(T), starts.shape[2]), np.nan), np.full(len(T), np.inf)
        for k in range(starts.shape[1] + 1):
            todo = np.flatnonzero(
                (left > TOLERANCE) | (mechanism.signed_limit_excess(commands, self.nominal) != 0).any(axis=1)
            )
            if not len(todo):
                break
            start = starts[todo, min(k, starts.shape[1] - 1)]
            q, reached = (
                _solution_from_start(T[todo], self.fitted, start)
                if k < starts.shape[1]
                else mechanism.damped_least_squares_arm_inverse_and_error(T[todo], self.fitted, start)
            )
            q, reached = self._compensate(T[todo], np.where((reached < NEAR)[:, None], q, start))
            better = (reached <= TOLERANCE) | (reached < left[todo])
            commands[todo[better]], left[todo[better]] = q[better], reached[better]
        return commands, left

    def near(self, T_base_platform: RigidTransform, guess: Floats) -> Floats:
        """Commands (n, joints) rad or m that give poses (n,), sought from the guess (n, joints) alone; NaN where it
        leads to none.
        """
        T_base_platform = self.target_poses(T_base_platform)
        if self.deficient:
            q, good, _ = self._led(T_base_platform, guess, self.fitted, self.rho)
            return np.where(good[:, None], q, np.nan)
        q, reached = _solution_from_start(T_base_platform, self.fitted, guess)
        commands, left = self._compensate(T_base_platform, np.where((reached < NEAR)[:, None], q, guess))
        return np.where((left <= TOLERANCE)[:, None], commands, np.nan)

    def _nearest(self, T: RigidTransform, starts: Floats, arm: Arm, rho: Callable[[Floats], Floats] | None) -> Floats:
        """Commands (m, joints) of an arm of few joints, nearest to poses T (m,): of starts (m, k, joints) the first
        that leads about as near as any.

        rho : what a joint falls short of its command, or None. Raises Unreachable with what is left, for positions that
        are not met where the arm moves in all directions, and for poses FAR from any that can be taken
        """
        q, good, rest = (
            np.stack(parts) for parts in zip(*(self._led(T, starts[:, k], arm, rho) for k in range(starts.shape[1])))
        )
        place, turn = (np.linalg.norm(rest[..., part], axis=2) for part in (slice(0, 3), slice(3, 6)))
        inside = good & (mechanism.signed_limit_excess(q, self.nominal) == 0).all(axis=2)
        size = np.maximum(place, turn)
        size = np.where(inside | ~inside.any(axis=0) & good, size, np.inf)
        pick = np.argmax(size <= 2 * size.min(axis=0) + LIKE, axis=0)
        far = np.flatnonzero(~good.any(axis=0))
        if len(far):
            raise Unreachable(
                f"{len(far)} of {len(T)} wanted poses are out of the reach of the arm, which has {q.shape[2]} joints:",
                far,
                [
                    f"pose {i}: no command comes nearer than {place[:, i].min() * 1e3:.3g} mm "
                    f"and {turn[:, i].min() * 1e3:.3g} mrad"
                    for i in far.tolist()
                ],
            )
        return np.take_along_axis(q, pick[None, :, None], axis=0)[0]

    def _led(
        self, T: RigidTransform, start: Floats, arm: Arm, rho: Callable[[Floats], Floats] | None
    ) -> tuple[Floats, Floats, Floats]:
        """(commands (m, joints), good (m,) bool, rest (m, 6)) of an arm of few joints led to poses T (m,) from starts
        (m, joints), as `_nearest`.
        """
        count = deficient.hand_motion_direction_counts(self.nominal)
        q, rest, settled = deficient.nearest_joint_values_remaining_error_and_settled(
            T, arm, start, count, None if rho is None else lambda values: values - rho(values)
        )
        place, turn = np.linalg.norm(rest[:, :3], axis=1), np.linalg.norm(rest[:, 3:], axis=1)
        good = settled & (place <= (MET if count.position == 3 else FAR)) & (turn <= FAR)
        return mechanism.nearest_equivalent_angles(q, self.nominal, q), good, rest

    def _compensate(self, T: RigidTransform, q: Floats) -> tuple[Floats, Floats]:
        """(commands, left): from joint solutions q (m, n) of the fitted arm, by differential error transforms."""
        left = np.full(len(q), np.inf)
        best, going = q.copy(), np.arange(len(q))
        for _ in range(ITERATIONS):
            error = pose_difference(mechanism.forward(q - self.rho(q), self.fitted), T[going])
            size = np.maximum(np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1))
            better = size < left[going]
            best[going[better]], left[going[better]] = q[better], size[better]
            on = left[going] >= 0.1 * TOLERANCE
            if not on.any():
                break
            going, q, error, size = going[on], q[on], error[on], size[on]
            J = mechanism.jacobian(q, self.fitted)
            damping = (size**2 + 1e-14)[:, None, None] * np.eye(6)
            step = (np.swapaxes(J, 1, 2) @ np.linalg.solve(J @ np.swapaxes(J, 1, 2) + damping, error[..., None]))[
                ..., 0
            ]
            q = q + step / np.maximum(1, np.abs(step).max(axis=1, keepdims=True) / STEP)
        return mechanism.nearest_equivalent_angles(best, self.nominal, best), left

    def _near(self, T: RigidTransform) -> Floats:
        """(m, STARTS, joints) visited configurations whose poses are nearest to T (m,), nearest first."""
        at = self.predict(self.visited)
        vectors, matrices = at.translation, at.rotation.as_matrix()
        out = []
        for position, R in zip(T.translation, T.rotation.as_matrix()):
            turn = np.arccos(np.clip((np.einsum("mij,ij->m", matrices, R) - 1) / 2, -1, 1))
            far = np.linalg.norm(vectors - position, axis=1) + RADIUS * turn
            out.append(self.visited[np.argsort(far)[:STARTS]])
        return np.array(out).reshape(len(T), -1, self.visited.shape[1])
