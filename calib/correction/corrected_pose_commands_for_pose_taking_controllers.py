"""Poses to command a controller that takes poses, so that its own nominal kinematics gives the corrected lengths.

Such a controller computes strut lengths from a pose by its nominal geometry, the one of rig.toml. The pose to command
is therefore the nominal forward kinematics of the corrected lengths, in its frames and about its pivot point.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.driving.protocols.gcs_hexapod import PoseFrames
from rig.errors import NotConverged
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, require_hexapod

AGREED = 1e-9  # m, of the lengths that a commanded pose gives


def poses_to_command(nominal: Mechanism, lengths: Floats, wanted: RigidTransform, frames: PoseFrames) -> RigidTransform:
    """Poses (n,) to command so that the controller's nominal kinematics gives strut lengths (n, 6) m.

    wanted : T_base_platform (n,) near which they are looked for
    Raises RigError for what is no hexapod, NotConverged for lengths that no pose near the wanted one gives, and for a
    pose whose lengths are not these
    """
    hexapod = require_hexapod(
        nominal, "a controller that takes poses drives a hexapod, not a mechanism of kind {kind!r}"
    )
    found = mechanisms.hexapod.forward(lengths, hexapod, wanted)
    command = frames.command_of_pose(found)
    off = np.abs(mechanisms.hexapod.inverse(frames.pose_of_command(command), hexapod) - lengths).max(axis=-1)
    wrong = np.flatnonzero(~(off <= AGREED))
    if len(wrong):
        raise NotConverged(
            f"{len(wrong)} of {len(off)} commanded poses do not give their lengths back; the worst is off by "
            f"{off.max():.3g} m",
            wrong,
            lengths[wrong],
            off[wrong],
        )
    return command
