"""Online pose learning (rig online): frames not yet learnt, and the simple learners of --learner."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import print_frames_without_pose
from rig.cli.shared.terminal_output import Progress
from rig.errors import RigError
from rig.formats.json_tree import Json
from rig.formats.number_parsing_and_rounding import parse_number

if TYPE_CHECKING:
    from calib.samples.pose_samples import Samples
    from rig.arrays import Floats
    from rig.recording.recording_folder import Recording
    from rig.recording.recording_frames import Marks


def unlearnt_frame_numbers(recording: Recording, marks: Marks, learnt: set[str]) -> list[int]:
    """Numbers of the frames that are not yet learnt; prints how many are. marks : of the recording; learnt : marks

    Raises RigError where none is left: what is learnt twice counts twice
    """
    from rig.recording.recording_frames import frames_with_known_hashes

    frames, again = recording.exposures.times()[0], frames_with_known_hashes(marks, learnt)
    if len(again) == len(marks) > 0:
        raise RigError(
            f"all {len(marks)} frames of {recording.folder} in which anything is seen have been learnt already; "
            "once more they would count "
            "twice"
        )
    if again:
        print(f"{len(again)} of {len(frames)} frames have been learnt already and are left out")
    return [frame for frame in frames.tolist() if frame not in set(again)]


def unlearnt_samples(samples: Samples, fresh: list[int], recording: Recording) -> Samples:
    """Samples of frames that are not yet learnt. Raises RigError where none of them has a pose."""
    import numpy as np

    chosen = np.isin(samples.frame, fresh)
    if not chosen.any():
        raise RigError(f"none of the {len(fresh)} frames of {recording.folder} that have not been learnt has a pose")
    return samples.take(chosen)


if TYPE_CHECKING:
    from collections.abc import Callable

    from calib.certification.calibration import Calibration
    from calib.online.learners import Learner
    from calib.report.online_and_limb_pages import OnlineResult
    from calib.samples.recording_samples import Sampled
    from rig.recording.recording_folder import Recording

WATCHING = "filter"  # the one of calib/online/information_filter.py
SETTINGS = {"forgetting": "kept", "drifting": "drift", "first-order": "step"}


def add_learner_options(parser: ArgumentParser) -> None:
    """Add the options that choose a learner (--learner) and its setting."""
    parser.add_argument(
        "--learner",
        choices=(WATCHING, *SETTINGS),
        default=WATCHING,
        help="filter (the default) names what jumped; forgetting: "
        "least squares that forget along what is told; drifting: parameters that wander; first-order: "
        "gradient steps, no covariance",
    )
    parser.add_argument(
        "--kept",
        type=parse_number,
        metavar="SHARE",
        help="of forgetting: share of what was known that a pose leaves (default 0.99)",
    )
    parser.add_argument(
        "--drift",
        type=parse_number,
        metavar="M",
        help="of drifting: how far a parameter wanders from pose to pose (default 1e-7 m)",
    )
    parser.add_argument(
        "--step",
        type=parse_number,
        metavar="M",
        help="of first-order: how far a parameter may have to go (default 1e-3 m)",
    )


def refuse_other_learners_settings(arguments: Namespace) -> None:
    """Refuse settings of other learners than the chosen one.

    Raises RigError where one is given
    """
    for learner, setting in SETTINGS.items():
        if learner != arguments.learner and getattr(arguments, setting) is not None:
            raise RigError(f"--{setting} is of --learner {learner}, not of {arguments.learner}")


def learn_poses(
    arguments: Namespace,
    recording: Recording,
    sampled: Callable[[], Sampled],
    calibration: Calibration | None,
    state: Path | None,
    progress: Progress,
) -> tuple[OnlineResult, Json]:
    """Learn poses one at a time by the chosen learner: (result, dict for --json); prints how well it predicted

    sampled : makes the Sampled of the recording; state : where it is saved, or None
    Raises RigError for a state of another learner, and where no pose is left to learn
    """
    import numpy as np

    from calib.models.platform.identification import geometric_parameters
    from calib.online import learners
    from calib.report.online_and_limb_pages import OnlineResult
    from rig.model.mechanism_kinds import require_hexapod
    from rig.recording.recording_frames import content_hashes, hashes_of_frames

    refuse_other_learners_settings(arguments)
    learner = _learner(arguments, recording, calibration)
    of, before = content_hashes(recording), learner.number
    fresh = unlearnt_frame_numbers(recording, of, learner.data)
    found = sampled()
    samples = unlearnt_samples(found.samples, fresh, recording)
    learner.data |= set(hashes_of_frames(of, fresh))
    commands = samples.commanded - (0 if calibration is None else calibration.correction.rho(samples.commanded))
    errors = np.empty((len(samples), 6))
    for k, (x, T, C) in enumerate(zip(commands, samples.T_base_platform, samples.total_covariance())):
        errors[k] = learner.update(x, T, C)
        progress("learning", k + 1, len(samples))
    print(
        f"{len(samples)} poses from {found.source}, learnt one at a time by {arguments.learner} "
        f"({learner.SETTING} {learner.setting:g})" + (f" after {before} before" if before else "")
    )
    _print_prediction_errors(errors)
    moved = float(
        np.sqrt(np.mean((learner.p - geometric_parameters(require_hexapod(recording.design.mechanism))) ** 2))
    )
    sigma = None if learner.covariance is None else float(np.sqrt(np.mean(np.diag(learner.covariance))))
    known = "" if sigma is None else f", known to {sigma * 1e3:.4f} mm RMS"
    print(f"joints and zeros moved by {moved * 1e3:.4f} mm RMS from rig.toml{known}")
    print_frames_without_pose(found.measurement)
    if state is not None:
        learners.save_learner(state, learner)
        print(f"written: {arguments.state}")
    first, last = _quarters(errors)
    result = {
        "schema": "followed/1",
        "learner": arguments.learner,
        learner.SETTING: float(learner.setting),
        "poses": len(samples),
        "poses_before": before,
        "first_quarter": first,
        "last_quarter": last,
        "moved_rms_m": moved,
        "sigma_rms_m": sigma,
    }
    return OnlineResult(samples.frame, errors, found.source, (), (), sigma, moved), result


def _learner(arguments: Namespace, recording: Recording, calibration: Calibration | None) -> Learner:
    """The Learner of a state that is there, else a new one. Raises RigError where the two do not go together."""
    from calib.online import learners
    from calib.online.learners import LEARNERS
    from rig.model.mechanism_kinds import require_hexapod

    kind, chosen = LEARNERS[arguments.learner], getattr(arguments, SETTINGS[arguments.learner])
    if arguments.state is not None and arguments.state.exists():
        learner = learners.load_learner(arguments.state)
        if type(learner) is not kind:
            raise RigError(f"{arguments.state} is the state of another learner than {arguments.learner}")
        if chosen is not None and chosen != learner.setting:
            raise RigError(f"{arguments.state} goes on with {learner.SETTING} {learner.setting:g}, not with {chosen:g}")
        return learner
    nominal = require_hexapod(recording.design.mechanism if calibration is None else calibration.correction.fitted)
    try:
        learner = kind(nominal) if chosen is None else kind(nominal, chosen)
    except ValueError as error:
        raise RigError(f"--{kind.SETTING}: {error}") from None
    if calibration is not None:
        learner.start_from(calibration.covariance)
        learner.data = set(calibration.provenance.get("data", ()))
    return learner


def _quarters(errors: Floats) -> tuple[float, float]:
    """RMS of errors (n, 6) whitened in the first quarter of the poses, and in the last."""
    quarter = max(len(errors) // 4, 1)
    return float((errors[:quarter] ** 2).mean() ** 0.5), float((errors[-quarter:] ** 2).mean() ** 0.5)


def _print_prediction_errors(errors: Floats) -> None:
    """Say how far poses were from what was expected of them. errors : (n, 6) whitened"""
    first, last = _quarters(errors)
    print(
        f"poses were off what was expected by {first:.3g} standard deviations RMS in the first quarter, by "
        f"{last:.3g} in the last "
        "(1 where nothing is left to learn)"
    )
