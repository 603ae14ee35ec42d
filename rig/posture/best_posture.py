"""Best posture of a redundant arm.

At a fixed hand pose, with the motion into it.
It is searched for, or is the best of those visited.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_no_couplings, require_single_hand_mechanism
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import pose_difference
from rig.posture import (
    arm_force_transmission_and_exertable_wrench,
    arm_motion_between_postures,
    null_space_posture_search,
)
from rig.posture.arm_force_transmission_and_exertable_wrench import (
    ExertionObjective,
    TransmissionObjective,
    force_polytope_corners,
    greatest_force_in_all_directions_and_weakest_direction,
    joint_torques_for_wrench,
)
from rig.posture.null_space_posture_search import SearchResult
from rig.posture.self_motion_sweep import PostureSweep, sweep_self_motion
from rig.recording.corner_and_pose_csv_tables import write_table
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html

STARTS = 24  # joint solutions of the pose from which self-motions are searched for
SEED = 0
HAND_THERE = 1e-6  # m and rad, by which the hand may be off where it is stated to be
Objective = TransmissionObjective | ExertionObjective


@dataclass(frozen=True, slots=True, eq=False)
class PostureOptions:
    """T_base_hand : where the hand is (None: where it was at a recording's first exposure); objective : what to
    maximise; exertion : a wrench to exert, which is maximised where the objective names no direction, or None
    above : measure from which a posture will do, or None; fixed : fixed part of the hand, "pose", "position" or
    "orientation"; start : (n,) rad and m of the joints now, None for a solution of the pose; during_hand_motion :
    whether the posture is taken while the hand moves, not once it has arrived; speed : rad/s of the fastest joint
    recording : whose postures are compared in place of a search, or None
    """

    T_base_hand: RigidTransform | None = None
    objective: TransmissionObjective = field(default_factory=TransmissionObjective)
    exertion: ExertionObjective | None = None
    above: float | None = None
    fixed: str = "pose"
    start: Floats | None = None
    during_hand_motion: bool = False
    speed: float = 0.5
    recording: Recording | None = None

    def __post_init__(self) -> None:
        if self.above is not None and not self.above >= 0:
            raise RigError(f"--above must be at least 0, not {self.above:g}")
        if not self.speed > 0:
            raise RigError(f"--speed must be positive rad/s, not {self.speed:g}")
        if self.recording is not None and (self.start is not None or self.above is not None or self.during_hand_motion):
            raise RigError(
                "--among returns to a posture from the end of the recording; --from, --above and --motion are "
                "for searches"
            )
        if self.recording is None and self.T_base_hand is None:
            raise RigError("--pose states the hand pose; without it, --among names a recording")

    @property
    def maximised(self) -> Objective:
        """What the posture maximises."""
        return self.exertion if self.exertion is not None and not self.objective.directions else self.objective


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PostureResult(OneLineRepr):
    """A posture. arm; options; q : (n,) rad and m; motion : (k, n) of the joints into it; figures : of it and of the
    search, as JSON has them
    """

    arm: Arm
    options: PostureOptions
    q: Floats
    motion: Floats
    figures: Json

    def __str__(self) -> str:
        return f"posture {', '.join(f'{q:.6f}' for q in self.q)}: measure {self.figures['value']:.6f}"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self))

    def tree(self) -> Json:
        """What `rig arm posture --json` prints."""
        exertion = self.options.exertion
        return self.figures | ({} if exertion is None else {"exert": exertion_dict(self.q, self.arm, exertion)})

    def write(self, path: Path) -> None:
        """Write the motion into it, as commands."""
        t = arm_motion_between_postures.posture_times(self.motion, self.options.speed)
        rows = [
            ",".join([f"{moment:.6f}", *(f"{angle:.12f}" for angle in angles)])
            for moment, angles in zip(t, self.motion)
        ]
        write_table(path, ("t", *self.arm.axes), rows)

    def force_svg(self, exertion: ExertionObjective) -> str:
        """SVG of the forces that it can exert; needs matplotlib. Raises RigError where it cannot hold its own weight"""
        from rig.posture.arm_force_transmission_and_exertable_wrench import force_polytope_svg

        low, high = exertion.strength.box(self.q, self.arm)
        if (low > 0).any() or (high < 0).any():
            raise RigError("the posture cannot hold the arm's own weight, and there is nothing to draw")
        A = _torques_of_unit_forces(self.q, self.arm)
        return force_polytope_svg(
            A, exertion.strength.limits, force_polytope_corners(A, low, high), exertion.wrench[:3]
        )


def best_posture(arm: Arm, options: PostureOptions) -> PostureResult:
    """Best posture (PostureResult) of an arm.

    As `rig arm posture` makes it.
    Raises RigError for an arm with several hands, for a hand that is elsewhere than stated, and where nothing exceeds
        the measure that is wanted; Unreachable for a pose that no joint values give
    """
    require_single_hand_mechanism(arm, "postures are searched")
    require_no_couplings(arm, "postures are searched")
    return (_best_searched if options.recording is None else _best_visited)(arm, options)


def posture_sweep(arm: Arm, options: PostureOptions, step: float) -> PostureSweep:
    """Sweep of postures (PostureSweep) of an arm.

    As `rig arm posture --sweep` makes it, through the start or a solution of a pose.
    options : T_base_hand, fixed and start count; step : rad, of slides m, of the fastest joint
    Raises RigError for coupled joints, for what is of a search, for a hand that is elsewhere than stated, and what the
        sweep raises; Unreachable for a pose that no joint values give
    """
    require_no_couplings(arm, "postures are swept")
    start, wanted = options.start, options.T_base_hand
    search = (options.recording, options.above, options.exertion, options.objective.directions or None)
    if wanted is None or options.during_hand_motion or any(one is not None for one in search):
        raise RigError("--sweep visits all postures and searches none; it takes --pose, --hold and --from alone")
    if start is not None and np.abs(pose_difference(mechanism.forward(start, arm), wanted)).max() > HAND_THERE:
        raise RigError("--from has another hand pose than --pose, whose self-motion is swept")
    return sweep_self_motion(mechanism.inverse(wanted, arm) if start is None else start, arm, step, options.fixed)


def _best_visited(arm: Arm, options: PostureOptions) -> PostureResult:
    """The best of the postures of a recording, and the motion back to it."""
    recording, objective = options.recording, options.maximised
    assert recording is not None
    found = arm_motion_between_postures.best_visited_posture_and_motion_to_it(
        recording, arm, objective, options.fixed, options.T_base_hand
    )
    best, first = found.best, found.q[0]
    figures = _figures(arm, objective, found.q[best], first, (float(found.value[best]), float(found.value[0])))
    figures |= {
        "search": "among",
        "recording": str(recording.folder),
        "frame": int(found.frame[best]),
        "compared": len(found.q),
        "elsewhere": found.elsewhere,
        "values": {"best": float(found.value[best]), "worst": float(found.value.min())},
    }
    return PostureResult(arm, options, found.q[best], found.back, figures)


def _best_searched(arm: Arm, options: PostureOptions) -> PostureResult:
    """The best posture that the searches find, and the motion into it."""
    wanted, now, objective = options.T_base_hand, options.start, options.maximised
    assert wanted is not None
    arrived = now is not None and np.abs(pose_difference(mechanism.forward(now, arm), wanted)).max() < HAND_THERE
    if now is not None and not arrived and not options.during_hand_motion:
        raise RigError(
            "--from has another hand pose than --pose: bring it there first, or take the posture on the way "
            "(--motion way)"
        )
    first = now if now is not None and arrived else mechanism.inverse(wanted, arm, now)
    starts = first[None] if arrived and not options.during_hand_motion else _joint_solutions(first, wanted, arm)
    found, name, k = _best_of_searches(arm, options, first, starts)
    best = found[name]
    motion = (
        arm_motion_between_postures.motion_with_hand_on_straight_line(now if now is not None else first, best.q[k], arm)
        if options.during_hand_motion
        else arm_motion_between_postures.motion_with_hand_still(starts[k], best.q[k], arm, options.fixed)
    )
    figures = _figures(arm, objective, best.q[k], starts[k], (float(best.value[k]), float(best.start[k])))
    figures |= {
        "search": name,
        "joint_solutions_searched": len(starts),
        "values": {key: float(f.value[k]) for key, f in found.items()},
    }
    if "global" in found:
        figures["certificate"] = {
            "gradient_over_global_here": float(found["gradient"].value[k] / found["global"].value[k]),
            "reached_over_best_of_all_self_motions": float(best.value[k] / found["global"].value.max()),
        }
    return PostureResult(arm, options, best.q[k], motion, figures)


def _best_of_searches(
    arm: Arm, options: PostureOptions, first: Floats, starts: Floats
) -> tuple[dict[str, SearchResult], str, int]:
    """(what each search found, name of the best, index of its posture) from starts (k, n) rad. Raises RigError where
    nothing exceeds a limit
    """
    objective, fixed, above = options.maximised, options.fixed, options.above
    if null_space_posture_search.redundant_joint_count(arm, fixed) < 1 and isinstance(objective, ExertionObjective):
        found = {"solutions": null_space_posture_search.search_result_of_given_postures(starts, arm, objective)}
        return found, "solutions", int(found["solutions"].value.argmax())
    found = {"gradient": null_space_posture_search.gradient_search(starts, arm, objective, fixed, above)}
    if above is not None:
        enough = np.flatnonzero(found["gradient"].value > above)
        if not len(enough):
            raise RigError(
                f"no posture found whose measure exceeds {above:g}; the best reaches "
                f"{found['gradient'].value.max():.6g}"
            )
        nearest = np.abs(found["gradient"].q[enough] - first).max(axis=1).argmin()  # the least motion will do
        return found, "gradient", int(enough[nearest])
    found["sampled"] = null_space_posture_search.sampled_search(
        starts, arm, objective, np.random.default_rng(SEED), fixed
    )
    if null_space_posture_search.redundant_joint_count(arm, fixed) == 1:
        found["global"] = null_space_posture_search.whole_self_motion_search(starts, arm, objective, fixed)
    name, k = max(
        ((name, int(f.value.argmax())) for name, f in found.items()), key=lambda pair: found[pair[0]].value[pair[1]]
    )
    return found, name, k


def _joint_solutions(first: Floats, wanted: RigidTransform, arm: Arm) -> Floats:
    """(k, n) joint solutions of a pose within the limits: the first, and others far and wide."""
    many = RigidTransform.from_matrix(np.tile(wanted.as_matrix(), (STARTS, 1, 1)))
    guess = np.random.default_rng(SEED).uniform(arm.limits[:, 0], arm.limits[:, 1], (STARTS, len(first)))
    q, remainder = mechanism.damped_least_squares_arm_inverse_and_error(many, arm, guess)
    inside = (remainder <= mechanism.GOOD) & (mechanism.signed_limit_excess(q, arm) == 0).all(axis=1)
    return np.vstack([first, q[inside]])


def _figures(arm: Arm, objective: Objective, q: Floats, start: Floats, values: tuple[float, float]) -> Json:
    """Figures of a posture q (n,) rad apart from its search. values : the measure there and at the start"""
    low, high = arm.limits.T
    moved = pose_difference(mechanism.forward(start, arm), mechanism.forward(q, arm))
    columns = (
        arm_force_transmission_and_exertable_wrench.TransmissionObjective()
        if isinstance(objective, ExertionObjective)
        else objective
    )
    return {
        "schema": "posture/1",
        "unit": "rad, m",
        "directions": list(columns.directions) or "all",
        "norm": str(columns.norm),
        "measure": "greatest multiple"
        if isinstance(objective, ExertionObjective)
        else "smallest column of J^T"
        if columns.directions
        else columns.whole,
        "q": q.tolist(),
        "q_units": list(mechanisms.axis_units(arm)),
        "value": values[0],
        "start": {"q": start.tolist(), "value": values[1]},
        "hand_moved": {"position": float(np.linalg.norm(moved[:3])), "rotation": float(np.linalg.norm(moved[3:]))},
        "at_limit": (np.flatnonzero((q <= low + 1e-6) | (q >= high - 1e-6)) + 1).tolist(),
        "columns": dict(
            zip(
                columns.directions or arm_force_transmission_and_exertable_wrench.DIRECTIONS,
                arm_force_transmission_and_exertable_wrench.torque_norms_by_direction(q, arm, columns).tolist(),
            )
        ),
    }


def exertion_dict(q: Floats, arm: Arm, exertion: ExertionObjective) -> Json:
    """Dict of an exertion at posture q (n,) rad for JSON.

    Torques, margins, greatest multiple, extreme directions.
    """
    strength = exertion.strength
    weight, load = strength.weight(q, arm), joint_torques_for_wrench(q, arm, exertion.wrench)
    low, high = strength.box(q, arm)
    torque = weight + load
    margin, multiple = strength.limits - np.abs(torque), float(exertion.value(q, arm))
    bears = bool((low <= 0).all() and (high >= 0).all())
    out = {
        "wrench": exertion.wrench.tolist(),
        "torques": torque.tolist(),
        "weight": weight.tolist(),
        "limits": strength.limits.tolist(),
        "margin": margin.tolist(),
        "tightest_joint": int(np.argmin(margin / strength.limits)) + 1,
        "greatest_multiple": multiple,
        "greatest": (multiple * exertion.wrench).tolist() if bears else None,
        "weight_counted": strength.links is not None,
    }
    if bears:
        A = _torques_of_unit_forces(q, arm)
        every = force_polytope_corners(A, low, high)
        size, least = (
            np.linalg.norm(every, axis=1),
            greatest_force_in_all_directions_and_weakest_direction(A, low, high),
        )
        out["strongest"] = {"force": float(size.max()), "direction": (every[size.argmax()] / size.max()).tolist()}
        out["weakest"] = {"force": least[0], "direction": least[1].tolist()}
    return out


def _torques_of_unit_forces(q: Floats, arm: Arm) -> Floats:
    """(n, 3) Nm per N of forces along each axis."""
    return joint_torques_for_wrench(q, arm, np.eye(6)[:, :3]).reshape(len(q), 3)
