"""What changes of the machine do to its poses: a worn nut, another temperature, another load, as columns of a linear
model.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify.calibration import Calibration
from calib.models.platform.identification import inverse_strut_jacobian
from calib.samples.pose_samples import Samples
from rig.effects.catalogue.backlash import Backlash
from rig.effects.catalogue.compliance import Compliance
from rig.effects.catalogue.thermal_expansion import ThermalExpansion
from rig.effects.framework.effect import REFERENCE_TEMPERATURE, Effect
from rig.errors import RigError
from rig.model import motion_simulation
from rig.model.design import Design, Hexapod, Platform
from rig.recording.recording_folder import Commands, Sensors

GAP = 1e-4  # m, of a worn nut: unit of its columns, and the play at which they are taken
GROWTH = 1e-4  # share by which all struts grow: unit of its column; 9 K of steel
SOFT = 1e-5  # kg / (N/m), added load over a strut's stiffness: unit of its column; 10 kg on struts of 1e6 N/m
OWN = (*(f"nut of strut {i + 1}" for i in range(6)), "growth of all struts", "sag under added load")
UNITS = (*(GAP,) * 6, GROWTH, SOFT)
AT_ORIGIN = Platform(
    1.0, np.zeros(3), np.zeros(3)
)  # where nobody states the platform's: the added load then sits at its origin


def fitted_hexapod(calibration: Calibration) -> Hexapod:
    """The fitted hexapod. Raises RigError for a calibration of another mechanism."""
    fitted = calibration.correction.fitted
    if not isinstance(fitted, Hexapod):
        raise RigError(f"watching is for hexapods, not for a mechanism of kind {fitted.kind!r}")
    return fitted


def expected_poses(calibration: Calibration, samples: Samples) -> RigidTransform:
    """T_base_platform (n,) that the calibration gives for the commands of samples, physics that it knows included."""
    return calibration.correction.predict(samples.effective)


def machine_change_columns(
    mechanism: Hexapod, design: Design, commands: Commands, t: np.ndarray, T: RigidTransform
) -> np.ndarray:
    """(n, 6, 8) tangents (m, rad, on the right) of poses T (n,) per unit of OWN, at exposures t (n,) s under
    commands.
    """
    stated = (
        design.platform
        if design.platform.payload_centre_of_mass is not None and design.platform.mass is not None
        else AT_ORIGIN
    )
    there = Design("", design.gravity, mechanism, None, design.actuator, stated, (), ())
    warm = {f"strut{i + 1}_temperature_C": np.full(2, REFERENCE_TEMPERATURE + 1) for i in range(6)}
    ends = np.array([commands.t[0], commands.t[-1] + 1.0])

    def lengthened(effect: Effect, **channels: np.ndarray) -> np.ndarray:
        return motion_simulation.effective_commands(
            there, commands, t, T, (effect,), Sensors(ends, channels)
        ) - commands.at(t)

    yields = Compliance("rig", stiffness=1 / SOFT)
    out = [lengthened(Backlash(f"strut {i + 1}", gap=GAP)) for i in range(6)]
    out.append(lengthened(ThermalExpansion("rig", coefficient=GROWTH), **warm))
    out.append(lengthened(yields, payload_mass_kg=np.ones(2)) - lengthened(yields))
    return inverse_strut_jacobian(T, mechanism) @ np.stack(out, axis=-1)
