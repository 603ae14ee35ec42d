"""What a recording has to ask of: the machine, its exposures, what was logged and what was seen."""

from dataclasses import dataclass

import numpy as np

from rig.effects.framework.machine_motion import Motion
from rig.errors import RigError
from rig.model.design import Design
from rig.recording.recording_folder import Sensors


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """design : Design as its owner states it; t : (n,) s, the exposures; sensors : Sensors or None
    motion : Motion at the measured poses, no effects; None where nothing was commanded
    cameras : names of those that saw something; moving : of those on a mount that moves; markers : ids seen;
        targets : names seen
    """

    design: Design
    t: np.ndarray
    sensors: Sensors | None
    motion: Motion | None
    cameras: tuple[str, ...] = ()
    moving: tuple[str, ...] = ()
    markers: tuple[int, ...] = ()
    targets: tuple[str, ...] = ()

    def moved(self) -> Motion:
        """The Motion. Raises RigError where nothing was commanded."""
        if self.motion is None:
            raise RigError("nothing was commanded")
        return self.motion

    def logged(self, *names: str) -> bool:
        """Whether any of these sensor channels was logged."""
        return self.sensors is not None and bool(set(names) & set(self.sensors.channels))
