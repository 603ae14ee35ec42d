"""Which moves of an arm tell two effects apart: what each does to its measured poses, less what geometry, base and hand can swallow."""

import numpy as np

from calib.arms import model
from calib.arms.identify import parameters
from calib.arms.rank import PLAUSIBLE
from calib.diagnose.engine.separation import Separation, separated
from rig import machine
from rig.design import Design
from rig.effects.base import Effect
from rig.kinds import arm_of
from rig.pose import difference
from rig.recording import Commands, Sensors


def separation(text: str, design: Design, commands: Commands, t: np.ndarray, sensors: Sensors | None, effects: list[Effect],
               sigma: tuple[float, float]) -> Separation:
    """Separation of two effects (each as large as it is expected to be) by one plan.

    commands : Commands; t : (n,) s exposures; sensors : Sensors; effects : two Effects that move joints or hand
    sigma : (m, rad) standard deviation of a measured pose per axis. Raises RigError for what is no arm, and what the machine raises
    """
    arm = arm_of(design.mechanism)
    white = 1 / np.repeat(sigma, 3)
    still = machine.run(design, commands, t, (), sensors).T_base_platform
    a, b = ((difference(still, machine.run(design, commands, t, (effect,), sensors).T_base_platform) * white).ravel() for effect in effects)
    free = parameters(arm, "pose")
    freedoms = model.parameter_jacobian(commands.at(t), arm)[..., free] * white[:, None]
    prior = np.array([PLAUSIBLE[unit] for unit in model.units(arm)])[free]
    return separated(text, len(t), (a, b), freedoms.reshape(-1, freedoms.shape[-1]), prior)
