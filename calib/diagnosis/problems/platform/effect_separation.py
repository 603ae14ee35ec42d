"""Which moves tell two effects apart: what each does to the struts in each part of a plan, less what the geometry can
swallow.
"""

import numpy as np

from calib.diagnosis.engine.hypothesis_separation import Separation, _signal_separation
from calib.models.platform.identification import PRIOR, loop_closure_jacobian
from rig.arrays import Floats
from rig.effects.framework.effect import Effect
from rig.errors import RigError
from rig.model import motion_simulation
from rig.model.design import Design
from rig.model.mechanism_geometry import Hexapod
from rig.model.mechanisms import hexapod
from rig.recording.recording_folder import Commands, Sensors


def platform_effect_separation(
    plan_name: str,
    design: Design,
    commands: Commands,
    t: Floats,
    sensors: Sensors | None,
    effects: list[Effect],
    sigma: tuple[float, float],
) -> Separation:
    """Separation of two effects on a platform by one plan, each effect as large as expected.

    commands : Commands; t : (n,) s exposures; sensors : Sensors; effects : two Effects that move the platform
    sigma : (m, rad) standard deviation of a measured pose per axis. Raises RigError for what is no hexapod, and what
        the machine raises
    """
    still = motion_simulation.run_machine(design, commands, t, (), sensors)
    m = design.mechanism
    if not isinstance(m, Hexapod):
        raise RigError(f"plans are told apart for a hexapod, not for a mechanism of kind {m.kind!r}")
    parts = []
    covariance = np.diag(np.r_[[sigma[0] ** 2] * 3, [sigma[1] ** 2] * 3])
    A = hexapod.jacobian(still.T_base_platform, m)
    W = np.linalg.inv(np.linalg.cholesky(A @ covariance @ np.swapaxes(A, 1, 2)))
    for effect in effects:
        moved = motion_simulation.run_machine(design, commands, t, (effect,), sensors).T_base_platform
        parts.append((W @ (hexapod.inverse(moved, m) - hexapod.inverse(still.T_base_platform, m))[..., None]).ravel())
    D = (W @ loop_closure_jacobian(still.T_base_platform, m)).reshape(-1, 42)
    return _signal_separation(plan_name, len(t), (parts[0], parts[1]), D, np.full(42, PRIOR))
