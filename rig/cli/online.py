"""rig online: learn parameters online, pose by pose, from a recording; report sudden changes of the machine."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files, online_pose_learning, poses_from_readings, recording_checks
from rig.cli.shared.command_options import (
    add_json_result_option,
    add_page_option,
    add_recording_argument,
    page_links,
    page_path,
    print_frames_without_pose,
    read_recording,
)
from rig.cli.shared.online_pose_learning import unlearnt_frame_numbers, unlearnt_samples
from rig.cli.shared.terminal_output import Progress
from rig.errors import RigError
from rig.formats.json_tree import Json

if TYPE_CHECKING:
    from calib.certification.calibration import Calibration
    from calib.certification.calibration_evidence import OfCalibrations
    from calib.online.change_detection import Change
    from calib.online.information_filter import Online, Update
    from calib.report.online_and_limb_pages import OnlineResult
    from calib.samples.recording_samples import Sampled
    from rig.arrays import Integers
    from rig.model.mechanism_geometry import Arm, Free, Hexapod, Planar2
    from rig.recording.recording_folder import Recording

RETURNS = 0.5  # of the sum of its changes' sizes, within which a strut that changes comes back to where it was
MANY = 6  # changes beyond which they are not believed to be steps


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_recording_argument(parser)
    parser.add_argument(
        "--state",
        metavar="FILE",
        type=Path,
        help="go on from this state where it is there, and save it after the last pose",
    )
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="start from this calibration, not from rig.toml"
    )
    add_page_option(parser)
    recording_checks.add_anyway_option(parser)
    online_pose_learning.add_learner_options(parser)
    poses_from_readings.add_limb_options(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Learn the parameters from a recording's poses, one at a time, and say what jumped."""
    progress = Progress()
    progress("reading the recording", 0, 1)
    notice = recording_checks.print_notices(progress)
    source = poses_from_readings.limb_source(arguments)
    recording = read_recording(arguments)
    from calib.checks.recording_preparation import prepare_recording
    from calib.online.limb_pose_source import sample_by_limbs
    from calib.samples.recording_samples import sample_recording
    from rig.model.mechanism_kinds import require_hexapod

    look = prepare_recording(recording, arguments.anyway, notice)
    mechanism = require_hexapod(
        recording.design.mechanism, "on-line learning is for hexapods, not for a mechanism of kind {kind!r}"
    )
    state = arguments.outputs.file(arguments.state, own=True) if arguments.state else None
    page = page_path(arguments)

    from calib.online.information_filter import Online
    from calib.samples.confounded_conditions import confounds_of_recordings

    calibration = _calibration(arguments.calibration, mechanism) if arguments.calibration else None
    sampled = (
        partial(sample_recording, recording, progress=progress, on_corners=look)
        if source is None
        else partial(sample_by_limbs, recording, source, progress, notice)
    )
    recording.commanded()  # a recording that nobody commanded is refused
    confounds = confounds_of_recordings([recording])
    assert confounds is not None
    known_of = _of_calibrations(arguments, recording, calibration)
    if arguments.learner != online_pose_learning.WATCHING:
        followed, arguments.result = online_pose_learning.learn_poses(
            arguments, recording, sampled, calibration, state, progress
        )
        followed = replace(followed, confounds=confounds, calibrations=known_of)
        from calib.report.online_and_limb_pages import online_verdict

        verdict = online_verdict(followed)
        print(verdict.line)
        arguments.result |= {"verdict": verdict.tree(), "confounds": confounds.tree()}
        print(confounds.line())
        _show(page, arguments, recording, followed)
        return
    online_pose_learning.refuse_other_learners_settings(arguments)
    known = Online.load(arguments.state) if arguments.state is not None and arguments.state.exists() else None
    learner, learnt, arguments.result = learn_recording(recording, sampled, known, calibration, progress, known_of)
    assert learnt.confounds is not None
    arguments.result["confounds"] = learnt.confounds.tree()
    print(learnt.confounds.line())
    if state is not None:
        learner.save(state)
        print(f"written: {arguments.state}")
    _show(page, arguments, recording, learnt)


