"""Links that bend and twist: each of many short stiff pieces between which springs yield to the moment there, in
balance with the weight of what the links carry.

No formula of a beam's end is used: what bending does there comes from adding up the pieces' turns.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tests.truth.kinematics import Arm

DOWN = np.array([0.0, 0.0, -9.80665])
PIECES, ROUNDS = 60, 4


@dataclass(frozen=True)
class Beam:
    """A link. root, tip : (n, 3) m where it begins and ends, unbent; carries : numbers of hands that move with it;
    bending, twisting : N m^2, E I and G J
    """

    root: np.ndarray
    tip: np.ndarray
    carries: tuple[int, ...]
    bending: float
    twisting: float


def bent(hands: list[np.ndarray], loads: list[tuple[float, np.ndarray]], beams: list[Beam]) -> list[np.ndarray]:
    """Poses (n, 4, 4) of hands that stand at `hands` where nothing bends.

    loads : (kg, (3,) m in its frame) of each hand; beams : from the base outwards
    """
    placed = hands
    for _ in range(ROUNDS):
        pulls = [
            (hand[:, :3, :3] @ centre + hand[:, :3, 3], mass * DOWN) for hand, (mass, centre) in zip(placed, loads)
        ]
        placed = [hand.copy() for hand in hands]
        for beam in reversed(beams):
            along = beam.tip - beam.root
            length = np.linalg.norm(along, axis=1, keepdims=True)
            e, piece = along / length, length / PIECES
            for k in reversed(range(PIECES)):
                at = beam.root + along * (k + 0.5) / PIECES
                moment = sum(np.cross(pulls[hand][0] - at, pulls[hand][1]) for hand in beam.carries)
                twist = (moment * e).sum(axis=1, keepdims=True) * e
                turn = Rotation.from_rotvec(piece * ((moment - twist) / beam.bending + twist / beam.twisting))
                for hand in beam.carries:
                    placed[hand][:, :3, 3] = turn.apply(placed[hand][:, :3, 3] - at) + at
                    placed[hand][:, :3, :3] = turn.as_matrix() @ placed[hand][:, :3, :3]
    return placed


def bent_arm(arm: Arm, values: np.ndarray, load: tuple[float, np.ndarray], links: dict[int, tuple[float, float]]):
    """(n, 4, 4) of an arm's hand at commands (n, k), some of whose links bend: {joint from 1: (E I, G J)}."""
    frames = arm.frames(values)
    beams = [
        Beam(frames[joint - 1][:, :3, 3], frames[joint][:, :3, 3], (0,), *stiffness)
        for joint, stiffness in sorted(links.items())
    ]
    return bent([frames[-1]], [load], beams)[0]
