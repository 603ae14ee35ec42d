"""Conditions of exposures.

They are the direction of approach, logged channels and what the axes carry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.base_and_link_tilt_sensors import has_gravity_sensor_channels
from rig.recording.recording_folder import PAYLOAD, Commands, Recording


@dataclass(frozen=True, slots=True, eq=False)
class Weight:
    """What axes carry, as far as rig.toml states it. gravity : (3,) m/s^2 in the base frame; mass : kg, of the
    platform, centre : (3,) m, of it, and
    payload : (3,) m, of what it carries, in the platform's frame. A mass that is not stated counts as 1 kg alone, a
        centre as the origin."""

    gravity: Floats
    mass: float | None
    centre: Floats | None
    payload: Floats | None

    def wrench(self, T_base_platform: RigidTransform, carried: Floats) -> Floats:
        """(n, 6) N, N m in the platform's frame at poses (n,) with payloads carried (n,) kg."""
        down = np.swapaxes(T_base_platform.rotation.as_matrix(), 1, 2) @ self.gravity
        own, more = (1.0, np.zeros_like(carried)) if self.mass is None else (self.mass, carried)
        out = np.zeros((len(down), 6))
        for force, centre in ((own * down, self.centre), (more[:, None] * down, self.payload)):
            out += np.concatenate([force, np.zeros_like(force) if centre is None else np.cross(centre, force)], axis=1)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """Of n samples. direction : (n, axes) sign of each axis' last move before the exposure, 0 where it never moved

    t : (n,) s; channels : {name: (n,)} temperatures (degrees Celsius) and payload (kg) logged at the exposures
    weight : Weight, None where there is no gravity, or where it turns: loads then follow no configuration
    """

    direction: Floats
    t: Floats
    channels: dict[str, Floats]
    weight: Weight | None = None

    def take(self, index: Booleans | Integers | slice) -> Conditions:
        """The conditions of an index or mask (n,)."""
        return Conditions(
            self.direction[index],
            self.t[index],
            {name: values[index] for name, values in self.channels.items()},
            self.weight,
        )


def conditions_of_exposures(recording: Recording, t: Floats) -> Conditions:
    """Conditions of a recording's exposures at times t (n,) s.

    Raises RigError without commands.
    """
    recording.commanded()
    assert recording.commands is not None
    sensors = recording.sensors
    names = (
        []
        if sensors is None
        else [name for name in sensors.channels if name.endswith("temperature_C") or name == PAYLOAD]
    )
    channels = {} if sensors is None else {name: sensors.at(t, name) for name in names}
    design = recording.design
    weight = Weight(
        design.gravity, design.platform.mass, design.platform.centre_of_mass, design.platform.payload_centre_of_mass
    )
    stands = design.gravity.any() and (sensors is None or not has_gravity_sensor_channels(sensors.channels))
    return Conditions(approach_direction(recording.commands, t), t, channels, weight if stands else None)


def approach_direction(commands: Commands, t: Floats) -> Floats:
    """Direction of approach (n, axes) before times t (n,) s.

    It is the sign of each axis' last move, 0 for none.
    """
    moved = np.sign(np.diff(commands.values, axis=0))
    begin = np.isin(commands.t[1:], commands.starts)  # the step from one recording to the next is no move
    latest = np.zeros((len(moved) + 1, commands.values.shape[1]))
    for k, step in enumerate(moved):
        latest[k + 1] = 0.0 if begin[k] else np.where(step != 0, step, latest[k])
    return latest[np.clip(np.searchsorted(commands.t, t, side="left"), 0, len(moved))]