def _of_calibrations(arguments: Namespace, recording: Recording, calibration: Calibration | None) -> OfCalibrations:
    """OfCalibrations made from a recording that are beside it; and what the one that learning starts from leaves
    unexplained.
    """
    from calib.certification.calibration_evidence import calibration_evidence
    from calib.diagnosis.calibration_left_out_physics import unexplained_and_refuted_calibrations
    from rig.recording.recording_frames import content_hashes

    beside = unexplained_and_refuted_calibrations(
        content_hashes(recording), calibration_and_effect_files.neighbouring_json_files(recording.folder), True
    )
    if calibration is None:
        return beside
    start = calibration_evidence(
        calibration, calibration_and_effect_files.read_refutations(arguments.calibration)
    ).unexplained
    return beside._replace(unexplained=tuple(dict.fromkeys([*beside.unexplained, *start])))


def _show(page: Path | None, arguments: Namespace, recording: Recording, learnt: OnlineResult) -> None:
    """Write the page, where one is asked for."""
    if page is None:
        return
    from calib.report.online_and_limb_pages import write_online_page

    write_online_page(page, recording.name, learnt, page_links(arguments, arguments.page))
    print(f"written: {arguments.page}")


def learn_recording(
    recording: Recording,
    sampled: Callable[[], Sampled],
    known: Online | None,
    calibration: Calibration | None,
    progress: Progress,
    of_calibrations: OfCalibrations | None = None,
) -> tuple[Online, OnlineResult, Json]:
    """Learn a recording's new poses by the filter: (filter, result for the page, dict for --json); prints a summary.

    sampled : makes the Sampled of it; known : the filter to go on with, or None; calibration : where a new one starts
        from, or None
    of_calibrations : OfCalibrations made from the recording, None where nobody looked for any

    Raises RigError where no pose is left to learn
    """
    import numpy as np

    from calib.certification.calibration_evidence import ALONE
    from calib.models.platform.identification import geometric_parameters
    from calib.online.information_filter import Online
    from calib.report.online_and_limb_pages import online_verdict
    from calib.samples.confounded_conditions import confounds_of_recordings
    from rig.model.mechanism_kinds import require_hexapod
    from rig.recording.recording_frames import content_hashes, hashes_of_frames

    of, mechanism = content_hashes(recording), require_hexapod(recording.design.mechanism)
    learnt = (
        known.data
        if known is not None
        else set()
        if calibration is None
        else set(calibration.provenance.get("data", ()))
    )
    fresh = unlearnt_frame_numbers(recording, of, learnt)
    found = sampled()
    samples = unlearnt_samples(found.samples, fresh, recording)
    shared = samples.common.shape[2]
    before = known.number if known is not None else 0
    if known is not None:
        known.new_session(shared)
    learner = known or (
        Online(mechanism, shared)
        if calibration is None
        else Online(require_hexapod(calibration.correction.fitted), shared, calibration.scatter, calibration.covariance)
    )
    learner.data = learnt | set(hashes_of_frames(of, fresh))
    commands = samples.commanded - (0 if calibration is None else calibration.correction.rho(samples.commanded))
    updates = []
    for x, T, C, B in zip(commands, samples.T_base_platform, samples.covariance, samples.common):
        updates.append(learner.update(x, T, C, B))
        progress("learning", len(updates), len(samples))
    moved = float(np.sqrt(np.mean((learner.p - geometric_parameters(mechanism)) ** 2)))
    taught = replace(
        _learnt(learner, updates, samples.frame, found.source, moved),
        confounds=confounds_of_recordings([recording]),
        calibrations=of_calibrations or ALONE,
    )
    print(online_verdict(taught).line)
    _tell(
        learner,
        updates,
        samples.frame,
        f"{len(samples)} poses from {found.source}, learnt one at a time"
        + (f" after {before} before" if before else ""),
    )
    print(f"joints and zeros moved by {moved * 1e3:.4f} mm RMS from rig.toml")
    print_frames_without_pose(found.measurement)
    return learner, taught, {**_result(learner, updates, samples.frame), "verdict": online_verdict(taught).tree()}


def _learnt(learner: Online, updates: list[Update], frames: Integers, source: str, moved: float) -> OnlineResult:
    """OnlineResult of updates by poses of frames (n,). moved : m RMS from rig.toml"""
    import numpy as np

    from calib.report.online_and_limb_pages import OnlineResult

    first = updates[0].number
    changes = [change for update in updates for change in update.changes]
    returning = {change.strut for change in changes if _changes_cancel(changes, change.strut)}
    told = [
        change_sentence(change, frames[max(change.onset - first, 0)], change.strut in returning) for change in changes
    ]
    dropped = [int(frames[number - first]) for update in updates for number in update.dropped if number >= first]
    return OnlineResult(
        frames,
        np.array([update.innovation for update in updates]),
        source,
        told,
        dropped,
        float(np.sqrt(np.mean(np.diag(learner.covariance)))),
        moved,
        [
            f"strut {strut} goes back and forth: play or whatever else depends on the direction, no missed steps"
            for strut in sorted(strut for strut in returning if strut is not None)
        ],
    )


