"""rig wrench: external wrench on an arm's hand, estimated from joint torques or motor currents, with covariance."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import add_json_result_option, add_overwrite_option, file_or_stdout
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number

if TYPE_CHECKING:
    from rig.arrays import Floats
    from rig.model.design import Design
    from rig.model.mechanisms.arm_dynamics import Links
    from rig.posture.momentum_observer import Observed
    from rig.posture.wrench_from_torques import TorqueRecord

SETTLED = 0.1  # of a record, after which figures are told: a filter begins with knowing nothing


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument(
        "arm", metavar="ARM.toml", help="a rig.toml with an arm and [dynamics], or the name of a shipped one, as panda"
    )
    parser.add_argument(
        "torques",
        metavar="torques.csv",
        type=Path,
        help="t, q1.., tau1.. (Nm, what the joints exert) or i1.. (A of the motors), "
        "and v1.. (rad/s) where speeds were read",
    )
    parser.add_argument(
        "--sigma",
        nargs=3,
        type=parse_number,
        metavar=("NM", "RAD", "RAD/S"),
        help="standard deviations of a torque, an angle and a speed as read, in place of what [dynamics] states",
    )
    parser.add_argument(
        "--rate",
        nargs=2,
        type=parse_number,
        metavar=("N", "NM"),
        help="by how much force and moment wander in a second (standard deviation); by default as is likeliest",
    )
    parser.add_argument(
        "--out", metavar="FILE", type=file_or_stdout, help="wrench.csv: both estimates with their covariance, in time"
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Estimate the wrench by a momentum observer, and by the plain pseudo-inverse beside it; say both."""
    from dataclasses import replace

    import numpy as np

    from rig.formats.rig_toml import arm_dynamics_entries
    from rig.model.mechanism_kinds import require_arm
    from rig.planning.layout import shipped_arm_layout
    from rig.posture import momentum_observer, wrench_from_torques

    path = shipped_arm_layout.shipped_arm_path(arguments.arm)
    design, dynamics = arm_dynamics_entries.load_arm_dynamics(path)
    arm = require_arm(design.mechanism)
    if arguments.sigma is not None:
        if min(arguments.sigma) <= 0:
            raise RigError(f"--sigma takes three positive numbers, not {' '.join(map(str, arguments.sigma))}")
        torque, angle, speed = (np.full(len(arm.axes), value) for value in arguments.sigma)
        dynamics = replace(dynamics, torque_sigma=torque, angle_sigma=angle, speed_sigma=speed)
    if arguments.rate is not None and min(arguments.rate) <= 0:
        raise RigError(f"--rate takes two positive numbers, not {' '.join(map(str, arguments.rate))}")
    links = dynamics.links
    if links is None:
        raise RigError(f"{path}: [dynamics] states no links, so that weight and motion cannot be taken off")
    sigma, angle = dynamics.need("torque_sigma", path), dynamics.need("angle_sigma", path)
    arguments.outputs.inputs.append(path)
    out = arguments.outputs.file(arguments.out) if arguments.out else None
    record = wrench_from_torques.load_torque_table(arguments.torques, arm, dynamics, path)
    speed = dynamics.need("speed_sigma", path) if record.motion.measured else np.ones(len(arm.axes))
    model = momentum_observer.observer_model(record.motion, arm, links, design.gravity, (sigma, angle, speed))
    rates = (
        momentum_observer.most_likely_wrench_rates(model) if arguments.rate is None else np.repeat(arguments.rate, 3)
    )
    seen, plain = momentum_observer.observe_wrench(model, rates), _plain(record, design, sigma, links)
    if out:
        _write(out, record.motion.t, seen, plain)
    _tell(record, seen, plain, rates, arguments.rate is None)
    settled = slice(int(SETTLED * len(record.motion.t)), None)
    value, sigma = seen.value[0][settled], np.sqrt(np.einsum("kii->ki", seen.covariance[0][settled]))
    arguments.result = {
        "schema": "wrench/1",
        "order": "fx fy fz mx my mz, N and N m, axes of poses",
        "readings": len(record.motion.t),
        "mean": value.mean(axis=0).tolist(),
        "largest": value[np.abs(value).argmax(axis=0), np.arange(6)].tolist(),
        "sigma_rms": np.sqrt((sigma**2).mean(axis=0)).tolist(),
        "wanders_per_s": rates.tolist(),
        "innovation": float(seen.innovation),
    }
    if out:
        print(f"written: {arguments.out}")


