"""What calibration may move of a machine of any kind: its parameters, what each may be off by, and what they do to the
measured pose.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.models.arm import error_model, identification
from calib.models.arm.independent_parameters import PLAUSIBLE
from calib.models.chain import error_model as chains
from calib.models.platform.identification import NAMES, PRIOR, pose_parameter_jacobian
from rig.arrays import Booleans, Floats
from rig.model import mechanisms
from rig.model.mechanism_geometry import Arm, Chain, Hexapod, Planar2
from rig.model.mechanism_kinds import Mechanism, require_struts


@dataclass(frozen=True, slots=True, eq=False)
class Freedoms:
    """names, units : of p parameters, "m" or "rad"; size : (p,) what each may be off by; jacobian : values (n, axes) m
    or rad -> (n, 6, p) change of the pose's tangent on the right; alike : whether some combinations of them no pose
    tells, so that only `size` holds them"""

    names: tuple[str, ...]
    units: tuple[str, ...]
    size: Floats
    jacobian: Callable[[Floats], Floats]
    alike: bool


def geometric_parameters(mechanism: Mechanism) -> Freedoms:
    """Geometric parameters (Freedoms) of a mechanism. Raises RigError for what nobody commands."""
    if isinstance(mechanism, Arm):
        free = identification.independent_arm_parameters(mechanism, "pose")
        size = np.array([PLAUSIBLE[unit] for unit in error_model.parameter_units(mechanism)])
        return _asked(
            free,
            error_model.parameter_names(mechanism),
            error_model.parameter_units(mechanism),
            size,
            partial(error_model.parameter_jacobian, arm=mechanism),
        )
    if isinstance(mechanism, Chain):
        size = chains.parameter_tolerances(mechanism)
        found = _asked(
            size > 0,
            chains.parameter_names(mechanism),
            chains.parameter_units(mechanism),
            size,
            partial(chains.parameter_jacobian, chain=mechanism),
        )
        return Freedoms(found.names, found.units, found.size, found.jacobian, True)
    struts = require_struts(mechanism)
    names = NAMES[struts.kind]
    return Freedoms(names, ("m",) * len(names), np.full(len(names), PRIOR), partial(_of_struts, struts), False)


def _of_struts(struts: Hexapod | Planar2, values: Floats) -> Floats:
    return pose_parameter_jacobian(mechanisms.kinematics_of(struts).forward(values, struts), struts)


def _asked(
    free: Booleans, names: tuple[str, ...], units: tuple[str, ...], size: Floats, jacobian: Callable[[Floats], Floats]
) -> Freedoms:
    """Freedoms of those of the parameters that are free (p,) bool."""
    kept = np.flatnonzero(free).tolist()
    return Freedoms(
        tuple(names[k] for k in kept),
        tuple(units[k] for k in kept),
        size[kept],
        lambda values: jacobian(values)[..., kept],
        False,
    )
