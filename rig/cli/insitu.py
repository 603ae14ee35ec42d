"""rig insitu: test measuring limbs in situ against vision; accepted ones are saved to replace it."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli import online
from rig.cli.shared.command_options import (
    add_json_result_option,
    add_page_option,
    add_recording_argument,
    page_links,
    page_path,
    print_frames_without_pose,
    read_recording,
)
from rig.cli.shared.terminal_output import Progress
from rig.errors import RigError
from rig.formats.json_tree import Json
from rig.formats.number_parsing_and_rounding import parse_number

if TYPE_CHECKING:
    from calib.certification.measuring_limb_checks import Limbs
    from calib.certification.measuring_limbs import Agreement
    from calib.online.measuring_limbs_file import Accepted
    from calib.samples.recording_samples import Sampled
    from rig.arrays import Floats, Integers
    from rig.recording.recording_folder import Recording

    Closed = tuple[Floats, Floats]  # (error, sigma), each (n, checks) m


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_recording_argument(parser, "with columns m1..mn (m), six or more, in sensors.csv and [insitu] in rig.toml")
    parser.add_argument(
        "--tolerance",
        nargs=2,
        type=parse_number,
        default=(5e-5, 2e-4),
        metavar=("M", "RAD"),
        help="that each axis must agree with vision within (default 5e-5 m and 2e-4 rad)",
    )
    parser.add_argument(
        "--use",
        metavar="LIMBS",
        help="of more limbs than six those that tell the pose, as m1,m2,m4,m5,m7,m8, the others being "
        "checks; by default the six that tell it best",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        help="limbs.json: geometry, covariance, agreement and verdict, for --limbs of measure, "
        "calibrate, online and run",
    )
    add_page_option(parser)
    parser.add_argument(
        "--state",
        metavar="FILE",
        type=Path,
        help="once passed: learn the struts from the limbs' poses, and save that here",
    )
    add_json_result_option(parser)


def run(arguments: Namespace) -> int:
    """Hold the measuring limbs against vision, say whether they pass, save that, and learn from them where they do."""
    if min(arguments.tolerance) <= 0:
        raise RigError("--tolerance takes two positive numbers, m and rad")
    recording = read_recording(arguments)

    from calib.certification import measuring_limbs
    from calib.online import measuring_limb_poses, measuring_limbs_file
    from calib.samples.recording_samples import sample_recording

    renewed = arguments.out is not None and measuring_limbs_file.is_limbs_file(arguments.out)
    out = arguments.outputs.file(arguments.out, own=renewed) if arguments.out else None
    state = arguments.outputs.file(arguments.state, own=True) if arguments.state else None
    page = page_path(arguments)
    measuring_limbs.limb_hexapod(recording.design)  # where limbs tell no pose, nothing is read
    read = measuring_limbs.limb_readings(recording)
    channels = measuring_limbs.stated_limbs(recording.design).channels
    asked = None if arguments.use is None else _asked(arguments.use, channels)
    by_vision = sample_recording(recording, progress=Progress())
    accepted, closed = _held(arguments, recording, by_vision, read, asked)
    from calib.report.online_and_limb_pages import measuring_limbs_verdict

    found = accepted.agreement
    _print(found, by_vision.source)
    _print_checks(accepted.limbs, channels, *closed)
    print_frames_without_pose(by_vision.measurement)
    if accepted.withdrawn is not None:
        print(
            f"from frame {accepted.withdrawn.frame} on {accepted.withdrawn.reason}; limbs that change while "
            "they are held "
            "against vision cannot stand for it"
        )
    passed = accepted.verdict == "accepted"
    print(
        "the measuring limbs pass: their poses may stand for vision's" if passed else "the measuring limbs do not pass"
    )
    why = None if accepted.withdrawn is None else accepted.withdrawn.reason
    arguments.result = _result(accepted, channels, *closed) | {"verdict": measuring_limbs_verdict(found, why).tree()}
    if out is not None:
        measuring_limbs_file.save_limbs(out, accepted)
        print(f"written: {arguments.out}, verdict {accepted.verdict}")
    if page is not None:
        from calib.report.online_and_limb_pages import write_measuring_limbs_page

        write_measuring_limbs_page(
            page, recording.name, found, by_vision.source, why, page_links(arguments, arguments.page)
        )
        print(f"written: {arguments.page}")
    if state is not None and passed:
        poses = measuring_limb_poses.samples_of_limb_poses(
            recording, measuring_limb_poses.limb_poses(recording, accepted)
        )
        _learn(arguments, recording, poses, state)
    return 0 if passed else 1


def _held(
    arguments: Namespace,
    recording: Recording,
    by_vision: Sampled,
    read: tuple[Integers, Floats],
    asked: Integers | None,
) -> tuple[Accepted, Closed]:
    """(Accepted, closures of the limbs beyond six) of limbs held against vision. read : (frames (f,), lengths (f,
    limbs) m)
    asked : (6,) numbers of those that tell poses, or None"""
    import numpy as np

    from calib.certification import measuring_limb_checks, measuring_limbs
    from calib.files.calibration_from_recording import calibration_provenance
    from calib.online import measuring_limbs_file

    stated, (frames, every) = measuring_limbs.stated_limbs(recording.design), read
    sigma, home = stated.length_sigma, measuring_limbs.limb_hexapod(recording.design).home
    chosen = (
        measuring_limb_checks.best_six_limbs(stated, home, by_vision.samples.T_base_platform)
        if asked is None
        else asked
    )
    nominal = measuring_limbs.limb_hexapod(recording.design, chosen)
    samples = measuring_limbs.samples_by_limbs(by_vision.samples, frames, every[:, chosen])
    T, expected = measuring_limbs.held_out_limb_poses(samples, nominal, sigma)
    found = measuring_limbs.limb_agreement(samples.T_base_platform, T, expected, arguments.tolerance)
    six = replace(measuring_limbs.calibrate_limbs(samples, nominal, sigma)[0], chosen=chosen)
    both = every[np.searchsorted(frames, samples.frame)]
    limbs = replace(six, checks=measuring_limb_checks.fit_limb_checks(six, stated, both))
    accepted = measuring_limbs_file.Accepted(
        limbs, nominal, found, None, calibration_provenance(recording, arguments.argv, 0, by_vision.source == "images")
    )
    slipped = measuring_limbs.detect_limb_slip(samples, limbs, sigma)
    if slipped is not None:
        limb = chosen[slipped.limb - 1] + 1
        reason = (
            f"limb {limb} is longer by {slipped.size * 1e6:+.1f} +- {slipped.sigma * 1e6:.1f} um than it reads: "
            "it slipped"
        )
        accepted = measuring_limbs_file.withdraw_acceptance(accepted, str(recording.folder), slipped.frame, reason)
    return accepted, measuring_limb_checks.held_out_check_errors(limbs, stated, both)


def _asked(text: str, channels: tuple[str, ...]) -> Integers:
    """(6,) numbers, from 0, of the limbs that a user names. Raises RigError for anything but six of them, each once"""
    import numpy as np

    names = [word.strip() for word in text.split(",")]
    if set(names) - set(channels) or len(set(names)) != 6 or len(names) != 6:
        raise RigError(f"--use takes six different limbs of {channels[0]} .. {channels[-1]}, not {text!r}")
    return np.sort([channels.index(name) for name in names])


def _print_checks(limbs: Limbs, channels: tuple[str, ...], error: Floats, sigma: Floats) -> None:
    """Say which six tell the pose, and how the others close on stretches left out of fitting them."""
    if limbs.checks is None or not len(limbs.checks.limbs):
        return
    print(f"{', '.join(channels[i] for i in limbs.chosen)} tell the pose; what the others read less what it says, um:")
    print(f"{'':4}{'mean':>9}{'RMS':>9}{'expected':>10}")
    for i, e, s in zip(limbs.checks.limbs, error.T * 1e6, sigma.T * 1e6):
        print(f"{channels[i]:4}{e.mean():9.2f}{(e**2).mean() ** 0.5:9.2f}{(s**2).mean() ** 0.5:10.2f}")


def _result(accepted: Accepted, channels: tuple[str, ...], error: Floats, sigma: Floats) -> Json:
    """What --json prints. error, sigma : (n, checks) m, of the limbs beyond six"""
    found, gone = accepted.agreement, accepted.withdrawn
    names = ("bias", "scatter", "expected", "limits", "surely", "tolerance", "moved", "passed")
    figures = {name: getattr(found, "proven_limits" if name == "surely" else name).tolist() for name in names}
    checks = accepted.limbs.checks
    closures = [
        {
            "limb": channels[i],
            "mean": float(e.mean()),
            "rms": float((e**2).mean() ** 0.5),
            "expected": float((s**2).mean() ** 0.5),
        }
        for i, e, s in zip([] if checks is None else checks.limbs, error.T, sigma.T)
    ]
    return {
        "schema": "insitu/1",
        "verdict": accepted.verdict,
        "poses": found.n,
        "order": "x y z rx ry rz, m and rad",
        "pose_from": [channels[i] for i in accepted.limbs.chosen],
        "closures": closures,
        **figures,
        "withdrawn": gone and {"frame": gone.frame, "reason": gone.reason},
    }


def _print(found: Agreement, source: str) -> None:
    from calib.certification.measuring_limbs import AXES, MOVES

    print(
        f"measuring limbs less vision ({source}), {found.n} poses, each by limbs fitted to other stretches; "
        "um and urad:"
    )
    print(
        f"{'':4}{'bias':>9}{'scatter':>9}{'expected':>9}{'limits of agreement':>24}"
        f"{'surely within':>15}{'tolerance':>11}{'moved over':>14}"
    )
    for i, axis in enumerate(AXES):
        low, high = found.limits[:, i] * 1e6
        moved = f"{found.moved[i] * 1e3:.1f} {'mm' if i < 3 else 'mrad'}"
        said = (
            "passes"
            if found.passed[i]
            else (
                "fails"
                if found.proven_limits[i] > found.tolerance[i]
                else f"not shown: it must move over {MOVES:g} tolerances"
            )
        )
        print(
            f"{axis:4}{found.bias[i] * 1e6:9.2f}{found.scatter[i] * 1e6:9.2f}{found.expected[i] * 1e6:9.2f}"
            f"{f'{low:.2f} .. {high:.2f}':>24}{found.proven_limits[i] * 1e6:15.2f}{found.tolerance[i] * 1e6:11.1f}"
            f"{moved:>14}  {said}"
        )


def _learn(arguments: Namespace, recording: Recording, by_limbs: Sampled, state: Path) -> None:
    """Learn the struts from the limbs' poses that have not been learnt, and save the filter."""
    from calib.online.information_filter import Online

    known = Online.load(arguments.state) if arguments.state.exists() else None
    learner, *_ = online.learn_recording(recording, lambda: by_limbs, known, None, Progress())
    learner.save(state)
    print(f"written: {arguments.state}")
