"""An arm's poses as measured, linear about its calibrated geometry: what that leaves, and how it changes with joints and freedoms."""

from dataclasses import dataclass, replace

import numpy as np

from calib.arms.certify import calibrate
from calib.arms.identify import Identified
from calib.arms.observations import of_samples
from calib.samples import Samples
from rig import machine
from rig.design import Arm, Design
from rig.effects.base import Context, Effect
from rig.errors import NotEnoughData, RigError
from rig.recording import Commands, Sensors

FEWEST = 60  # poses


@dataclass(frozen=True, slots=True, eq=False)
class Arms:
    """What is known of n poses of an arm. frame : (n,); t : (n,) s; q : (n, joints) rad, commanded; left : (n, k) m and rad, what
    the geometry left (k = 6, or 3 for positions); freedoms : (n, k, p) change with calibration's parameters; joints : (n, k, joints)
    with the angles; own : (n, k, k) the instrument's covariance; commands : the whole path; context : what effects may look at"""

    frame: np.ndarray
    t: np.ndarray
    q: np.ndarray
    left: np.ndarray
    freedoms: np.ndarray
    joints: np.ndarray
    own: np.ndarray
    commands: Commands
    context: Context

    def __len__(self) -> int:
        return len(self.t)

    def directions(self, joint: int | None) -> np.ndarray:
        """(n, k, a) change of what is measured with a joint's angle (index, a = 1), or with the measured tangents themselves (None, a = k)."""
        return np.broadcast_to(np.eye(self.left.shape[1]), self.own.shape) if joint is None else self.joints[..., joint : joint + 1]

    def measured(self, tangents: np.ndarray) -> np.ndarray:
        """(n, k) what is measured of tangents (n, 6) by which the tool is displaced."""
        return tangents[:, : self.left.shape[1]]

    def reached(self, effect: Effect) -> np.ndarray:
        """(n, joints) rad, commands reached at the exposures under an effect of clock or path."""
        return machine.motion(self.context.design, self.commands, self.t, (effect,), self.context.sensors).lengths

    @property
    def channels(self) -> dict[str, np.ndarray]:
        """{sensor's channel: (n,)} at the exposures."""
        sensors = self.context.sensors
        return {} if sensors is None else {name: sensors.at(self.t, name) for name in sensors.channels}


def arms_of(samples: Samples, design: Design, commands: Commands | None = None, sensors: Sensors | None = None) -> tuple[Arms, Identified]:
    """(Arms, Identified) of Samples: calibrated, and linear about it.

    design : whose mechanism is the nominal Arm; commands : the whole path; the samples' own commands in their order where None
    Raises NotEnoughData for too few poses, RigError for what is no arm, and what calibrating raises
    """
    if len(samples) < FEWEST:
        raise NotEnoughData(f"{len(samples)} poses are too few to diagnose an arm; it takes {FEWEST}, better 500")
    if samples.measured in ("orientation", "distance"):
        raise RigError(f"an arm is diagnosed by its poses or positions; the {samples.measured} alone was measured")
    if not isinstance(design.mechanism, Arm):
        raise RigError(f"this takes an arm, not a mechanism of kind {design.mechanism.kind!r}")
    _, found = calibrate(samples, design.mechanism, design.instrument, profiles=False)
    observations = of_samples(samples)
    freedoms = np.concatenate([observations.jacobian(found.arm)[..., found.free], observations.common], axis=2)
    commands = Commands(samples.t, samples.commanded) if commands is None else commands
    design = replace(design, mechanism=found.arm)
    motion = replace(machine.motion(design, commands, samples.t, (), sensors), T=samples.T_base_platform)
    context = Context(design, samples.t, sensors, motion)
    return Arms(samples.frame, samples.t, samples.commanded, observations.residuals(found.arm), freedoms, observations.joint_jacobian(found.arm),
                observations.covariance, commands, context), found
