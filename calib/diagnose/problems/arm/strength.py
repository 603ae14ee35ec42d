"""How strong an effect is in an arm's recording: its signal-to-noise once calibration has taken what it can, all of the truth being known."""

import numpy as np

from calib.arms import model
from calib.arms.identify import parameters
from rig import machine
from rig.design import Arm, Design
from rig.effects.base import Effect
from rig.errors import RigError
from rig.pose import difference
from rig.recording import Commands, Sensors


def strengths(true: Design, commands: Commands, t: np.ndarray, sigma: np.ndarray, effects: tuple[Effect, ...], sensors: Sensors) -> np.ndarray:
    """(effects,) whitened length of what each effect does to all poses, the arm's parameters projected out.

    true : Design as it really is; commands, t (n,) s : what was commanded, and when it was measured; sensors : as they truly were
    sigma : (2,) m and rad, or (1,) m where positions alone are measured. Raises RigError for what is no arm
    """
    whole = machine.run(true, commands, t, effects, sensors).T_base_platform
    arm, k = true.mechanism, 3 * len(sigma)
    if not isinstance(arm, Arm):
        raise RigError(f"this takes an arm, not a mechanism of kind {arm.kind!r}")
    q = machine.motion(true, commands, t, effects, sensors).lengths
    free = parameters(arm, "pose" if k == 6 else "position")
    J = model.parameter_jacobian(q, arm)[:, :k][..., free] / np.repeat(sigma, 3)[:, None]
    Q = np.linalg.qr(J.reshape(len(t) * k, -1))[0]
    out = []
    for i in range(len(effects)):
        bare = machine.run(true, commands, t, [e for j, e in enumerate(effects) if j != i], sensors).T_base_platform
        moved = (difference(bare, whole)[:, :k] / np.repeat(sigma, 3)).ravel()
        out.append(float(np.linalg.norm(moved - Q @ (Q.T @ moved))))
    return np.array(out)
