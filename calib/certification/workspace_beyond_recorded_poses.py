"""Parts of the workspace beyond all recorded poses, where nothing was seen of the machine.

A fit knows there what its model knows. What the model leaves out and shows nowhere else is in no draw of it.
Source: Wilks, Determination of sample sizes for setting tolerance limits, Ann. Math. Stat. 12, 1941 (the share of a
    population beyond the extreme of a sample)
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats

CHANCE = 1e-3  # probability, over all ends, that as many poses at random leave as much beyond them
LEAST_SHARE = 0.1  # of the workspace, beyond an end: less changes its RMS error little
NAMED = 3  # ends at most, the greatest first
SIDES = ("below the least", "above the greatest")
COORDINATES = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")


def sentences_on_workspace_beyond_recorded_poses(
    recorded: tuple[Floats, RigidTransform], workspace: tuple[Floats, RigidTransform], axes: tuple[str, ...]
) -> tuple[str, ...]:
    """Sentences, one or none, on the coordinates beyond whose recorded range much of the workspace lies.

    Much is more than so many poses at random leave there by chance.
    recorded : commands (n, axes) m or rad of distinct configurations, and their poses (n,); workspace : the same at
        (m,) places spread evenly; axes : their names
    """
    middle = workspace[1].mean()
    seen, wanted = (np.hstack([commands, _coordinates(T, middle)]) for commands, T in (recorded, workspace))
    beyond = np.stack([(wanted < seen.min(axis=0)).mean(axis=0), (wanted > seen.max(axis=0)).mean(axis=0)], axis=1)
    by_chance = 1 - (CHANCE / beyond.size) ** (1 / len(seen))
    missed = np.argwhere(beyond > max(LEAST_SHARE, by_chance))
    missed = missed[np.argsort(-beyond[tuple(missed.T)], kind="stable")][:NAMED]
    names = (*axes, *COORDINATES)
    ends = ", ".join(f"{beyond[i, k] * 100:.0f} % {SIDES[k]} of {names[i]}" for i, k in missed)
    sentence = f"the workspace reaches beyond the recorded poses: {ends}; nothing shows what is omitted there"
    return (sentence,) if ends else ()


def _coordinates(T: RigidTransform, middle: RigidTransform) -> Floats:
    """(n, 6) m and rad, poses T (n,) from the middle one."""
    return np.hstack([T.translation, (middle.inv() * T).rotation.as_rotvec()])
