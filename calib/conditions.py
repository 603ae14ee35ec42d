"""What varied besides the configuration while poses were measured: direction of approach, time, temperatures, load."""

from dataclasses import dataclass

import numpy as np

from rig.recording import PAYLOAD, Commands, Recording


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """Of n samples. direction : (n, axes) sign of each axis' last move before the exposure, 0 where it never moved

    t : (n,) s; channels : {name: (n,)} temperatures (degrees Celsius) and payload (kg) logged at the exposures
    """

    direction: np.ndarray
    t: np.ndarray
    channels: dict[str, np.ndarray]

    def take(self, index: np.ndarray | slice) -> "Conditions":
        """The conditions of an index or mask (n,)."""
        return Conditions(self.direction[index], self.t[index], {name: values[index] for name, values in self.channels.items()})


def conditions(recording: Recording, t: np.ndarray) -> Conditions:
    """Conditions of a recording's exposures at times t (n,) s. Raises RigError without commands."""
    recording.commanded()
    assert recording.commands is not None
    sensors = recording.sensors
    names = [] if sensors is None else [name for name in sensors.channels if name.endswith("temperature_C") or name == PAYLOAD]
    channels = {} if sensors is None else {name: sensors.at(t, name) for name in names}
    return Conditions(approach_direction(recording.commands, t), t, channels)


def approach_direction(commands: Commands, t: np.ndarray) -> np.ndarray:
    """(n, axes) sign of each axis' last commanded move before times t (n,) s; 0 where it had not moved since its recording began."""
    moved = np.sign(np.diff(commands.values, axis=0))
    begin = np.isin(commands.t[1:], commands.starts)  # the step from one recording to the next is no move
    latest = np.zeros((len(moved) + 1, commands.values.shape[1]))
    for k, step in enumerate(moved):
        latest[k + 1] = 0.0 if begin[k] else np.where(step != 0, step, latest[k])
    return latest[np.clip(np.searchsorted(commands.t, t, side="left"), 0, len(moved))]
