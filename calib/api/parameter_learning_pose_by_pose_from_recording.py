"""On-line learning of parameters from a recording, pose by pose.

The current estimate, and sudden changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from calib.api.recording_check_combination_and_view import refuse_unfit_recording_and_make_corner_check
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.calibration_evidence_verdict_and_claim_check import OfCalibrations, calibration_evidence
from calib.diagnosis.left_out_physics_and_refutation_of_calibrations import unexplained_findings_and_refutations
from calib.online.forgetting_least_squares_kalman_and_gradient_learners import save_learner
from calib.online.hexapod_information_filter import Online
from calib.online.measuring_limb_poses_checked_by_vision import LimbSource, sample_recording_by_checked_measuring_limbs
from calib.online.parameter_learning_by_filter_or_learner import (
    FILTER,
    Learning,
    learn_by_filter,
    learn_by_simple_learner,
    resume_or_start_learner,
)
from calib.report.online_learning_and_limb_vision_agreement_pages import OnlineResult, online_verdict, write_online_page
from calib.samples.commanded_and_measured_pose_samples import Sampled, sample_recording
from calib.samples.position_confounds_and_poses_on_one_clock import confounds_of_recordings
from rig.array_and_json_types import Json
from rig.errors import RigError
from rig.formats.local_and_remote_input_files import json_files_in_same_folders_as
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    has_links,
    is_hexapod,
    is_redundant,
    require_axes,
    require_hexapod,
)
from rig.recording.frame_selection_and_content_hashes import content_hashes_of_frames
from rig.recording.recording_folder import Recording
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import OneLineRepr, Refutation, Verdict, result_html
from vision.api import Progress
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice, ignore_notice

OTHERS = "drifting"  # the learner of other machines than hexapods, where none is named


@dataclass(frozen=True, slots=True, eq=False)
class LearnOptions:
    """state : file of a state to go on from, where it is there, or None; calibration : to start from, None for
    rig.toml; calibration_name : of its file, for messages; refutations : what later recordings found against it
    learner : "filter", which names what jumped, or one of
        calib.online.forgetting_least_squares_kalman_and_gradient_learners, None for the filter of hexapods and
        "drifting" of other machines; setting : of such a one, None for its default
    limbs : measuring limbs as the source of poses, None for vision or poses.csv; anyway : whether to go on though a
    mistake makes results meaningless
    """

    state: Path | None = None
    calibration: Calibration | None = None
    calibration_name: str = "the calibration"
    refutations: Sequence[Refutation] = ()
    learner: str | None = None
    setting: float | None = None
    limbs: LimbSource | None = None
    anyway: bool = False


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LearningResult(OneLineRepr):
    """What a recording's poses taught. recording; found : Learning; online : the same with what it rests on."""

    recording: Recording
    found: Learning
    online: OnlineResult

    @property
    def learner(self) -> object:
        """The learner as it is after the last pose."""
        return self.found.learner

    @property
    def is_of_hexapod_filter(self) -> bool:
        """Whether a hexapod's information filter learnt, which reports itself."""
        return isinstance(self.found.learner, Online)

    @property
    def sampled(self) -> Sampled:
        """The poses that were learnt."""
        return self.found.sampled

    @property
    def verdict(self) -> Verdict:
        """The verdict on what was learnt."""
        return online_verdict(self.online)

    @property
    def confounds_line(self) -> str:
        """What the recording confounds, in words."""
        return "" if self.online.confounds is None else self.online.confounds.line()

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.found.lines)

    def tree(self) -> Json:
        """What `rig calibrate online --json` prints."""
        confounds = self.online.confounds
        return {
            **self.found.figures,
            "verdict": self.verdict.tree(),
            "confounds": None if confounds is None else confounds.tree(),
        }

    def save(self, path: Path) -> None:
        """Save the learner's state, to go on from: of a machine of a kinematics file beside that file."""
        learner = self.found.learner
        if isinstance(learner, Online):
            learner.save(path)
        else:
            save_learner(path, learner)

    def write_page(self, path: Path, links: Sequence[Link] = ()) -> None:
        """Write the page of it."""
        write_online_page(path, self.recording.name, self.online, links)


