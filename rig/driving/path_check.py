"""Whether a mechanism may go straight from some lengths to others: strut ranges, step, workspace and distance from
singularities.
"""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.driving.operator_advice import OUT_OF_RANGE
from rig.errors import NotConverged, Unreachable
from rig.model import mechanisms
from rig.model.design import Hexapod, Planar2

SPACING = 2e-3  # m of the strut that moves most, between the places looked at
FEWEST, MOST = 3, 200  # of them, beside the start


def check_lengths(lengths: np.ndarray, mechanism: Hexapod | Planar2) -> np.ndarray:
    """Lengths (n,) m, once they are finite and within the strut ranges. Raises ValueError, Unreachable naming each
    strut beyond its range.
    """
    lengths = np.array(lengths, float)
    if lengths.shape != (len(mechanism.axes),) or not np.isfinite(lengths).all():
        raise ValueError(f"expected {len(mechanism.axes)} finite lengths in m, got {lengths.tolist()}")
    beyond = mechanisms.kinematics_of(mechanism).limits(lengths, mechanism)
    if beyond.any():
        low, high = mechanism.strut_range.T
        lines = [
            f"strut {i + 1}: {lengths[i]:.6f} m is outside {low[i]:g} .. {high[i]:g} m" for i in np.flatnonzero(beyond)
        ]
        raise Unreachable("not moved: the lengths are beyond what the struts reach", [0], lines)
    return lengths


def check_path(
    start: np.ndarray, target: np.ndarray, mechanism: Hexapod | Planar2, margin: float, max_step: float | None
) -> None:
    """Nothing, where the straight way in lengths may be gone; everything else raises Unreachable.

    start, target : (n,) m, start as read back, which may lie outside the range as long as the way leads inwards
    margin : least singular value of the Jacobian as a share of that at home; max_step : m, or None
    """
    step = np.abs(target - start).max()
    if max_step is not None and step > max_step:
        raise Unreachable(
            "not moved: the step is too large",
            [0],
            [f"{1e3 * step:.3f} mm, [controller] max_step allows {1e3 * max_step:.3f} mm"],
        )
    count = int(np.clip(np.ceil(step / SPACING), FEWEST, MOST))
    share = np.linspace(0.0, 1.0, count + 1)
    way = start + share[:, None] * (target - start)
    module = mechanisms.kinematics_of(mechanism)
    home = (
        mechanism.home if mechanism.kind == "hexapod" else module.forward(mechanism.strut_range.mean(axis=1), mechanism)
    )
    try:
        poses = module.forward(way, mechanism)
    except NotConverged as error:
        k = int(np.min(error.index))
        where = [f"{share[k]:.0%} along: {error}", *([OUT_OF_RANGE] if k == 0 else [])]
        raise Unreachable("not moved: the way leaves the workspace", [k], where) from None
    least = _dexterity(module, poses, mechanism) / _dexterity(module, home, mechanism)
    if least.min() < margin:
        k = int(np.argmin(least))
        raise Unreachable(
            "not moved: the way comes too near a singularity",
            [k],
            [
                f"{share[k]:.0%} along, at lengths {way[k].round(6).tolist()} m: {least[k]:.3f} of the "
                "Jacobian's least singular "
                f"value at home is left, [controller] margin asks for {margin:g}"
            ],
        )


def _dexterity(module: Any, poses: RigidTransform, mechanism: Hexapod | Planar2) -> np.ndarray:
    """(...) least singular value of the Jacobian, turns taken as lengths at the platform joints' mean radius."""
    J = module.jacobian(poses, mechanism)
    if mechanism.kind == "hexapod":
        J = J / np.r_[1, 1, 1, np.full(3, np.linalg.norm(mechanism.platform_joints, axis=1).mean())]
    return np.linalg.svd(J, compute_uv=False)[..., -1]
