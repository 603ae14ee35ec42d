"""Which moves of a machine tell two effects apart: what each does to its measured poses, less what its geometry, an
arm's base and hand among it, can swallow."""

import numpy as np

from calib.diagnosis.engine.hypothesis_separation import Separation, _signal_separation
from calib.models.geometric_parameters import geometric_parameters
from rig.arrays import Floats
from rig.effects.framework.effect import Effect
from rig.model import motion_simulation
from rig.model.design import Design
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Commands, Sensors


def arm_effect_separation(
    plan_name: str,
    design: Design,
    commands: Commands,
    t: Floats,
    sensors: Sensors | None,
    effects: list[Effect],
    sigma: tuple[float, float],
) -> Separation:
    """Separation of two effects on an arm by one plan, each effect as large as expected.

    commands : Commands; t : (n,) s exposures; sensors : Sensors; effects : two Effects that move axes or platform
    sigma : (m, rad) standard deviation of a measured pose per axis. Raises RigError for what nobody commands, and what
        the machine raises
    """
    asked = geometric_parameters(design.mechanism)
    white = 1 / np.repeat(sigma, 3)
    still = motion_simulation.run_machine(design, commands, t, (), sensors).T_base_platform
    a, b = (
        (
            pose_difference(
                still, motion_simulation.run_machine(design, commands, t, (effect,), sensors).T_base_platform
            )
            * white
        ).ravel()
        for effect in effects
    )
    rows = asked.jacobian(commands.at(t)) * white[:, None]
    return _signal_separation(plan_name, len(t), (a, b), rows.reshape(-1, rows.shape[-1]), asked.size)