def learn(
    recording: Recording,
    options: LearnOptions = LearnOptions(),
    progress: Progress = lambda *_: None,
    notice: Notice = ignore_notice,
) -> LearningResult:
    """Learn from a recording's poses (LearningResult).

    Learnt one at a time, as `rig calibrate online` makes it.

    Poses that have been learnt before are left out.
    progress : called with (label, done, of); notice : with what is found on the way, in words
    Raises RigError for a machine that cannot be learnt, for a state of another learner, and where no pose is left
    """
    look = refuse_unfit_recording_and_make_corner_check(recording, options.anyway, notice)
    mechanism, calibration = require_axes(recording.design.mechanism), options.calibration
    name = options.learner or (FILTER if is_hexapod(mechanism) else OTHERS)
    _refuse_machine(recording, options, name)
    if calibration is not None:
        _refuse_unsuited(calibration, mechanism.kind, options.calibration_name)
    sampler = (
        partial(sample_recording, recording, progress=progress, on_corners=look)
        if options.limbs is None
        else partial(sample_recording_by_checked_measuring_limbs, recording, options.limbs, progress, notice)
    )
    recording.commanded()  # a recording that nobody commanded is refused
    evidence = _calibration_evidence(recording, calibration, options.refutations)
    if name == FILTER:
        known = Online.load(options.state) if options.state is not None and options.state.exists() else None
        found = learn_by_filter(recording, sampler, known, calibration, progress, notice)
    else:
        learner = resume_or_start_learner(name, options.setting, options.state, mechanism, calibration)
        found = learn_by_simple_learner(recording, sampler, learner, name, calibration, progress, notice)
    online = replace(found.online, confounds=confounds_of_recordings([recording]), calibrations=evidence)
    return LearningResult(recording, found, online)


def _refuse_machine(recording: Recording, options: LearnOptions, learner: str) -> None:
    """Raise RigError for a machine that a learner does not learn, and for one whose place nothing states."""
    mechanism, instrument = recording.design.mechanism, recording.design.instrument
    if learner == FILTER:
        require_hexapod(mechanism, "the learner that names jumps is for hexapods, not for a mechanism of kind {kind!r}")
    if is_redundant(mechanism) or hand_names(mechanism):
        several = f"{len(mechanism.axes)} struts" if is_redundant(mechanism) else "several hands"
        raise RigError(f"on-line learning does not support a machine with {several}")
    if instrument is not None and instrument.kind in ("distance", "direction"):
        raise RigError(f"on-line learning requires poses, positions or orientations, not a {instrument.kind}")
    started = options.calibration is not None or (options.state is not None and options.state.exists())
    unplaced = instrument is None or "free" in (instrument.base, instrument.tool)
    if has_links(mechanism) and unplaced and not started:
        raise RigError("where the arm stands is not known: start on-line learning from a calibration (--calibration)")


def learn_from_samples(
    recording: Recording,
    sampled: Sampled,
    state: Path | None = None,
    progress: Progress = lambda *_: None,
    notice: Notice = ignore_notice,
) -> LearningResult:
    """Learn from samples already measured (LearningResult).

    Parameters are learnt by the filter; samples are measured as by limbs.
    state : as of LearnOptions; sampled : of recording
    """
    known = Online.load(state) if state is not None and state.exists() else None
    found = learn_by_filter(recording, lambda: sampled, known, None, progress, notice)
    return LearningResult(recording, found, replace(found.online, confounds=confounds_of_recordings([recording])))


def _refuse_unsuited(calibration: Calibration, kind: str, name: str) -> None:
    """Raise RigError for a calibration of another kind of mechanism, and for one with physics."""
    if calibration.correction.fitted.kind != kind:
        raise RigError(
            f"{name} is a calibration of a mechanism of kind {calibration.correction.fitted.kind!r}, the "
            f"recording's is {kind!r}"
        )
    calibration.refuse_physics("learning on-line")


def _calibration_evidence(
    recording: Recording, calibration: Calibration | None, refutations: Sequence[Refutation]
) -> OfCalibrations:
    """OfCalibrations made from a recording that are in its folder's parent; and what the one that learning starts from
    leaves unexplained.
    """
    findings_and_refutations = unexplained_findings_and_refutations(
        content_hashes_of_frames(recording), json_files_in_same_folders_as([recording.folder]), True
    )
    if calibration is None:
        return findings_and_refutations
    start = calibration_evidence(calibration, refutations).unexplained
    return findings_and_refutations._replace(
        unexplained=tuple(dict.fromkeys([*findings_and_refutations.unexplained, *start]))
    )
