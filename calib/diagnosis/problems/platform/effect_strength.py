"""How strong an effect is in a recording: its signal-to-noise once calibration has taken what it can, all of the truth
being known.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from calib.diagnosis.problems.platform.linearised_residuals import linearise
from calib.diagnosis.problems.platform.operating_point import OperatingPoint, group_sightings
from rig.arrays import Floats
from rig.effects.framework.effect import Effect
from rig.errors import RigError
from rig.model import motion_simulation
from rig.model.design import Design
from rig.recording.recording_folder import Recording, Sensors
from vision.corner_observations import observations_from_corners
from vision.targets import marker_map


def platform_effect_signal_to_noise(
    recording: Recording, true_design: Design, noise: float, effects: tuple[Effect, ...], sensors: Sensors
) -> Floats:
    """(effects,) signal-to-noise of each effect in a platform's corners, cameras and geometry projected out.

    recording : Recording with corners; true_design : Design as it really is; noise : px, standard deviation of a corner
    effects : all that are at work, of the catalogue or not; sensors : Sensors as they truly were
    Raises RigError where corners or commands are missing
    """
    frames, t = recording.exposures.times()
    if recording.corners is None or recording.commands is None:
        raise RigError(f"{recording.folder}: this takes corners and commands")
    commands = recording.commands
    stated = recording.design
    observations = observations_from_corners(recording.corners, frames, stated, marker_map(stated))
    observations = replace(observations, covariance=np.broadcast_to(noise**2 * np.eye(2), (len(observations), 2, 2)))

    def world(acting: Iterable[Effect]) -> OperatingPoint:
        T = motion_simulation.run_machine(
            true_design, commands, t, [e for e in acting if e.stage != "view"], sensors
        ).T_base_platform
        point = OperatingPoint(true_design, stated, frames, t, T, {}, None, commands, sensors, None, tuple(acting))
        return replace(point, seen=group_sightings(observations, marker_map(stated)))

    out = []
    for effect in effects:
        acting = [
            e for e in effects if e is effect or not e.discrete
        ]  # faces exchanged are put right before anything else is looked at
        whole, bare = world(acting), world([e for e in acting if e is not effect])
        model = linearise(whole)
        square = model.linear.project(model.fold((whole.pixels() - bare.pixels())[..., None])).gram
        out.append(float(np.sqrt(max(square[0, 0], 0.0))))
    return np.array(out)
