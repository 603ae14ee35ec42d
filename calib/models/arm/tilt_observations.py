"""Tilt sensors on an arm as observations.

Their residuals and Jacobians, and how they are mounted as nuisances.

A sensor on link k shows by how much two of its axes point above the horizontal. It observes the base's turn and all
that joints 1 to k and their rows turn; what lies farther out it does not see. How each sensor is mounted (three small
turns, of which two are the zeros of its angles) and where gravity points in the frame of poses are known to stated
standard deviations; they are solved for with the rest and discarded.
"""

from dataclasses import dataclass

import numpy as np

from calib.identify.bounded_and_robust_least_squares_fit import excess_scatter
from rig.array_and_json_types import Booleans, Floats
from rig.model.base_and_link_tilt_sensors import TiltReadings, TiltSensor, tilt_residuals_and_jacobians
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism

ROUNDS = 5  # of solving for the mounting, whose turns are small
GATE = 6.0  # standard deviations beyond which a reading is left out


@dataclass(frozen=True, slots=True, eq=False)
class TiltWeights:
    """scatter : (s,) rad of each sensor beyond its own noise; used : (n, s) bool, readings that count."""

    scatter: Floats
    used: Booleans


@dataclass(frozen=True, slots=True, eq=False)
class TiltRows:
    """Readings of s sensors at n configurations q of an arm, linearised at their best mounting.

    residuals : (n, s, 2) rad, read less predicted; turns : (n, s, 2, 3) change of the angles with the link's turn, rad
        about the axes of the frame of poses; sensors : as of TiltReadings
    mounting : (3 + 3 s,) rad found, of gravity, then of each sensor about its own axes; mounting_sigma : the same,
        stated; mounting_columns : (n, s, 2, 3 + 3 s)
    """

    readings: TiltReadings
    residuals: Floats
    turns: Floats
    mounting: Floats
    mounting_sigma: Floats
    mounting_columns: Floats

    def weights(self, fitted_share: float) -> TiltWeights:
        """TiltWeights by these residuals. fitted_share : of their squares, what the fit took away"""
        n, s = self.residuals.shape[:2]
        scatter, used = np.zeros(s), np.zeros((n, s), bool)
        for k, sensor in enumerate(self.readings.sensors):
            usable, left = self.readings.usable[:, k], self.residuals[:, k]
            if not usable.any():
                continue
            own = np.broadcast_to(sensor.sigma**2 * np.eye(2), (int(usable.sum()), 2, 2))
            scatter[k] = excess_scatter(left[usable], own, min(fitted_share, 0.9))[0]
            sigma = np.hypot(sensor.sigma, scatter[k])
            scale = max(1.0, 1.4826 * float(np.median(np.abs(left[usable]) / sigma)))
            used[:, k] = usable & (np.abs(left) < GATE * scale * sigma).all(axis=1)
        return TiltWeights(scatter, used)

    def whitening(self, weights: TiltWeights) -> Floats:
        """(n, s) 1/rad, 0 where a reading does not count."""
        sigma = np.hypot([sensor.sigma for sensor in self.readings.sensors], weights.scatter)
        return weights.used / sigma

    def whitened_residuals(self, weights: TiltWeights) -> Floats:
        """(r,) whitened residuals of all angles, then what the mounting found lacks of that stated."""
        rows = (self.residuals * self.whitening(weights)[..., None]).ravel()
        return np.concatenate([rows, -self.mounting / self.mounting_sigma])

    def whitened_mounting(self, weights: TiltWeights) -> Floats:
        """(r, 3 + 3 s) whitened columns of the mounting."""
        rows = (self.mounting_columns * self.whitening(weights)[..., None, None]).reshape(-1, len(self.mounting))
        return np.concatenate([rows, np.diag(1 / self.mounting_sigma)])

    def whitened_columns(self, weights: TiltWeights, turned: Floats) -> Floats:
        """(r, c) whitened columns of what turns the sensors' links by (n, s, 3, c) rad per unit, frame of poses."""
        rows = (self.turns @ turned * self.whitening(weights)[..., None, None]).reshape(-1, turned.shape[3])
        return np.pad(rows, ((0, len(self.mounting)), (0, 0)))


