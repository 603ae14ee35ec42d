"""How strong an effect is in an arm's recording: its signal-to-noise once calibration has taken what it can, all of the
truth being known.
"""

import numpy as np

from calib.models.arm import error_model
from calib.models.arm.identification import independent_arm_parameters
from rig.arrays import Floats
from rig.effects.framework.effect import Effect
from rig.errors import RigError
from rig.model import motion_simulation
from rig.model.design import Design
from rig.model.mechanism_geometry import Arm
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Commands, Sensors


def arm_effect_signal_to_noise(
    true_design: Design, commands: Commands, t: Floats, sigma: Floats, effects: tuple[Effect, ...], sensors: Sensors
) -> Floats:
    """(effects,) signal-to-noise of each effect in an arm's poses, the arm's parameters projected out.

    true_design : Design as it really is; commands, t (n,) s : what was commanded, and when it was measured; sensors :
        as they truly were
    sigma : (2,) m and rad, or (1,) m where positions alone are measured. Raises RigError for what is no arm
    """
    whole = motion_simulation.run_machine(true_design, commands, t, effects, sensors).T_base_platform
    arm, k = true_design.mechanism, 3 * len(sigma)
    if not isinstance(arm, Arm):
        raise RigError(f"this takes an arm, not a mechanism of kind {arm.kind!r}")
    q = motion_simulation.motion_of_commands(true_design, commands, t, effects, sensors).lengths
    free = independent_arm_parameters(arm, "pose" if k == 6 else "position")
    J = error_model.parameter_jacobian(q, arm)[:, :k][..., free] / np.repeat(sigma, 3)[:, None]
    Q = np.linalg.qr(J.reshape(len(t) * k, -1))[0]
    out = []
    for i in range(len(effects)):
        bare = motion_simulation.run_machine(
            true_design, commands, t, [e for j, e in enumerate(effects) if j != i], sensors
        ).T_base_platform
        moved = (pose_difference(bare, whole)[:, :k] / np.repeat(sigma, 3)).ravel()
        out.append(float(np.linalg.norm(moved - Q @ (Q.T @ moved))))
    return np.array(out)
