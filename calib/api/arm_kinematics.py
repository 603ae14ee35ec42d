"""Kinematics of an arm: poses of joint values, joint values of poses.

The arm is as its owner believes it, or as calibrated; all joint values of a pose are given.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.api.nominal_and_calibrated_platform_kinematics import PlatformKinematics
from calib.files import calibration_file
from calib.models.arm.arm_correction import ArmCorrection
from rig.array_and_json_types import Floats, Integers, Json
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_single_hand_mechanism
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics, closed_form_and_numerical_arm_inverse
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms.arm_dynamics_and_step_by_step_kinematics import KinematicsStep
from rig.model.mechanisms.closed_form_and_numerical_arm_inverse import SixJointArm
from rig.model.mechanisms.forward_solution_steps import forward_solution_steps
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_parallel, require_arm
from rig.model.pose import pose_to_vector
from rig.planning.layout import shipped_arms_and_layouts

FOLLOWS = 1e-6  # rad or m to which a stated value of a joint that follows another must be as the coupling has it
SINGULAR = 1e-6  # least over greatest singular value of the Jacobian, below which a configuration is called singular


@dataclass(frozen=True, slots=True, eq=False)
class ArmKinematics:
    """arm : as its owner believes it; correction : of its calibration, or None; left_out : what of the calibration this
    leaves out, a sentence, or None; spacing : m, of the points B and C of the hand from A, where steps are given
    """

    arm: Arm
    correction: ArmCorrection | None = None
    left_out: str | None = None
    spacing: float = 1.0

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the joints, as a table of values heads its columns."""
        return self.arm.axes

    def forward(self, frames: Integers, q: Floats, steps: bool = False, trace: bool = False) -> Json:
        """Poses that joint values q (n, joints) rad or m give, as `rig arm kinematics --forward --json` prints them.

        frames : (n,) their numbers; steps : whether points and vectors after each joint are given
        Raises RigError for a trace of iterations, of which an arm has none, and for values of joints that follow others
        and stand elsewhere than these lead them
        """
        if trace:
            forward_solution_steps(q[0], self.arm)
        arm, correction = self.arm, self.correction
        followed = arm.with_followers(q)
        for i, j in np.argwhere(np.abs(followed - q) > FOLLOWS)[:1]:
            raise RigError(
                f"frame {frames[i]}: {mechanisms.axis_place_texts(arm)[j]} follows another by [[mechanism.coupling]], "
                f"which has it at {followed[i, j]:.9g} {mechanisms.axis_units(arm)[j]}, not at {q[i, j]:.9g}"
            )
        q = followed
        T = mechanism.forward(q, arm)
        beyond = mechanism.signed_limit_excess(q, arm)
        out = []
        for i, frame in enumerate(frames.tolist()):
            entry: Json = {
                "frame": frame,
                "q": q[i].tolist(),
                "pose": pose_to_vector(T[i]).tolist(),
                "near_singular": _near_singular(q[i], arm),
                "beyond_limits": [p for p, b in zip(mechanisms.axis_place_texts(arm), beyond[i]) if b],
            }
            if correction is not None:
                entry["corrected"] = pose_to_vector(correction.predict(q[i])).tolist()
            out.append(
                entry
                | (
                    {
                        "steps": _steps(
                            arm_dynamics_and_step_by_step_kinematics.hand_points_after_moving_each_joint(q[i], arm),
                            self.spacing,
                        )
                    }
                    if steps
                    else {}
                )
            )
        return {"schema": "kinematics/1", "units": list(mechanisms.axis_units(arm)), "frames": out}

    def inverse(self, frames: Integers, T_base_platform: RigidTransform, steps: bool = False) -> Json:
        """All joint values of poses (n,), as `rig arm kinematics --inverse --json` prints them; else as forward."""
        arm, correction = self.arm, self.correction
        form, why_none = None, ""
        try:
            form = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(arm)
        except RigError as error:
            why_none = str(error)
        out, spacing = [], self.spacing if steps else None
        for i, frame in enumerate(frames.tolist()):
            state, entries = (
                _numeric(T_base_platform[i], arm, spacing)
                if form is None
                else _closed(T_base_platform[i], form, spacing)
            )
            for entry in entries:
                entry["beyond_limits"] = _beyond(entry["q"], arm)
                if correction is not None:
                    entry["corrected"] = _finished(T_base_platform[[i]], entry["q"], correction)
            out.append({"frame": frame, "state": state, "solutions": entries})
        return {
            "schema": "kinematics/1",
            "units": list(mechanisms.axis_units(arm)),
            "form": form.kind if form is not None else f"numeric: {why_none}",
            "frames": out,
        }


