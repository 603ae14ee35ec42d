"""The straight move of all axes from one place to another, at a share of the speeds that [controller] states."""

import numpy as np

from rig.driving.protocols.protocol_interface import Segment
from rig.model import mechanisms
from rig.model.controller_settings import Controller
from rig.model.design import Hexapod, Planar2


def straight_move(
    start: np.ndarray, target: np.ndarray, share: float, controller: Controller, mechanism: Hexapod | Planar2
) -> Segment:
    """All axes begin and arrive together. start, target : (n,) m, lengths; share : of the greatest speeds, above 0 and
    at most 1.
    """
    way = np.abs(target - start)
    duration = max(float((way / (share * controller.max_speed)).max()), 1e-6)
    acceleration = None
    if controller.max_acceleration is not None and way.any():
        acceleration = way * (controller.max_acceleration[way > 0] / way[way > 0]).min()
    pose = mechanisms.kinematics_of(mechanism).forward(target, mechanism) if controller.kinematics == "world" else None
    return Segment(start - controller.zero, target - controller.zero, duration, way / duration, acceleration, pose)
