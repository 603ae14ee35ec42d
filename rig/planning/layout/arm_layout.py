"""A rig.toml of a shipped arm that cameras see: cubes in its hand before fixed cameras, or cameras in its hand before
cubes that stand.

The arm is to move about one posture, far from its singular ones, in which hand and cubes stay in view: its limits are
narrowed to that.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.model.design import Arm
from rig.model.mechanism_kinds import arm_of
from rig.model.mechanisms import arm as mechanism
from rig.planning.configuration_sets import low_discrepancy
from rig.planning.layout import shipped_arms
from rig.planning.layout.layout_elements import (
    FACES,
    Ring,
    camera,
    camera_lines,
    camera_pose,
    check_layout,
    cube_lines,
    cube_ring_lines,
)

TRIED = 400  # postures, of which the one with the best conditioned Jacobian is taken
TURNS = {"cubes": 0.45, "hand": 0.3}  # rad either way that every joint may turn, by what is carried
SLIDES = 0.15  # of a slide's stroke either way
WIDE = 0.75  # rad to either side that a camera in the hand sees


def arm_layout(name: str, carried: str, cameras: int, size: tuple[int, int], cubes: int, dictionary: str) -> str:
    """Text of a rig.toml of a shipped arm.

    carried : "cubes" or "hand", for cameras in the hand; cameras : how many; size : px of the images; cubes : how many
    in the hand and on the base, or three times as many before the hand
    Raises RigError for a name that there is not, a dictionary with too few identities, or figures that make no rig
    """
    text = shipped_arms.shipped_arm_rig_toml(name).replace(shipped_arms.INSTRUMENT, "")
    arm = _posed(arm_of(shipped_arms.load_shipped_arm(name).mechanism), TURNS[carried])
    check_layout(1.0, cameras, cubes if carried == "cubes" else -(-3 * cubes // 2), dictionary)
    lines = [_narrowed(text, arm).rstrip(), ""]
    T = mechanism.forward(low_discrepancy(arm.limits, 64, 1.0), arm)
    middle = T.translation.mean(axis=0)
    reach = float(np.linalg.norm(T.translation - middle, axis=1).max())
    lines += (
        _cubes_in_hand(middle, reach, cameras, size, cubes, dictionary)
        if carried == "cubes"
        else _cameras_in_hand(
            mechanism.forward(arm.limits.mean(axis=1), arm), reach, cameras, size, 3 * cubes, dictionary
        )
    )
    return "\n".join(lines) + "\n"


def _posed(arm: Arm, turn: float) -> Arm:
    """The arm with limits about its best conditioned posture, of those tried."""
    reach = np.where(arm.slides, SLIDES * np.ptp(arm.limits, axis=1), np.minimum(turn, np.ptp(arm.limits, axis=1) / 2))
    inner = np.stack([arm.limits[:, 0] + reach, arm.limits[:, 1] - reach], axis=1)
    q = low_discrepancy(np.clip(inner, -np.pi, np.pi), TRIED, 0.9)
    q = np.where(inner[:, 0] < inner[:, 1], np.clip(q, inner[:, 0], inner[:, 1]), inner.mean(axis=1))
    least = np.linalg.svd(mechanism.jacobian(q, arm), compute_uv=False)[:, -1]
    best = q[np.argmax(least)].round(2)
    return Arm(arm.joints, np.stack([best - reach, best + reach], axis=1).round(4), arm.base, arm.tool, arm.slides)


def _narrowed(text: str, arm: Arm) -> str:
    """A shipped arm's text with these limits."""
    import tomlkit

    document = tomlkit.parse(text)
    limits = tomlkit.item(arm.limits.tolist())
    limits.comment("narrowed to where hand and cubes are seen; the arm's own are wider")
    document["mechanism"]["limits"] = limits
    return tomlkit.dumps(document)


def _cubes_in_hand(
    middle: np.ndarray, reach: float, cameras: int, size: tuple[int, int], cubes: int, dictionary: str
) -> list[str]:
    edge_platform, edge_base = (share * reach * (2 / np.sqrt(max(cubes, 4))) for share in (0.24, 0.3))
    low = middle - [0, 0, 0.8 * reach - edge_base / 2]
    return camera_lines(middle, reach, cameras, *size) + cube_ring_lines(
        cubes,
        dictionary,
        Ring(np.array([0, 0, edge_platform / 2]), 0.22 * reach, edge_platform, 0.35),
        Ring(low, reach, edge_base, 0.35),
    )


def _cameras_in_hand(
    T: RigidTransform, reach: float, cameras: int, size: tuple[int, int], cubes: int, dictionary: str
) -> list[str]:
    """Cameras that look out of the hand, along its z, and cubes in a field before it, their +z towards it."""
    lines, apart = list[str](), 0.12 * reach
    for i in range(cameras):
        angle = 2 * np.pi * i / cameras
        at = RigidTransform.from_translation(
            apart * np.array([np.cos(angle), np.sin(angle), 0]) if cameras > 1 else [0.0, 0, 0]
        )
        lines += camera(f"cam{i}", at, WIDE, size, "hand")
    ahead = T.rotation.apply([0, 0, 1.0])
    far = 1.6 * reach
    field = camera_pose(T.translation + far * ahead, ahead).rotation
    wide = int(np.ceil(np.sqrt(cubes * 4 / 3)))
    facing = field * Rotation.from_rotvec([np.pi, 0, 0])  # z back to the hand
    for i in range(cubes):
        across, up = i % wide - (wide - 1) / 2, i // wide - (-(-cubes // wide) - 1) / 2
        depth = 0.12 * far * ((i * 2) % 3 - 1)
        place = T.translation + (far + depth) * ahead + 0.42 * far * field.apply([across, up, 0.0])
        turn = (facing * Rotation.from_rotvec([0, 0, 0.4 * i])).as_rotvec()
        lines += cube_lines(f"B{i + 1}", "base", dictionary, len(FACES) * i, 0.17 * far, place, turn)
    return lines
