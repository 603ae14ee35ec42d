"""Link bending of an arm.

A link, or the free length of its slide, bends and twists under the load at its far end.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Context, Covariate, Parameter
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import joint_carries_joint_matrix
from rig.model.mechanisms.arm_dynamics_and_step_by_step_kinematics import weight_wrench
from rig.model.mechanisms.arm_kinematics_limits_and_loads import forward, joint_frames
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links, require_arm

TUBE = 0.77  # G J / (E I) of a closed tube: 1 / (1 + Poisson's ratio), with 0.3 of steel and aluminium
OPEN = (0.02, 0.1, 0.3)  # the same of open and slit sections, which a search tries
SHORT = 1e-3  # m; a link that is no longer at any posture does not bend


@dataclass(frozen=True, slots=True)
class LinkBending(Effect):
    """The link that a joint moves is a beam of length L along e, from its joint's axis to the next frame; of a slide, L
    grows with its travel. A force F and a moment M at its far end turn that end by
    (L M_across + L^2/2 e x F) / stiffness + L M_along / (torsion stiffness) and move it by
    (L^3/3 F_across + L^2/2 M x e) / stiffness: stiffness is E I, torsion is G J / (E I). F and M are the weight of the
    hands that the link carries, with their payload.

    Source: Gere and Timoshenko, Mechanics of Materials, appendix G (Euler and Bernoulli's cantilever, Saint-Venant's
    torsion)
    """

    place: str
    stiffness: float = np.inf
    torsion: float = TUBE
    name: ClassVar = "link_bending"
    stage: ClassVar = "structure"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("stiffness", "N m^2", (1.0, np.inf), (1e3, 1e6), role="inverse"),
        Parameter("torsion", "", (1e-3, 10.0), (0.02, 0.9), role="form"),
    )
    experiment: ClassVar = (
        "the same postures with another payload, some with the load beside the link's plane: compliance of a {axis} "
        "acts along its own axis alone"
    )
    action: ClassVar = (
        "Correct poses by the load that the link of the {axis} carries, brace that link, or calibrate with the load "
        "that the machine will carry."
    )
    on_pose: ClassVar = True
    once: ClassVar = True
    of_links: ClassVar = True

    def needs(self, motion: Motion) -> str | None:
        if not has_links(motion.mechanism):
            return "takes the links of an arm"
        reason = motion.no_loads()
        if reason:
            return reason
        root, tip = _ends(motion, self._joint(motion))
        return None if np.linalg.norm(tip - root, axis=1).max() > SHORT else "takes a link that has a length"

    def sway(self, motion: Motion) -> Floats:
        if np.isinf(self.stiffness):
            return np.zeros((len(motion.t), 6))
        reason = self.needs(motion)
        if reason:
            raise RigError(f"{self.name} {reason}")
        bent, twisted = self._sways(motion)
        return (bent + twisted / self.torsion) / self.stiffness

    def covariate(self, motion: Motion) -> Covariate:
        _, force, moment, along = self._load(motion)
        root = moment + np.cross(along, force)
        return Covariate(np.linalg.norm(root, axis=1), f"moment at the root of the link of {self.place}, N m")

    def _joint(self, motion: Motion) -> int:
        return int(np.flatnonzero(self.axes(motion.places))[0])

    def _sways(self, motion: Motion) -> tuple[Floats, Floats]:
        """Tangents (n, 6) of the hand per 1 / (N m^2) by bending and by twisting, worked out once."""

        def made() -> Floats:
            tip, force, moment, along = self._load(motion)
            length = np.linalg.norm(along, axis=1, keepdims=True)
            e = along / np.maximum(length, SHORT)
            twist = (moment * e).sum(axis=1, keepdims=True) * e
            pull = (force * e).sum(axis=1, keepdims=True) * e
            turn = length * (moment - twist) + length**2 / 2 * np.cross(e, force)
            shift = length**3 / 3 * (force - pull) + length**2 / 2 * np.cross(moment, e)
            lever = motion.poses().translation - tip
            parts = [(turn, shift + np.cross(turn, lever)), (length * twist, np.cross(length * twist, lever))]
            moves = require_arm(motion.mechanism).moving[self._joint(motion)]  # whether the link carries the hand
            return np.stack([moves * motion.tangents(np.concatenate([by, turned], axis=1)) for turned, by in parts])

        bent, twisted = motion.once((self.name, self.place), made)
        return bent, twisted

    def _load(self, motion: Motion) -> tuple[Floats, Floats, Floats, Floats]:
        """(far end (n, 3) m of the link, force (n, 3) N and moment (n, 3) N m there, the link (n, 3) m), in the axes of
        poses.
        """
        joint = self._joint(motion)
        root, tip = _ends(motion, joint)
        force, moment = np.zeros_like(tip), np.zeros_like(tip)
        for place, push, turn in _hand_loads(motion, joint):
            force += push
            moment += turn + np.cross(place - tip, push)
        return tip, force, moment, tip - root

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        open_sections = [{"torsion": share} for share in OPEN]
        linear = cls.linear(place)[:1]
        return [
            Candidate(cls, place, [{}], linear),
            Candidate(cls, place, open_sections, linear, "open section", extra=1),
        ]


def _ends(motion: Motion, joint: int) -> tuple[Floats, Floats]:
    """(root, far end) (n, 3) m of the link that a joint moves; of a slide, its free length."""
    frames = joint_frames(motion.lengths, require_arm(motion.mechanism))
    return frames.before[:, joint, :3, 3], frames.after[:, joint, :3, 3]


def _hand_loads(motion: Motion, joint: int) -> list[tuple[Floats, Floats, Floats]]:
    """(place (n, 3) m, force (n, 3) N, moment (n, 3) N m about that place) of each hand that a joint's link carries."""
    arm = require_arm(motion.mechanism)
    if not arm.hands:
        loads = [(motion.poses(), motion.platform_wrench())]
    else:
        carried, gravity, loads = joint_carries_joint_matrix(arm.parents)[joint], motion.gravity_in_base(), []
        for number, hand in enumerate(arm.hands):
            if carried[hand.joint]:
                T = forward(motion.lengths, arm.of_hand(number))
                loads.append((T, weight_wrench(T, gravity, hand.mass or 0.0, hand.centre_of_mass)))
    out = []
    for T, wrench in loads:
        force, moment = np.einsum("nij,nkj->kni", T.rotation.as_matrix(), wrench.reshape(-1, 2, 3))
        out.append((T.translation, force, moment))
    return out
