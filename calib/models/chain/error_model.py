"""The error model of a chain: what every stage's own parameters do to the pose of the last platform.

Parameters stand in one vector, stage after stage, as changes from the owner's figures: of a hexapod its 42, of two
struts their 6, of an arm base, rows and tool in the order of calib.models.arm.error_model. tangent = sum over stages of
Ad(T_k+1 .. T_n)^-1 J_k dp_k.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.arm import error_model as arms
from calib.models.arm.identification import parameters as independent
from calib.models.arm.parameter_rank import PLAUSIBLE
from calib.models.platform.identification import NAMES, PRIOR, parameters, pose_jacobian, with_parameters
from calib.models.platform.parameter_observability import base_motion_columns
from rig.model.design import Arm, Chain
from rig.model.mechanism_geometry import Stage
from rig.model.mechanisms import chain as mechanism


def names(chain: Chain) -> tuple[str, ...]:
    """Names of the parameters, in order: "stage 1 base x" .., "stage 2 base joint 1 x" .."""
    return tuple(f"stage {k + 1} {name}" for k, stage in enumerate(chain.stages) for name in _names(stage))


def _names(stage: Stage) -> tuple[str, ...]:
    return arms.names(stage) if isinstance(stage, Arm) else NAMES[stage.kind]


def units(chain: Chain) -> tuple[str, ...]:
    """Unit of each parameter, "m" or "rad"."""
    return tuple(
        unit
        for stage in chain.stages
        for unit in (arms.units(stage) if isinstance(stage, Arm) else ("m",) * len(_names(stage)))
    )


def prior(chain: Chain) -> np.ndarray:
    """(p,) m and rad, what each figure of an owner may be off by; 0 for those that are no freedom of their own
    (Hayati).
    """
    out = []
    for stage in chain.stages:
        if isinstance(stage, Arm):
            out.append(np.array([PLAUSIBLE[unit] for unit in arms.units(stage)]) * independent(stage, "pose"))
        else:
            out.append(np.full(len(_names(stage)), PRIOR))
    return np.concatenate(out)


def parts(chain: Chain) -> list[slice]:
    """The slice of each stage's parameters."""
    sizes = [len(_names(stage)) for stage in chain.stages]
    ends = np.cumsum(sizes)
    return [slice(int(end - size), int(end)) for size, end in zip(sizes, ends)]


def moved(chain: Chain, step: np.ndarray) -> Chain:
    """The Chain with its parameters moved by step (p,) m and rad."""
    return replace(chain, stages=tuple(_moved(stage, step[part]) for stage, part in zip(chain.stages, parts(chain))))


def _moved(stage: Stage, step: np.ndarray) -> Stage:
    return arms.moved(stage, step) if isinstance(stage, Arm) else with_parameters(stage, parameters(stage) + step)


def base_motions(stage: Stage) -> np.ndarray:
    """(p, 6 or 3) change of a stage's parameters with its own base frame: x y z rx ry rz, m and rad; of two struts x, y
    and rz alone.
    """
    return np.eye(len(_names(stage)), 6) if isinstance(stage, Arm) else base_motion_columns(stage)


def parameter_jacobian(values: np.ndarray, chain: Chain, upto: int | None = None) -> np.ndarray:
    """(n, 6, p) change of the last platform's pose (tangent on the right, m and rad) with the parameters, at values (n,
    axes) m or rad.

    upto : number (from 1) of the stage whose platform is meant in the place of the last; what is above it does not move
        it
    """
    poses = mechanism.stage_transforms(values, chain)[:upto]
    own = np.concatenate(
        [
            back @ _own(own, T, stage)
            for (stage, own), T, back in zip(mechanism.stages(values, chain), poses, mechanism.tangent_maps(poses))
        ],
        axis=-1,
    )
    return np.pad(own, ((0, 0), (0, 0), (0, len(names(chain)) - own.shape[-1])))


def _own(values: np.ndarray, T: RigidTransform, stage: Stage) -> np.ndarray:
    return arms.parameter_jacobian(values, stage) if isinstance(stage, Arm) else pose_jacobian(T, stage)
