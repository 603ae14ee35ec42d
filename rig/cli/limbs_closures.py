"""rig limbs closures: closure errors of redundant legs.

It finds which six legs give the pose; the closure errors are those of the others.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.common_options import add_json_result_option, add_overwrite_option, file_or_stdout
from rig.cli.shared.input_options import add_recording_argument, read_recording

if TYPE_CHECKING:
    from calib.api.loop_closure_check_of_redundant_legs import LoopClosureResult


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig limbs closures` to a parser."""
    add_recording_argument(
        parser, "with measuring limbs next to its struts (m1..mn in sensors.csv and [insitu] in rig.toml)"
    )
    parser.add_argument(
        "--use",
        metavar="LEGS",
        help="the six legs that give the pose, as l1,l2,l3,m4,m5,m6; by default the best-conditioned six",
    )
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="struts as calibrated, not as rig.toml states them"
    )
    parser.add_argument(
        "--limbs",
        metavar="FILE",
        type=Path,
        help="limbs as `rig limbs test` estimated them, not as rig.toml states them",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        help="closures.csv: frame, reading of each other leg minus that predicted from the pose "
        "(e_..), its expected standard deviation (u_..), m",
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> int:
    """Run `rig limbs closures`.

    Choose six of redundant limbs and print the closure errors of the others.

    Exit status 1 where one is worse than its errors and geometry allow.
    """
    from calib.api.loop_closure_check_of_redundant_legs import LoopClosureOptions, close_loops
    from calib.files import calibration_file
    from calib.online.accepted_limbs_file import load_limbs

    recording = read_recording(arguments)
    out = arguments.outputs.file(arguments.out) if arguments.out else None
    options = LoopClosureOptions(
        tuple(arguments.use.split(",")) if arguments.use else None,
        None if arguments.calibration is None else calibration_file.load(arguments.calibration),
        None if arguments.limbs is None else load_limbs(arguments.limbs),
    )
    result = close_loops(recording, options)
    _print_result(result)
    arguments.result = result.tree()
    if out:
        result.write(out)
        print(f"written: {arguments.out}")
    return int(result.strange)


def _print_result(result: LoopClosureResult) -> None:
    """Print which legs give the pose, how each other one closes, and which one leg would explain what does not."""
    import numpy as np

    from calib.api.loop_closure_check_of_redundant_legs import STRANGE

    legs, found, condition = result.legs, result.closures, result.condition
    print(
        f"{len(legs.names)} legs for six freedoms; {', '.join(legs.names[i] for i in result.chosen)} give the pose, "
        f"{'as asked' if result.requested else 'the best-conditioned six'} (condition number "
        f"{np.median(condition):.3g} in the middle, {condition.max():.3g} at most); closures of the others "
        f"at {len(result.frames)} poses, um:"
    )
    print(f"{'':4}{'mean':>10}{'RMS':>10}{'expected':>10}{'largest':>10}{'at frame':>10}")
    for k, (i, ratio) in enumerate(zip(found.checks, result.ratio)):
        e = found.error[:, k] * 1e6
        expected = np.sqrt(found.covariance[:, k, k].mean()) * 1e6
        print(
            f"{legs.names[i]:4}{e.mean():10.2f}{np.sqrt((e**2).mean()):10.2f}{expected:10.2f}"
            f"{e[np.abs(e).argmax()]:10.2f}{result.frames[np.abs(e).argmax()]:10d}"
            + (f"  {ratio:.1f} times what is expected" if ratio > STRANGE else "")
        )
    if result.strange:
        i = result.explaining_leg
        print(
            f"one leg explains most of it: {legs.names[i]}, were it longer by {-found.off[i] * 1e6:+.2f} um "
            f"than it reads ({found.share[i]:.0%} of the squares)"
        )