def tilt_equation_rows(readings: TiltReadings, q: Floats, arm: Arm) -> TiltRows:
    """TiltRows of readings of an arm at joint values q (n, joints).

    They are at the mounting that explains the readings best.
    """
    sensors = readings.sensors
    links = mechanism.single_hand_arm_link_frames(q, arm)[:, [sensor.link for sensor in sensors], :3, :3]
    sigma = readings.mounting_sigma
    usable = readings.usable[..., None] / np.array([[s.sigma] for s in sensors])
    mounting = np.zeros(len(sigma))
    for _ in range(ROUNDS):
        residuals, turns, columns = tilt_residuals_and_jacobians(readings, links, mounting)
        A = np.concatenate([(columns * usable[..., None]).reshape(-1, len(sigma)), np.diag(1 / sigma)])
        y = np.concatenate([(residuals * usable).ravel(), -mounting / sigma])
        mounting = mounting + np.linalg.lstsq(A, y)[0]
    residuals, turns, columns = tilt_residuals_and_jacobians(readings, links, mounting)
    return TiltRows(readings, residuals, turns, mounting, sigma, columns)


def link_rotation_jacobian_by_parameters(readings: TiltReadings, q: Floats, arm: Arm, pose_jacobian: Floats) -> Floats:
    """Jacobian (n, s, 3, p) rad of the rotation of the sensors' links by an arm's parameters.

    About the axes of the frame of poses.
    pose_jacobian : (n, 6, p) of the target's pose with them: a link turns as the target does, by what lies before it
    """
    R = mechanism.forward(q, arm).rotation.as_matrix()
    whole = R @ pose_jacobian[:, 3:]
    number = np.arange(whole.shape[2])
    return np.stack([whole * (number < 6 + 5 * sensor.link) for sensor in readings.sensors], axis=1)


def link_rotation_jacobian_by_joints(readings: TiltReadings, q: Floats, arm: Arm) -> Floats:
    """Jacobian (n, s, 3, joints) of the rotation of the sensors' links by the joints.

    In rad per rad of each joint.
    """
    z = np.swapaxes(mechanism.single_hand_arm_link_frames(q, arm)[:, : len(arm.joints), :3, 2], 1, 2) * ~arm.slides
    by_command = arm.motion_by_command
    return np.stack([z * (np.arange(len(z[0, 0])) < one.link) @ by_command for one in readings.sensors], axis=1)


def planned_tilt_jacobian(
    sensors: tuple[TiltSensor, ...], gravity: Floats, q: Floats, arm: Arm, pose_jacobian: Floats
) -> Floats:
    """Jacobian of tilts at planned joint values with the arm's parameters and the sensors' mounting.

    Columns (n, 2 s, p + 3 + 3 s) at q (n, joints); 0 where an angle would not be used.
    gravity : (3,) in the frame of poses; pose_jacobian : (n, 6, p) of the target's pose with the parameters
    """
    down = np.tile(gravity / np.linalg.norm(gravity), (len(q), 1))
    links = mechanism.single_hand_arm_link_frames(q, arm)[:, [sensor.link for sensor in sensors], :3, :3]
    angles = np.stack([sensor.shown(links[:, k], down) for k, sensor in enumerate(sensors)], axis=1)
    readings = TiltReadings(sensors, angles, down)
    _, turns, mounting = tilt_residuals_and_jacobians(readings, links, np.zeros(3 + 3 * len(sensors)))
    turned = turns @ link_rotation_jacobian_by_parameters(readings, q, arm, pose_jacobian)
    columns = np.concatenate([turned, mounting], axis=3) * readings.usable[..., None, None]
    return columns.reshape(len(q), 2 * len(sensors), -1)


def tilt_report(readings: TiltReadings | None, weights: TiltWeights | None) -> list[str]:
    """Report on tilt sensors, as lines.

    Which tilt sensors were used, and how far they scatter beyond the noise stated for them.
    """
    lines = list[str]()
    if readings is None or weights is None:
        return lines
    for sensor, scatter, used in zip(readings.sensors, weights.scatter, weights.used.T):
        beyond = f", scatter by {scatter * 1e3:.3g} mrad beyond that" if scatter > 0 else ", explained by the fit"
        lines.append(
            f"tilt sensor {sensor.name} on {sensor.place}: {used.sum()} of {len(used)} readings used, noise "
            f"{sensor.sigma * 1e3:.3g} mrad{beyond}"
        )
    return lines
