"""Tilt of a machine's base by a sensor channel, and gravity in the base's frame as it turns with such tilts."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Floats

GRAVITY = ("gravity_x_m_s2", "gravity_y_m_s2", "gravity_z_m_s2")  # channels of gravity in the base frame
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

    def turn(self, values: Floats) -> Rotation:
        """Rotations (n,) of the base from where gravity is as stated, at values (n,) of the channel."""
        scale = next(size for end, size in ANGLE_UNITS.items() if self.channel.endswith(end))
        return Rotation.from_rotvec((values * scale - self.zero)[:, None] * self.axis)


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
