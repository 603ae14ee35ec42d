"""Tilt of a machine's base by a sensor channel, and gravity in the base's frame as it turns with such tilts."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Floats

GRAVITY = ("gravity_x_m_s2", "gravity_y_m_s2", "gravity_z_m_s2")  # channels of gravity in the base frame
LARGEST_TURN = np.radians(1.0)  # of a tilting base between two rows, of which gravity is interpolated
ANGLE_UNITS = {"_deg": np.pi / 180, "_rad": 1.0}  # by the end of a channel's name


@dataclass(frozen=True, slots=True, eq=False)
class BaseTilt:
    """The base turns about an axis by an angle that is logged: a telescope's elevation, a tilting table, a rotator.

    channel : of sensors.csv, ending in _deg or _rad; axis : (3,) unit vector in the base frame, about which the base
        turns right-handed as the channel grows; zero : rad, where gravity is as stated
    """

    channel: str
    axis: Floats
    zero: float = 0.0

    def angle(self, values: Floats) -> Floats:
        """(n,) rad from where gravity is as stated, at values (n,) of the channel."""
        return values * next(size for end, size in ANGLE_UNITS.items() if self.channel.endswith(end)) - self.zero

    def turn(self, values: Floats) -> Rotation:
        """Rotations (n,) of the base from where gravity is as stated, at values (n,) of the channel."""
        return Rotation.from_rotvec(self.angle(values)[:, None] * self.axis)


def has_gravity(channels: Collection[str]) -> bool:
    """Whether gravity in the base frame is among the names of sensor channels."""
    return set(GRAVITY) <= set(channels)


def logged_gravity(channel: Callable[[str], Floats]) -> Floats:
    """(n, 3) m/s^2 of gravity in the base frame. channel : name -> (n,) values"""
    return np.stack([channel(name) for name in GRAVITY], axis=1)


def times_between_small_turns(t: Floats, tilts: tuple[BaseTilt, ...], channels: Mapping[str, Floats]) -> Floats:
    """Times (m,) s of a log's rows and of as many between as make no tilt turn by more than LARGEST_TURN at once.

    t : (n,) s; channels : {name: (n,) values}, linear between rows
    """
    turns = np.max([np.abs(np.diff(tilt.angle(channels[tilt.channel]))) for tilt in tilts], axis=0)
    parts = np.maximum(np.ceil(turns / LARGEST_TURN), 1).astype(int)
    shares = np.concatenate([np.arange(count) / count for count in parts] or [np.zeros(0)])
    return np.r_[np.repeat(t[:-1], parts) + shares * np.repeat(np.diff(t), parts), t[-1:]]


def gravity_channels(
    gravity: Floats, tilts: tuple[BaseTilt, ...], channel: Callable[[str], Floats]
) -> dict[str, Floats]:
    """{channel: (n,) m/s^2} of gravity in the base frame under tilts, each carried by those before it.

    gravity : (3,) m/s^2 where all stand at zero; channel : name -> (n,) values
    """
    turned = Rotation.identity()
    for tilt in tilts:
        turned = turned * tilt.turn(channel(tilt.channel))
    return dict(zip(GRAVITY, turned.inv().apply(np.array(gravity)).T))
