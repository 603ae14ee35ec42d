"""rig arm wrench: external wrench on an arm's hand.

Estimated with covariance.
From joint torques or motor currents.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_overwrite_option,
    file_or_stdout,
)
from rig.formats.numbers_and_units import parse_number

if TYPE_CHECKING:
    from rig.posture.external_wrench_from_torque_table import WrenchResult


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig arm wrench` to a parser."""
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
        help="random-walk rate of force and moment per second (standard deviation); by default the likeliest",
    )
    parser.add_argument(
        "--out", metavar="FILE", type=file_or_stdout, help="wrench.csv: both estimates with their covariance, in time"
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig arm wrench`.

    Estimate the wrench on an arm's hand from torques and print it.

    By a momentum observer, and by the pseudo-inverse for comparison.
    """
    from rig.planning.layout import shipped_arms_and_layouts
    from rig.posture.external_wrench_from_torque_table import WrenchOptions, measure_wrench

    path = shipped_arms_and_layouts.shipped_arm_path(arguments.arm)
    sigma, rate = (None if value is None else tuple(value) for value in (arguments.sigma, arguments.rate))
    options = WrenchOptions(sigma, rate)
    arguments.outputs.inputs.append(path)
    out = arguments.outputs.file(arguments.out) if arguments.out else None
    result = measure_wrench(path, arguments.torques, options)
    if out:
        result.write(out)
    _print_result(result)
    arguments.result = result.tree()
    if out:
        print(f"written: {arguments.out}")


def _print_result(result: WrenchResult) -> None:
    """Print both estimates: mean, the largest, and how sure each is."""
    import numpy as np

    from rig.posture.arm_force_transmission_and_exertable_wrench import DIRECTIONS

    record, plain, observable, value, sigma = result.record, result.plain, result.observable, result.value, result.sigma
    other_sigma = 2 * np.sqrt(np.einsum("kii->ki", plain[1][result.settled])[observable])
    print(
        f"{len(record.motion.t)} readings over {record.motion.t[-1]:.2f} s, "
        f"{'motor currents' if record.current else 'torques'}, speeds "
        f"{'as read' if record.motion.measured else 'derived from angles'}; weight and motion subtracted; in "
        "the axes of poses, N and Nm:"
    )
    print(f"{'':4}{'mean':>10}{'largest':>10}{'+- (k=2)':>10}{'plain mean':>12}{'+- (k=2)':>10}")
    for i, name in enumerate(DIRECTIONS):
        other = (
            f"{plain[0][result.settled][observable, i].mean():12.3f}{np.sqrt((other_sigma[:, i] ** 2).mean()):10.3f}"
            if observable.any()
            else f"{'-':>12}{'-':>10}"
        )
        print(
            f"{name:4}{value[:, i].mean():10.3f}{result.largest[i]:10.3f}"
            f"{2 * np.sqrt((sigma[:, i] ** 2).mean()):10.3f}{other}"
        )
    print(
        f"the wrench wanders by {result.rates[0]:.3g} N and {result.rates[3]:.3g} Nm in a second, "
        f"{'as is likeliest' if result.likeliest else 'as stated'}; readings are "
        f"{result.observed.innovation:.3f} of what the observer expects (1 if the model is complete)"
    )
    blind = int(np.isnan(plain[2]).sum())
    if blind:
        print(
            f"{blind} postures cannot sense every wrench: the pseudo-inverse is undetermined there, the observer "
            "continues from its last estimate"
        )
