"""Learning of parameters from a recording's poses.

One pose at a time: by the filter, or by a simple learner.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.models.calibration_covariance_parameters import covariance_parameters
from calib.online.forgetting_least_squares_kalman_and_gradient_learners import LEARNERS, Learner, load_learner
from calib.online.hexapod_information_filter import Online, Update
from calib.online.information_filter_kernels_and_change_detection import Change, change_sentence
from calib.report.online_learning_and_limb_vision_agreement_pages import MANY, OnlineResult
from calib.samples.commanded_and_measured_pose_samples import Sampled
from rig.array_and_json_types import Floats, Integers, Json
from rig.errors import RigError
from rig.formats.numbers_and_units import count_text
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    geometric_parameters,
    has_struts,
    is_parallel,
    require_axes,
    require_hexapod,
)
from rig.recording.frame_selection_and_content_hashes import (
    Marks,
    content_hashes_of_frames,
    frames_with_known_hashes,
    sorted_hashes_of_frames,
)
from rig.recording.recording_folder import Recording
from vision.api import Progress
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice

RETURNS = 0.5  # of the sum of its changes' sizes, within which a strut that changes comes back to where it was
NONE = np.zeros(0)
FILTER = "filter"  # the learner that names what jumped; the others are in LEARNERS
Sampler = Callable[[], Sampled]


@dataclass(frozen=True, slots=True, eq=False)
class Learning:
    """What a recording's poses taught. learner : as it is after the last pose; online : the same for the page; lines :
    in words, after the verdict; figures : for JSON; sampled : the poses, those learnt before among them
    """

    learner: Online | Learner
    online: OnlineResult
    lines: tuple[str, ...]
    figures: Json
    sampled: Sampled


def learn_by_filter(
    recording: Recording,
    sampler: Sampler,
    previous_filter: Online | None,
    calibration: Calibration | None,
    progress: Progress,
    notice: Notice,
) -> Learning:
    """Learning of a recording's new poses by the filter.

    sampler : samples the recording; previous_filter : the filter to go on with, or None; calibration : where a new one
        starts from, or None; notice : called with how many frames were learnt before
    Raises RigError where no pose is left to learn
    """
    before = 0 if previous_filter is None else previous_filter.number
    learnt = _known_frames(calibration) if previous_filter is None else previous_filter.data
    fresh, found, commands = _new_poses(recording, sampler, learnt, calibration, notice)
    samples, mechanism = found.samples, require_hexapod(recording.design.mechanism)
    shared = samples.common.shape[2]
    if previous_filter is not None:
        previous_filter.new_session(shared)
    learner = previous_filter or (
        Online(mechanism, shared)
        if calibration is None
        else Online(require_hexapod(calibration.correction.fitted), shared, calibration.scatter, calibration.covariance)
    )
    learner.data = learnt | fresh
    updates = []
    for x, T, C, B in zip(commands, samples.T_base_platform, samples.covariance, samples.common):
        updates.append(learner.update(x, T, C, B))
        progress("learning", len(updates), len(samples))
    moved = _rms_text(learner.p - geometric_parameters(mechanism))
    count = f"{count_text(len(samples), 'pose')} from {found.source}, learnt one at a time{_after(before)}"
    return Learning(
        learner,
        _online_result(learner, updates, samples.frame, found.source, _moved_line(mechanism, moved)),
        (*_filter_lines(learner, updates, samples.frame, count), _moved_line(mechanism, moved)),
        _filter_figures(learner, updates, samples.frame),
        found,
    )


def learn_by_simple_learner(
    recording: Recording,
    sampler: Sampler,
    learner: Learner,
    name: str,
    calibration: Calibration | None,
    progress: Progress,
    notice: Notice,
) -> Learning:
    """Learning of a recording's new poses by a simple learner.

    It is that of this name in LEARNERS.
    All else as by the filter.
    """
    before = learner.number
    fresh, found, commands = _new_poses(recording, sampler, learner.data, calibration, notice)
    samples = found.samples
    learner.data |= fresh
    rows = []
    for x, T, C in zip(commands, samples.T_base_platform, samples.total_covariance()):
        rows.append(learner.update(x, T, C))
        progress("learning", len(rows), len(samples))
    errors, parameters, free = np.array(rows), learner.parameters, learner.free
    stated = covariance_parameters(require_axes(recording.design.mechanism)).values
    angle = np.array(parameters.units)[free] == "rad"
    change = ((learner.p - stated) * parameters.scale)[free]
    spread = None if learner.covariance is None else np.sqrt(np.diag(learner.covariance)) * parameters.scale[free]
    sigma = None if spread is None else _rms_text(spread[~angle], spread[angle])
    moved = _rms_text(change[~angle], change[angle])
    first, last = _rms_of_first_and_last_quarter(errors)
    figures = {
        "schema": "followed/1",
        "learner": name,
        learner.SETTING: float(learner.setting),
        "poses": len(samples),
        "poses_before": before,
        "first_quarter": first,
        "last_quarter": last,
        "moved_rms_m": _rms(change[~angle]),
        "moved_rms_rad": _rms(change[angle]),
        "sigma_rms_m": None if spread is None else _rms(spread[~angle]),
        "sigma_rms_rad": None if spread is None else _rms(spread[angle]),
    }
    lines = (
        f"{count_text(len(samples), 'pose')} from {found.source}, learnt one at a time by {name} "
        f"({learner.SETTING} {learner.setting:g}){_after(before)}",
        f"poses deviated from the prediction by {first:.3g} standard deviations RMS in the first quarter, by "
        f"{last:.3g} in the last (1 once converged)",
        _moved_line(learner.nominal, moved) + ("" if sigma is None else f", known to {sigma}"),
    )
    known = None if sigma is None else f"{_parameter_words(learner.nominal)} are known to {sigma}"
    result = OnlineResult(samples.frame, errors, found.source, (), (), known, _moved_line(learner.nominal, moved))
    return Learning(learner, result, lines, figures, found)


def resume_or_start_learner(
    name: str, setting: float | None, state: Path | None, mechanism: Commanded, calibration: Calibration | None
) -> Learner:
    """Learner of a name, resumed or started.

    It is resumed from a state that is there, or started anew.
    Raises RigError where the two differ.
    """
    kind = LEARNERS[name]
    if state is not None and state.exists():
        learner = load_learner(state)
        if type(learner) is not kind:
            raise RigError(f"{state} is the state of another learner than {name}")
        if setting is not None and setting != learner.setting:
            raise RigError(f"{state} goes on with {learner.SETTING} {learner.setting:g}, not with {setting:g}")
        return learner
    nominal = mechanism if calibration is None else require_axes(calibration.correction.fitted)
    try:
        learner = kind(nominal) if setting is None else kind(nominal, setting)
    except ValueError as error:
        raise RigError(f"--{kind.SETTING}: {error}") from None
    if calibration is not None:
        learner.start_from(calibration.covariance)
        learner.data = _known_frames(calibration)
    return learner


def _new_poses(
    recording: Recording, sampler: Sampler, learnt: set[str], calibration: Calibration | None, notice: Notice
) -> tuple[set[str], Sampled, Floats]:
    """(hashes of the frames not yet learnt, Sampled of their poses, (n, axes) commands with a calibration's correction
    taken off). Raises RigError where none is left: what is learnt twice counts twice
    """
    marks = content_hashes_of_frames(recording)
    frames, repeated = recording.exposures.times()[0], frames_with_known_hashes(marks, learnt)
    _require_new_frames(recording, marks, repeated)
    if repeated:
        notice(f"{len(repeated)} of {len(frames)} frames have been learnt already and are skipped")
    fresh = [frame for frame in frames.tolist() if frame not in set(repeated)]
    found = sampler()
    chosen = np.isin(found.samples.frame, fresh)
    if not chosen.any():
        raise RigError(f"none of the {len(fresh)} frames of {recording.folder} that have not been learnt has a pose")
    samples = found.samples.take(chosen)
    commands = samples.commanded - (0 if calibration is None else calibration.correction.rho(samples.commanded))
    return set(sorted_hashes_of_frames(marks, fresh)), replace(found, samples=samples), commands


def _require_new_frames(recording: Recording, marks: Marks, known: Sequence[int]) -> None:
    if len(known) == len(marks) > 0:
        raise RigError(
            f"all {len(marks)} frames of {recording.folder} with observations have been learnt already; "
            "once more they would be counted twice"
        )


def _known_frames(calibration: Calibration | None) -> set[str]:
    """Hashes of the frames that a calibration was made from."""
    return set() if calibration is None else set(calibration.provenance.get("data", ()))


def _rms(values: Floats) -> float | None:
    """RMS of values (n,), None of none."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _rms_text(lengths: Floats, angles: Floats = NONE) -> str:
    """RMS of lengths (n,) m and angles (n,) rad, of what there is, in words."""
    parts = [(_rms(lengths), "mm"), (_rms(angles), "mrad")]
    return " and ".join(f"{value * 1e3:.4f} {unit}" for value, unit in parts if value is not None) + " RMS"


