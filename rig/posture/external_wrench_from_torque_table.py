"""External wrench on an arm's hand from a torque table.

Of its joints, by momentum observer and pseudo-inverse.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Json
from rig.errors import RigError
from rig.formats.rig_toml.arm_dynamics_entries import load_arm_design_and_dynamics
from rig.model.arm_hands_effect_places_and_tolerances import require_no_couplings, require_single_hand_mechanism
from rig.model.design import Design
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics
from rig.model.mechanisms.arm_dynamics_and_step_by_step_kinematics import LinkMasses
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.model.pose import TRIANGLE
from rig.posture.arm_force_transmission_and_exertable_wrench import DIRECTIONS
from rig.posture.wrench_estimation_from_torques import (
    ObservedWrench,
    TorqueRecord,
    estimate_wrench,
    external_joint_torques,
    is_wrench_observable,
    load_torque_table,
    momentum_observer_model,
    most_likely_random_walk_rates,
    wrench_by_momentum_observer,
)
from rig.recording.corner_and_pose_csv_tables import COVARIANCE_COLUMNS, write_table
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html

SETTLED = 0.1  # of a record, after which figures are given: a filter begins with knowing nothing


@dataclass(frozen=True, slots=True)
class WrenchOptions:
    """sigma : standard deviations of a torque (N m), an angle (rad) and a speed (rad/s) as read, None for what
    [dynamics] states; rate : (N, N m) by which force and moment change in a second (standard deviation), None for the
    likeliest
    """

    sigma: tuple[float, float, float] | None = None
    rate: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.sigma is not None and min(self.sigma) <= 0:
            raise RigError(f"--sigma takes three positive numbers, not {' '.join(map(str, self.sigma))}")
        if self.rate is not None and min(self.rate) <= 0:
            raise RigError(f"--rate takes two positive numbers, not {' '.join(map(str, self.rate))}")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class WrenchResult(OneLineRepr):
    """An external wrench in time. record; observed : by the momentum observer; plain : (value (k, 6), covariance
    (k, 6, 6), remainder (k,)) by the pseudo-inverse, NaN where the posture does not feel every wrench; rates : (6,) N
    and N m by which it changes in a second; likeliest : whether these are as is likeliest
    """

    record: TorqueRecord
    observed: ObservedWrench
    plain: tuple[Floats, Floats, Floats]
    rates: Floats
    likeliest: bool

    @property
    def settled(self) -> slice:
        """The readings of which figures are given."""
        return slice(int(SETTLED * len(self.record.motion.t)), None)

    @property
    def value(self) -> Floats:
        """(k, 6) N and N m by the observer, once settled."""
        return self.observed.value[0][self.settled]

    @property
    def sigma(self) -> Floats:
        """(k, 6) N and N m, standard uncertainty of the value."""
        return np.sqrt(np.einsum("kii->ki", self.observed.covariance[0][self.settled]))

    @property
    def observable(self) -> Booleans:
        """(k,) at which settled readings the posture feels every wrench."""
        return np.isfinite(self.plain[2][self.settled])

    @property
    def largest(self) -> Floats:
        """(6,) N and N m, of each direction the value that is largest in size, once settled."""
        return self.value[np.abs(self.value).argmax(axis=0), np.arange(6)]

    def __str__(self) -> str:
        return f"{len(self.record.motion.t)} readings, largest {' '.join(f'{x:.3f}' for x in self.largest)} N and Nm"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self))

    def tree(self) -> Json:
        """What `rig arm wrench --json` prints."""
        return {
            "schema": "wrench/1",
            "order": "fx fy fz mx my mz, N and N m, axes of poses",
            "readings": len(self.record.motion.t),
            "mean": self.value.mean(axis=0).tolist(),
            "largest": self.largest.tolist(),
            "sigma_rms": np.sqrt((self.sigma**2).mean(axis=0)).tolist(),
            "wanders_per_s": self.rates.tolist(),
            "innovation": float(self.observed.innovation),
        }

    def write(self, path: Path) -> None:
        """Write both estimates in time, cells empty where a posture does not feel every wrench."""
        columns = (*DIRECTIONS, *COVARIANCE_COLUMNS)
        both = [
            np.concatenate([value, covariance[:, *TRIANGLE]], axis=1)
            for value, covariance in ((self.observed.value[0], self.observed.covariance[0]), self.plain[:2])
        ]
        rows = [
            ",".join([f"{moment:.6f}", *(f"{x:.6e}" if x == x else "" for x in row)])
            for moment, row in zip(self.record.motion.t, np.concatenate(both, axis=1))
        ]
        write_table(path, ["t", *columns, *(f"plain_{name}" for name in columns)], rows)


def measure_wrench(arm_path: Path, torques: Path, options: WrenchOptions = WrenchOptions()) -> WrenchResult:
    """Measure the external wrench (WrenchResult) on an arm from a table of torques.

    As `rig arm wrench` makes it.

    arm_path : rig.toml of an arm with [dynamics]
    Raises FileError for a table that cannot be read, RigError for dynamics that are not stated and for an arm with
        several hands
    """
    design, dynamics = load_arm_design_and_dynamics(arm_path)
    arm = require_arm(design.mechanism)
    require_single_hand_mechanism(arm, "a wrench is estimated")
    require_no_couplings(arm, "a wrench is estimated")
    if options.sigma is not None:
        torque, angle, speed = (np.full(len(arm.axes), value) for value in options.sigma)
        dynamics = replace(dynamics, torque_sigma=torque, angle_sigma=angle, speed_sigma=speed)
    links = dynamics.links
    if links is None:
        raise RigError(f"{arm_path}: [dynamics] states no links, so that weight and motion cannot be subtracted")
    sigma, angle = dynamics.need("torque_sigma", arm_path), dynamics.need("angle_sigma", arm_path)
    record = load_torque_table(torques, arm, dynamics, arm_path)
    speed = dynamics.need("speed_sigma", arm_path) if record.motion.measured else np.ones(len(arm.axes))
    model = momentum_observer_model(record.motion, arm, links, design.gravity, (sigma, angle, speed))
    rates = most_likely_random_walk_rates(model) if options.rate is None else np.repeat(options.rate, 3)
    plain = _plain(record, design, sigma, links)
    return WrenchResult(record, wrench_by_momentum_observer(model, rates), plain, rates, options.rate is None)


def _plain(record: TorqueRecord, design: Design, sigma: Floats, links: LinkMasses) -> tuple[Floats, Floats, Floats]:
    """(value (k, 6), covariance (k, 6, 6), left (k,)) by the pseudo-inverse, reading by reading; NaN where the posture
    does not feel every wrench.

    sigma : (n,) N m of a torque's reading
    """
    arm, m = require_arm(design.mechanism), record.motion
    q, torque = (
        m.q[0],
        external_joint_torques(m.torque[0], m.q[0], m.speed[0], record.acceleration, arm, links, design.gravity),
    )
    mass = arm_dynamics_and_step_by_step_kinematics.mass_matrix(q, arm, links)
    own = (mass * record.acceleration_sigma**2) @ np.swapaxes(mass, 1, 2) + np.diag(np.square(sigma))
    observable = is_wrench_observable(q, arm, own)
    value, covariance, left = np.full((len(q), 6), np.nan), np.full((len(q), 6, 6), np.nan), np.full(len(q), np.nan)
    if observable.any():
        found = estimate_wrench(torque[observable], q[observable], arm, own[observable])
        value[observable], covariance[observable], left[observable] = found.value, found.covariance, found.left
    return value, covariance, left
