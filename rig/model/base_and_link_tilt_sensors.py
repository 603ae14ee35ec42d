"""Tilts of a machine's base and links, measured by sensors.

By a sensor channel, gravity in the base's frame as it turns; sensors are on links.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import RigError

GRAVITY = ("gravity_x_m_s2", "gravity_y_m_s2", "gravity_z_m_s2")  # channels of gravity in the base frame
LARGEST_TURN = np.radians(1.0)  # of a tilting base between two rows, of which gravity is interpolated
ANGLE_UNITS = {"_deg": np.pi / 180, "_rad": 1.0}  # by the end of a channel's name
GRAVITY_SIGMA = 0.02  # rad, to which gravity's direction in the frame of poses is known
STEEPEST = np.radians(70)  # of a sensor's angle that is used: near 90 degrees it says little, and its zero counts much
SENSOR_AXES = ("x", "y")  # of a tilt sensor, whose angles it shows


@dataclass(frozen=True, slots=True, eq=False)
class TiltSensor:
    """A tilt sensor, which shows how far its x and y axes point above the horizontal, rad.

    name : of its channels in sensors.csv, tilt_NAME_x_rad and tilt_NAME_y_rad, or both in _deg; link : of an arm, by
        the joint that moves it, 0 for the base; 1 for the platform of other machines; sigma : rad, noise of each angle
    mount : (3,) rad, the sensor's axes in the link's frame, as rotation vector; mount_sigma : rad, standard deviation
        to which mount and the zeros of both angles are known
    """

    name: str
    link: int
    sigma: float
    mount: Floats
    mount_sigma: float = 0.02

    @property
    def place(self) -> str:
        """Where it sits, in words."""
        return f"link {self.link}" if self.link else "the base"

    def channels(self, known: Collection[str]) -> tuple[str, str] | None:
        """Names of its two channels among the names of those known, or None.

        Raises RigError where one of the two is missing
        """
        for unit in ANGLE_UNITS:
            x, y = (f"tilt_{self.name}_{axis}{unit}" for axis in SENSOR_AXES)
            if x in known and y in known:
                return x, y
            if x in known or y in known:
                raise RigError(
                    f"sensors.csv has one of {x} and {y}: the angles of tilt sensor {self.name!r} belong together"
                )
        return None

    def angles(self, known: Collection[str], channel: Callable[[str], Floats]) -> Floats | None:
        """Both angles (n, 2) rad, or None where they were not logged. known : names of channels; channel : name ->
        (n,) values
        """
        names = self.channels(known)
        if names is None:
            return None
        return np.stack([channel(name) * ANGLE_UNITS[name[-4:]] for name in names], axis=1)

    def shown(self, R_link: Floats, down: Floats) -> Floats:
        """Angles (n, 2) rad that it shows at orientations (n, 3, 3) of its link under gravity along unit vectors
        (n, 3).
        """
        axes = R_link @ Rotation.from_rotvec(self.mount).as_matrix()[:, :2]
        return np.arcsin(np.clip(-np.einsum("nia,ni->na", axes, down), -1, 1))


@dataclass(frozen=True, slots=True, eq=False)
class TiltReadings:
    """What tilt sensors on a machine showed in n configurations.

    sensors : TiltSensor, s of them; angles : (n, s, 2) rad; down : (n, 3) unit vectors of gravity in the frame of
        poses, turned back by what the base is known to have leaned
    """

    sensors: tuple[TiltSensor, ...]
    angles: Floats
    down: Floats

    @property
    def usable(self) -> Booleans:
        """(n, s) whether both angles of a reading are below STEEPEST."""
        return np.asarray((np.abs(self.angles) < STEEPEST).all(axis=2))

    @property
    def mounting_sigma(self) -> Floats:
        """(3 + 3 s,) rad, to which gravity's direction in the frame of poses and each sensor's mounting are known."""
        return np.concatenate([np.full(3, GRAVITY_SIGMA), *(np.full(3, one.mount_sigma) for one in self.sensors)])

    def take(self, index: Booleans | Integers | slice) -> "TiltReadings":
        """The readings of an index or mask (n,)."""
        return TiltReadings(self.sensors, self.angles[index], self.down[index])

    def with_lean(self, lean: Floats) -> "TiltReadings":
        """The readings where the base is known to have leaned by rotation vectors (n, 3) rad, frame of poses."""
        return replace(self, down=Rotation.from_rotvec(-lean).apply(np.array(self.down))) if lean.any() else self


def tilt_residuals_and_jacobians(
    readings: TiltReadings, links: Floats, mounting: Floats
) -> tuple[Floats, Floats, Floats]:
    """Residuals of tilt readings, and their Jacobians.

    links : (n, s, 3, 3) orientations of the sensors' links in the frame of poses; mounting : (3 + 3 s,) rad, small
        turns of gravity in that frame, then of each sensor about its own axes
    Returns (residuals (n, s, 2) rad, read less predicted; turns (n, s, 2, 3), change of the angles with a link's turn
    about the axes of the frame of poses; mounting columns (n, s, 2, 3 + 3 s))
    """
    s = len(readings.sensors)
    stated = Rotation.from_rotvec([sensor.mount for sensor in readings.sensors]).as_matrix()
    down = Rotation.from_rotvec(mounting[:3]).apply(readings.down)
    axes = links @ stated @ Rotation.from_rotvec(mounting[3:].reshape(s, 3)).as_matrix()
    sines = -np.einsum("nsia,ni->nsa", axes[..., :2], down)
    residuals = readings.angles - np.arcsin(np.clip(sines, -1, 1))
    cosines = np.sqrt(np.maximum(1 - sines**2, np.cos(STEEPEST) ** 4))
    two = np.swapaxes(axes, 2, 3)[:, :, :2]  # (n, s, axis of the sensor, 3)
    turns = -np.cross(two, down[:, None, None]) / cosines[..., None]
    columns = np.zeros((*residuals.shape, len(mounting)))
    columns[..., :3] = -turns
    for k in range(s):
        columns[:, k, :, 3 + 3 * k : 6 + 3 * k] = turns[:, k] @ axes[:, k]
    return residuals, turns, columns


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


def has_gravity_sensor_channels(channels: Collection[str]) -> bool:
    """Whether sensor channels include those of gravity.

    In the base frame.
    """
    return set(GRAVITY) <= set(channels)


def logged_gravity(channel_values: Callable[[str], Floats]) -> Floats:
    """Logged gravity (n, 3) m/s^2 in the base frame.

    channel_values : name -> (n,) values
    """
    return np.stack([channel_values(name) for name in GRAVITY], axis=1)


def gravity_at_exposures(
    gravity: Floats, known_channels: Collection[str], channel_values: Callable[[str], Floats], count: int
) -> Floats:
    """Gravity (count, 3) m/s^2 at exposures, in the base frame.

    As logged where the base tilts, else as stated, gravity (3,).
    known_channels : names of the sensor channels; channel_values : name -> (count,) values
    """
    return (
        logged_gravity(channel_values)
        if has_gravity_sensor_channels(known_channels)
        else np.broadcast_to(gravity, (count, 3))
    )


def log_times_refined_for_tilt_steps(t: Floats, tilts: tuple[BaseTilt, ...], channels: Mapping[str, Floats]) -> Floats:
    """Log times (m,) s, with more inserted so that tilt steps are small.

    No tilt turns by more than LARGEST_TURN from one to the next.
    t : (n,) s; channels : {name: (n,) values}, linear between rows
    """
    turns = np.max([np.abs(np.diff(tilt.angle(channels[tilt.channel]))) for tilt in tilts], axis=0)
    parts = np.maximum(np.ceil(turns / LARGEST_TURN), 1).astype(int)
    shares = np.concatenate([np.arange(count) / count for count in parts] or [np.zeros(0)])
    return np.r_[np.repeat(t[:-1], parts) + shares * np.repeat(np.diff(t), parts), t[-1:]]


def base_gravity_channels_under_tilts(
    gravity: Floats, tilts: tuple[BaseTilt, ...], channel_values: Callable[[str], Floats]
) -> dict[str, Floats]:
    """Channels of gravity in the base frame under tilts.

    gravity : (3,) m/s^2 where all stand at zero; channel_values : name -> (n,) values
    Returns {channel: (n,) m/s^2}, each tilt carried by those before it
    """
    turned = Rotation.identity()
    for tilt in tilts:
        turned = turned * tilt.turn(channel_values(tilt.channel))
    return dict(zip(GRAVITY, turned.inv().apply(np.array(gravity)).T))
