"""Sweep of an arm's self-motion.

Postures at even steps with the hand still, as commands of a plan.
Source: patent on force measurement with redundant manipulators, [0021], [0022].
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Json
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_single_hand_mechanism
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.posture import null_space_posture_search
from rig.recording.corner_and_pose_csv_tables import write_table

LEAST_STEP = 1e-3  # rad, of slides m


@dataclass(frozen=True, slots=True, eq=False)
class PostureSweep:
    """arm; q : (k, n) rad and m, in order; exposed : (k,) bool, the postures to visit, the others are passed on the way
    closed : whether the self-motion closes on itself; step : rad, of slides m, of the fastest joint between two visits
    """

    arm: Arm
    q: Floats
    exposed: Booleans
    closed: bool
    step: float

    def __str__(self) -> str:
        ends = "once round" if self.closed else "from end to end"
        slides = f" (slides {self.step * 1e3:.3f} mm)" if self.arm.slides.any() else ""
        return (
            f"{self.exposed.sum()} postures of the self-motion, {ends}, {np.degrees(self.step):.3f} degrees{slides} of "
            "the fastest joint apart"
            + "".join(
                f"; the {which} is at the limit of {' and '.join(f'joint {j}' for j in joints)}"
                for which, joints in zip(("first", "last"), self.tree()["ends_at_limits"])
                if joints
            )
        )

    def tree(self) -> Json:
        """What `rig arm posture --sweep --json` prints."""
        low, high = self.arm.limits.T
        ends = self.q[self.exposed][[0, -1]]
        at_limit = (ends <= low + null_space_posture_search.TRACE) | (ends >= high - null_space_posture_search.TRACE)
        return {
            "schema": "posture-sweep/1",
            "unit": "rad, m",
            "postures": int(self.exposed.sum()),
            "step": self.step,
            "closed": self.closed,
            "ends": ends.tolist(),
            "ends_at_limits": [] if self.closed else [(np.flatnonzero(row) + 1).tolist() for row in at_limit],
            "q_units": list(mechanisms.axis_units(self.arm)),
        }

    def write(self, path: Path) -> None:
        """Write it as frame,q1.., for the plan commands:FILE; rows without a frame are passed on the way."""
        number = np.cumsum(self.exposed) - 1
        rows = [
            ",".join([str(number[k]) if self.exposed[k] else "", *(f"{value:.9f}" for value in row)])
            for k, row in enumerate(self.q)
        ]
        write_table(path, ("frame", *self.arm.axes), rows)


def sweep_self_motion(start: Floats, arm: Arm, step: float, fixed_hand_part: str = "pose") -> PostureSweep:
    """Sweep of a self-motion (PostureSweep) from a starting posture.

    From there to the nearer end of its self-motion, then to the other end.
    start : (n,) rad and m; step : rad, of slides m, that the fastest joint moves between two visits at the most
    A self-motion that closes on itself is visited once round, from the start on.
    Raises RigError for a step too small, several hands, a start outside the limits, and a self-motion of more or fewer
        dimensions than one
    """
    require_single_hand_mechanism(arm, "postures are swept")
    if not step >= LEAST_STEP:
        raise RigError(f"--sweep takes a step of at least {LEAST_STEP:g} rad, not {step:g}")
    if (count := null_space_posture_search.redundant_joint_count(arm, fixed_hand_part)) > 1:
        raise RigError(
            f"the self-motion has {count} dimensions, the hand's {fixed_hand_part} held; a sweep visits one that has "
            "one dimension"
        )
    traced = null_space_posture_search.trace_self_motion(start, arm, fixed_hand_part)
    index = int(np.abs(traced - start).max(axis=1).argmin())
    laps = [part for part in (traced[index:], traced[index::-1]) if _is_lap(part, arm)]
    path = laps[0] if laps else traced if 2 * index < len(traced) else traced[::-1]
    closed, begin = bool(laps), int(np.abs(path - start).max(axis=1).argmin())
    before = path[begin:0:-1]  # from the start to the end where it begins
    travelled = np.r_[0.0, np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))]
    whole = float(travelled[-1])
    if not whole > 0:
        raise RigError("the posture has no self-motion: every other one leaves the joint limits or the hand's place")
    visits = np.linspace(0.0, whole, max(int(np.ceil(whole / step)), 2) + 1)[: -1 if closed else None]
    near = np.array([np.interp(visits, travelled, column) for column in path.T]).T
    target = np.broadcast_to(mechanism.single_hand_arm_link_frames(start[None], arm)[:, -1], (len(visits), 4, 4))
    visited = null_space_posture_search.joint_angles_returning_hand_to_target(near, target, arm, fixed_hand_part)
    visited = np.clip(visited, *arm.limits.T)  # by what bringing the hand back rounds, less than 1e-9
    passed = ~np.isin(travelled, visits)
    order = np.argsort(np.r_[travelled[passed], visits], kind="stable")
    q = np.vstack([path[passed], visited])[order]
    exposed = np.r_[np.zeros(passed.sum(), bool), np.ones(len(visits), bool)][order]
    last = int(np.flatnonzero(exposed)[-1])
    return PostureSweep(
        arm,
        np.vstack([before, q[: last + 1]]),
        np.r_[np.zeros(len(before), bool), exposed[: last + 1]],
        closed,
        float(visits[1] - visits[0]),
    )


def _is_lap(path: Floats, arm: Arm) -> bool:
    """Whether a traced path (k, n) ends where it began, whole turns of joints aside."""
    apart = path[-1] - path[0]
    apart -= np.where(arm.slides, 0.0, 2 * np.pi * np.round(apart / (2 * np.pi)))
    return len(path) > 10 and bool(np.linalg.norm(apart) <= null_space_posture_search.TRACE)