def _plain(record: TorqueRecord, design: Design, sigma: Floats, links: Links) -> tuple[Floats, Floats, Floats]:
    """(value (k, 6), covariance (k, 6, 6), left (k,)) by the pseudo-inverse, reading by reading; NaN where the posture
    does not feel every wrench.

    sigma : (n,) N m of a torque's reading
    """
    import numpy as np

    from rig.model.mechanism_kinds import require_arm
    from rig.model.mechanisms import arm_dynamics
    from rig.posture import wrench_from_torques

    arm, m = require_arm(design.mechanism), record.motion
    q, torque = (
        m.q[0],
        wrench_from_torques.external_joint_torques(
            m.torque[0], m.q[0], m.speed[0], record.acceleration, arm, links, design.gravity
        ),
    )
    mass = arm_dynamics.mass_matrix(q, arm, links)
    own = (mass * record.acceleration_sigma**2) @ np.swapaxes(mass, 1, 2) + np.diag(np.square(sigma))
    felt = wrench_from_torques.is_wrench_observable(q, arm, own)
    value, covariance, left = np.full((len(q), 6), np.nan), np.full((len(q), 6, 6), np.nan), np.full(len(q), np.nan)
    if felt.any():
        found = wrench_from_torques.estimate_wrench(torque[felt], q[felt], arm, own[felt])
        value[felt], covariance[felt], left[felt] = found.value, found.covariance, found.left
    return value, covariance, left


def _write(out: Path, t: Floats, seen: Observed, plain: tuple[Floats, Floats, Floats]) -> None:
    """wrench.csv: the observer's and the plain one, cells empty where a posture does not feel every wrench."""
    import numpy as np

    from rig.model.pose import TRIANGLE
    from rig.posture.force_transmission import DIRECTIONS
    from rig.recording import recording_tables
    from rig.recording.recording_tables import COVARIANCE_COLUMNS

    header = ["t", *DIRECTIONS, *COVARIANCE_COLUMNS, *(f"plain_{name}" for name in (*DIRECTIONS, *COVARIANCE_COLUMNS))]
    both = [
        np.concatenate([value, covariance[:, *TRIANGLE]], axis=1)
        for value, covariance in ((seen.value[0], seen.covariance[0]), plain[:2])
    ]
    recording_tables.write_table(
        out,
        header,
        [
            ",".join([f"{moment:.6f}", *(f"{x:.6e}" if x == x else "" for x in row)])
            for moment, row in zip(t, np.concatenate(both, axis=1))
        ],
    )


def _tell(
    record: TorqueRecord, seen: Observed, plain: tuple[Floats, Floats, Floats], rates: Floats, sought: bool
) -> None:
    """Say both estimates: mean, the largest, and how sure each is."""
    import numpy as np

    from rig.posture.force_transmission import DIRECTIONS

    count = len(record.motion.t)
    settled = slice(int(SETTLED * count), None)
    value, sigma = seen.value[0][settled], np.sqrt(np.einsum("kii->ki", seen.covariance[0][settled]))
    felt = np.isfinite(plain[2][settled])
    beside = 2 * np.sqrt(np.einsum("kii->ki", plain[1][settled])[felt])
    print(
        f"{count} readings over {record.motion.t[-1]:.2f} s, "
        f"{'motor currents' if record.current else 'torques'}, speeds "
        f"{'as read' if record.motion.measured else 'worked out of angles'}; weight and motion taken off; in "
        "the axes of poses, N and Nm:"
    )
    print(f"{'':4}{'mean':>10}{'largest':>10}{'+- (k=2)':>10}{'plain mean':>12}{'+- (k=2)':>10}")
    for i, name in enumerate(DIRECTIONS):
        most = value[np.abs(value[:, i]).argmax(), i]
        other = (
            f"{plain[0][settled][felt, i].mean():12.3f}{np.sqrt((beside[:, i] ** 2).mean()):10.3f}"
            if felt.any()
            else f"{'-':>12}{'-':>10}"
        )
        print(f"{name:4}{value[:, i].mean():10.3f}{most:10.3f}{2 * np.sqrt((sigma[:, i] ** 2).mean()):10.3f}{other}")
    print(
        f"the wrench wanders by {rates[0]:.3g} N and {rates[3]:.3g} Nm in a second, "
        f"{'as is likeliest' if sought else 'as stated'}; readings are "
        f"{seen.innovation:.3f} of what the observer expects (1 where nothing is left out)"
    )
    blind = int(np.isnan(plain[2]).sum())
    if blind:
        print(
            f"{blind} postures do not feel every wrench: the pseudo-inverse says nothing there, the observer "
            "goes on from what it knows"
        )