def load_kinematics(text: str) -> ArmKinematics | PlatformKinematics:
    """Arm or platform kinematics loaded by a text.

    PlatformKinematics is of a platform on struts or of a kinematics file.
    Path of a rig.toml or calibration.json, or a shipped arm's name.
    Raises RigError for other kinds
    """
    if Path(text).suffix != ".json":
        machine = shipped_arms_and_layouts.load_shipped_arm_design(text).mechanism
        if is_parallel(machine):
            return PlatformKinematics(machine)
        arm = require_arm(machine)
        require_single_hand_mechanism(arm, "kinematics is printed")
        return ArmKinematics(arm)
    calibration = calibration_file.load(text)
    correction, left_out = calibration.correction, None
    if calibration.physics is not None and calibration.physics.compensable_effects():
        names = ", ".join(f"{e.label()} at {e.place}" for e in calibration.physics.compensable_effects())
        left_out = f"{text} undoes {names} as well, by the preceding motion: not included below; rig correct does it"
    nominal = correction.nominal
    if isinstance(correction, ArmCorrection):
        return ArmKinematics(correction.nominal, correction, left_out)
    if is_parallel(nominal):
        return PlatformKinematics(nominal, correction, left_out)
    raise RigError(f"{text} is the calibration of a {nominal.kind}; this takes an arm's or a platform's")


def _near_singular(q: Floats, arm: Arm) -> float:
    """Least over greatest singular value of the Jacobian, 0 where singular; over as many directions as the joints can
    lead in at all.
    """
    values = np.linalg.svd(mechanism.jacobian(q, arm), compute_uv=False)
    return float(values[sum(closed_form_and_numerical_arm_inverse.hand_motion_direction_counts(arm)) - 1] / values[0])


def _closed(T: RigidTransform, form: SixJointArm, spacing: float | None) -> tuple[str, list[Json]]:
    """(state of a pose in words, its branches), in closed form.

    spacing : m, of the points in its steps, None for no steps
    """
    found = closed_form_and_numerical_arm_inverse.closed_form_inverse(T, form)
    return found.why(0), [
        {
            "q": q.tolist(),
            "singular": _singular(flags),
            **(
                {
                    "steps": _steps(
                        arm_dynamics_and_step_by_step_kinematics.steps_of_closed_form_inverse(T, form, q), spacing
                    )
                }
                if spacing is not None
                else {}
            ),
        }
        for q, flags in zip(found.q[found.exists], found.singular[found.exists].tolist())
    ]


def _numeric(T: RigidTransform, arm: Arm, spacing: float | None) -> tuple[str, list[Json]]:
    """(state of a pose in words, the solutions that many starts lead to, named as found so); rest : what few joints
    leave of it. spacing : as there
    """
    found = closed_form_and_numerical_arm_inverse.numerical_inverse_solutions(T, arm)
    if not len(found.q):
        place, turn = (1e3 * missed for missed in found.missed)
        return f"unreachable: the arm comes no nearer than {place:.3g} mm and {turn:.3g} mrad", []
    entries = [
        {
            "q": q.tolist(),
            "singular": "singular" if _near_singular(q, arm) < SINGULAR else "",
            "rest": rest.tolist(),
            "found": "numerically",
            **(
                {
                    "steps": _steps(
                        arm_dynamics_and_step_by_step_kinematics.joint_by_joint_inverse_steps(T, arm, q), spacing
                    )
                }
                if spacing is not None
                else {}
            ),
        }
        for q, rest in zip(found.q, found.rest)
    ]
    return ("singular" if all(entry["singular"] for entry in entries) else "regular"), entries


def _beyond(q: list[float], arm: Arm) -> list[str]:
    """Places of the joints that no whole turn brings within their limits."""
    beyond = mechanism.signed_limit_excess(mechanism.nearest_equivalent_angles(np.array(q), arm, np.zeros(len(q))), arm)
    return [place for place, by in zip(mechanisms.axis_place_texts(arm), beyond) if by]


def _finished(T: RigidTransform, q: list[float], correction: ArmCorrection) -> list[float] | None:
    """Commands of the calibrated arm for a pose (1,), sought from a solution of its nominal model; None where none is
    near.
    """
    commands = correction.near(T, np.array([q]))[0]
    return None if np.isnan(commands).any() else commands.tolist()


def _singular(flags: int) -> str:
    return ", ".join(name for bit, name in closed_form_and_numerical_arm_inverse.SINGULAR.items() if flags & bit)


def _steps(steps: list[KinematicsStep], spacing: float) -> list[Json]:
    """Steps, with B and C as far from A as stated: the hand is rigid. Source: recursive kinematics patent, claim 3"""
    out = []
    for s in steps:
        A, AB, AC = s.points[0], spacing * (s.points[1] - s.points[0]), spacing * (s.points[2] - s.points[0])
        points = [A, A + AB, A + AC, *s.points[3:]]
        out.append(
            {
                "joint": s.joint,
                "value": s.value,
                "axis": {"point": s.axis[0].tolist(), "vector": s.axis[1].tolist()},
                "points": {name: point.tolist() for name, point in zip(s.names, points)},
                "AB": AB.tolist(),
                "AC": AC.tolist(),
            }
        )
    return out