def _changes_cancel(changes: Sequence[Change], strut: int | None) -> bool:
    """Whether a strut's changes take each other back, as play does and steps that were missed do not."""
    sizes = [change.size for change in changes if change.strut == strut and isinstance(change.size, float)]
    return len(sizes) > 1 and abs(sum(sizes)) < RETURNS * sum(map(abs, sizes))


def _tell(learner: Online, updates: list[Update], frames: Integers, learnt: str) -> None:
    """Say what poses of frames (n,) have taught: how well joints and zeros are known, what jumped, what was left
    out.
    """
    import numpy as np

    changes, first = [change for update in updates for change in update.changes], updates[0].number
    count = len(changes)
    sigma = np.sqrt(np.mean(np.diag(learner.covariance)))
    print(f"{_counted(count)} in {learnt}; joints and zeros are known to {sigma * 1e3:.4f} mm RMS")
    if count > MANY:
        print("these are no few steps: something acts on the struts or the measurement that the geometry lacks")
    for update in updates:
        for change in update.changes:
            onset, cancelled = frames[max(change.onset - first, 0)], _changes_cancel(changes, change.strut)
            print(f"frame {frames[update.number - first]}: {change_sentence(change, onset, cancelled)}")
        for number in update.dropped:
            print(f"frame {frames[number - first]}: its pose agrees with no other and is left out")
    innovation = np.sqrt(np.mean([update.innovation @ update.innovation / 6 for update in updates if not update.held]))
    print(f"innovations are {innovation:.3f} of what was expected (1 where nothing is left out)")


def _result(learner: Online, updates: list[Update], frames: Integers) -> Json:
    """What --json prints. frames : (n,) of the updates"""
    import numpy as np

    first = updates[0].number
    jumps = [
        {
            "frame": int(frames[max(change.onset - first, 0)]),
            "found_at": int(frames[update.number - first]),
            "kind": change.kind,
            "strut": change.strut,
            "size": np.asarray(change.size).tolist(),
            "sigma": np.asarray(change.sigma).tolist(),
        }
        for update in updates
        for change in update.changes
    ]
    whitened = [update.innovation @ update.innovation / 6 for update in updates if not update.held]
    return {
        "schema": "online/1",
        "poses": len(updates),
        "changes": jumps,
        "left_out": [int(frames[number - first]) for update in updates for number in update.dropped],
        "sigma_rms_m": float((learner.covariance.diagonal().mean()) ** 0.5),
        "innovation": float((sum(whitened) / max(len(whitened), 1)) ** 0.5),
    }


def _counted(changes: int) -> str:
    return "nothing jumped" if not changes else f"{changes} change{'s' if changes > 1 else ''}"


def _calibration(path: Path, mechanism: Hexapod | Planar2 | Arm | Free) -> Calibration:
    """Calibration of a hexapod. Raises RigError for another mechanism's."""
    from calib.files import calibration_file

    found = calibration_file.load(path)
    if found.correction.fitted.kind != mechanism.kind:
        raise RigError(
            f"{path} is a calibration of a mechanism of kind {found.correction.fitted.kind!r}, the "
            f"recording's is {mechanism.kind!r}"
        )
    found.refuse_physics("learning on-line")
    return found


def change_sentence(change: Change, frame: int, returns: bool = False) -> str:
    """Sentence about a change. frame : number of the first frame after it; returns : whether later changes undo it"""
    if not isinstance(change.size, float):
        position, rotation = (float((part**2).sum() ** 0.5) for part in (change.size[:3], change.size[3:]))
        return (
            f"from frame {frame} on the measured poses are moved against the base by {position * 1e3:.3f} mm "
            f"and {rotation * 1e3:.3f} mrad: "
            "a camera or the base was knocked"
        )
    if returns:
        return (
            f"from frame {frame} on strut {change.strut} is longer by {change.size * 1e3:+.4f} +- "
            f"{change.sigma * 1e3:.4f} mm, and goes back: play"
        )
    cause = (
        "missed steps or a slipped joint"
        if change.kind == "strut"
        else "a knocked joint, the amount differs from pose to pose"
    )
    return (
        f"from frame {frame} on strut {change.strut} is longer by {change.size * 1e3:+.4f} +- "
        f"{change.sigma * 1e3:.4f} mm: {cause}"
    )
