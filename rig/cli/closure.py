"""rig closure: loop closure of redundant limbs: which six give the pose, and how far the others do not close."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import (
    add_json_result_option,
    add_overwrite_option,
    add_recording_argument,
    file_or_stdout,
    read_recording,
)
from rig.errors import RigError
from rig.formats.json_tree import Json

if TYPE_CHECKING:
    from rig.arrays import Floats, Integers
    from rig.model.mechanisms.redundant_legs import Closures, Legs
    from rig.recording.recording_folder import Recording

EXACT = 1e-7  # m, of a commanded length: controllers tell steps, and a calibration's scatter may be none
STRANGE = 5.0  # standard deviations, RMS over the poses, beyond which a closure is not what is expected


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_recording_argument(
        parser, "with measuring limbs beside its struts (m1..mn in sensors.csv and [insitu] in rig.toml)"
    )
    parser.add_argument(
        "--use",
        metavar="LEGS",
        help="the six legs that tell the pose, as l1,l2,l3,m4,m5,m6; by default the six that tell it best",
    )
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="struts as calibrated, not as rig.toml has them"
    )
    parser.add_argument(
        "--limbs", metavar="FILE", type=Path, help="limbs as `rig insitu` found them, not as rig.toml has them"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        help="closures.csv: frame, what each other leg reads less what the pose says "
        "(e_..), its expected standard deviation (u_..), m",
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> int:
    """Choose six legs, say how the others close; 1 where one closes worse than its errors and geometry allow."""
    import numpy as np

    from rig.model.mechanisms import redundant_legs
    from rig.recording import recording_tables

    recording = read_recording(arguments)
    out = arguments.outputs.file(arguments.out) if arguments.out else None
    of, frames, read = _legs(arguments, recording)
    first = (
        np.arange(6, 12) if len(of.names) >= 12 else np.arange(6)
    )  # limbs tell best where the platform was, well enough to choose by
    chosen = (
        _chosen(arguments.use, of)
        if arguments.use
        else redundant_legs.best_six_legs(of, redundant_legs.leg_closures(of, read, first).T_base_platform)
    )
    found = redundant_legs.leg_closures(of, read, chosen)
    _tell(of, found, frames, chosen, bool(arguments.use))
    arguments.result = _result(of, found, frames, chosen)
    if out:
        sigma = np.sqrt(np.einsum("nii->ni", found.covariance))
        names = [of.names[i] for i in found.checks]
        recording_tables.write_table(
            out,
            ("frame", *(f"e_{name}" for name in names), *(f"u_{name}" for name in names)),
            [
                ",".join([str(frame), *(f"{x:.4e}" for x in (*e, *u))])
                for frame, e, u in zip(frames, found.error, sigma)
            ],
        )
        print(f"written: {arguments.out}")
    return int(_ratio(found).max() > STRANGE)


def _legs(arguments: Namespace, recording: Recording) -> tuple[Legs, Integers, Floats]:
    """(Legs of struts and limbs, frames (n,), lengths (n, legs) m as commanded and read)."""
    import numpy as np

    from calib.certification import measuring_limb_checks, measuring_limbs
    from calib.files import calibration_file
    from calib.online import measuring_limbs_file
    from rig.model.mechanism_kinds import require_hexapod
    from rig.model.mechanisms import redundant_legs

    machine, stated = require_hexapod(recording.design.mechanism), measuring_limbs.stated_limbs(recording.design)
    frames, lengths = measuring_limbs.limb_readings(recording)
    n = len(stated.channels)
    every, _, values = recording.commanded()
    commanded = values[np.searchsorted(every, frames)]
    struts = ("l", machine, np.full(6, EXACT), np.zeros((42, 42)))
    limbs = ("m", stated, np.full(n, stated.length_sigma), np.zeros((7 * n, 7 * n)))
    if arguments.calibration is not None:
        calibration = calibration_file.load(arguments.calibration)
        calibration.refuse_physics("closing legs")
        struts = (
            "l",
            require_hexapod(calibration.correction.fitted),
            np.hypot(calibration.scatter, EXACT),
            calibration.covariance,
        )
        commanded = commanded - calibration.correction.rho(commanded)
    if arguments.limbs is not None:
        limbs = (
            "m",
            *measuring_limb_checks.all_limbs_with_covariance(
                measuring_limbs_file.load_limbs(arguments.limbs).limbs, stated
            ),
        )
    return redundant_legs.combine_legs([struts, limbs], machine.home), frames, np.hstack([commanded, lengths])


def _chosen(text: str, of: Legs) -> Integers:
    """(6,) indices of the legs that a user names. Raises RigError for anything but six of them, each once"""
    import numpy as np

    names = [word.strip() for word in text.split(",")]
    unknown = [name for name in names if name not in of.names]
    if unknown or len(set(names)) != 6 or len(names) != 6:
        raise RigError(
            f"--use takes six different legs of {of.names[0]} .. {of.names[5]} and {of.names[6]} .. "
            f"{of.names[-1]}, not {text!r}"
        )
    return np.array([of.names.index(name) for name in names])


def _ratio(found: Closures) -> Floats:
    """(checks,) RMS closure over what is expected of it."""
    import numpy as np

    return np.sqrt((found.error**2).mean(axis=0) / np.einsum("nii->ni", found.covariance).mean(axis=0))


def _result(of: Legs, found: Closures, frames: Integers, chosen: Integers) -> Json:
    """What --json prints."""
    legs = []
    for i, e, ratio in zip(found.checks, found.error.T, _ratio(found)):
        worst = int(abs(e).argmax())
        legs.append(
            {
                "leg": of.names[i],
                "mean": float(e.mean()),
                "rms": float((e**2).mean() ** 0.5),
                "largest": float(e[worst]),
                "frame": int(frames[worst]),
                "times_expected": float(ratio),
            }
        )
    return {
        "schema": "closure/1",
        "unit": "m",
        "poses": len(frames),
        "pose_from": [of.names[i] for i in chosen],
        "closures": legs,
        "explained_best_by": of.names[int(found.share.argmax())],
    }


def _tell(of: Legs, found: Closures, frames: Integers, chosen: Integers, asked: bool) -> None:
    """Say which legs tell the pose, how each other one closes, and which one leg would explain what does not."""
    import numpy as np

    from rig.model.mechanisms import redundant_legs

    values = np.linalg.svd(
        redundant_legs.leg_length_jacobians(of, found.T_base_platform)[1][:, chosen], compute_uv=False
    )
    condition, how = values[:, 0] / values[:, -1], "as asked" if asked else "the six that tell it best"
    print(
        f"{len(of.names)} legs for six freedoms; {', '.join(of.names[i] for i in chosen)} tell the pose, "
        f"{how} (condition number "
        f"{np.median(condition):.3g} in the middle, {condition.max():.3g} at most); closures of the others "
        f"at {len(frames)} poses, um:"
    )
    print(f"{'':4}{'mean':>10}{'RMS':>10}{'expected':>10}{'largest':>10}{'at frame':>10}")
    for k, (i, ratio) in enumerate(zip(found.checks, _ratio(found))):
        e = found.error[:, k] * 1e6
        expected = np.sqrt(found.covariance[:, k, k].mean()) * 1e6
        print(
            f"{of.names[i]:4}{e.mean():10.2f}{np.sqrt((e**2).mean()):10.2f}{expected:10.2f}"
            f"{e[np.abs(e).argmax()]:10.2f}{frames[np.abs(e).argmax()]:10d}"
            + (f"  {ratio:.1f} times what is expected" if ratio > STRANGE else "")
        )
    if _ratio(found).max() > STRANGE:
        i = int(found.share.argmax())
        print(
            f"one leg explains most of it: {of.names[i]}, were it longer by {-found.off[i] * 1e6:+.2f} um "
            f"than it says ({found.share[i]:.0%} of "
            "the squares)"
        )