def _moved_line(mechanism: Commanded, moved: str) -> str:
    """Line on how far parameters moved; those of arms and chains count from where learning began."""
    if not is_parallel(mechanism):
        return f"parameters moved by {moved} from where learning began"
    return f"{_parameter_words(mechanism)} moved by {moved} from rig.toml"


def _parameter_words(mechanism: Commanded) -> str:
    return "joints and zeros" if has_struts(mechanism) else "parameters"


def _after(before: int) -> str:
    return f" after {before} before" if before else ""


def _rms_of_first_and_last_quarter(errors: Floats) -> tuple[float, float]:
    """RMS of errors (n, 6) whitened in the first quarter of the poses, and in the last."""
    quarter = max(len(errors) // 4, 1)
    return float((errors[:quarter] ** 2).mean() ** 0.5), float((errors[-quarter:] ** 2).mean() ** 0.5)


def _online_result(
    learner: Online, updates: Sequence[Update], frames: Integers, source: str, moved: str
) -> OnlineResult:
    """OnlineResult of updates by poses of frames (n,). moved : how far parameters moved, in words"""
    first = updates[0].number
    changes = [change for update in updates for change in update.changes]
    returning = {change.strut for change in changes if _changes_cancel(changes, change.strut)}
    sentences = [
        change_sentence(change, frames[max(change.onset - first, 0)], change.strut in returning) for change in changes
    ]
    dropped = [int(frames[number - first]) for update in updates for number in update.dropped if number >= first]
    return OnlineResult(
        frames,
        np.array([update.innovation for update in updates]),
        source,
        sentences,
        dropped,
        f"joints and zeros are known to {_rms_text(np.sqrt(np.diag(learner.covariance)))}",
        moved,
        [
            f"strut {strut} alternates: play or another effect of the direction, not missed steps"
            for strut in sorted(strut for strut in returning if strut is not None)
        ],
    )


def _changes_cancel(changes: Sequence[Change], strut: int | None) -> bool:
    """Whether a strut's changes take each other back, as play does and steps that were missed do not."""
    sizes = [change.size for change in changes if change.strut == strut and isinstance(change.size, float)]
    return len(sizes) > 1 and abs(sum(sizes)) < RETURNS * sum(map(abs, sizes))


def _filter_lines(learner: Online, updates: Sequence[Update], frames: Integers, count: str) -> list[str]:
    """Lines about what poses of frames (n,) taught: how well joints and zeros are known, what jumped, what was left
    out. count : of the poses, in words
    """
    changes, first = [change for update in updates for change in update.changes], updates[0].number
    sigma = np.sqrt(np.mean(np.diag(learner.covariance)))
    jumped = f"{len(changes)} change{'s' if len(changes) > 1 else ''}" if changes else "nothing jumped"
    lines = [f"{jumped} in {count}; joints and zeros are known to {sigma * 1e3:.4f} mm RMS"]
    if len(changes) > MANY:
        lines.append("these are many steps: an unmodelled effect acts on the struts or the measurement")
    for update in updates:
        for change in update.changes:
            onset, cancelled = frames[max(change.onset - first, 0)], _changes_cancel(changes, change.strut)
            lines.append(f"frame {frames[update.number - first]}: {change_sentence(change, onset, cancelled)}")
        lines += [
            f"frame {frames[number - first]}: its pose is an outlier and is excluded" for number in update.dropped
        ]
    innovation = np.sqrt(np.mean([update.innovation @ update.innovation / 6 for update in updates if not update.held]))
    return [*lines, f"innovations are {innovation:.3f} of what was expected (1 if the model is complete)"]


def _filter_figures(learner: Online, updates: Sequence[Update], frames: Integers) -> Json:
    """Figures of updates by poses of frames (n,), as JSON has them."""
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
