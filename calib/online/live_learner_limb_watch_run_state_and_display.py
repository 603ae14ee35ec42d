"""Live learner of a run, its watch of measuring limbs, the run's state and its display.

The learner sees jumps and drift; limbs are held against vision.
"""

from copy import copy
from dataclasses import dataclass, field, replace
from typing import Protocol, TypedDict

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification import (
    loop_closure_checks_of_redundant_measuring_limbs,
    measuring_limb_calibration_slips_and_vision_agreement,
)
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction
from calib.online.hexapod_information_filter import Online
from calib.online.information_filter_kernels_and_change_detection import Change
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.driving.move_and_record_loop import RecordedFrame
from rig.driving.run_journal import Arrival, Departure, Ended, Exposed, PositionUnknown, Remark, Resumed, Row
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.pose import pose_difference
from vision.reading.live_measurement_and_corner_refit import Sight
from vision.reading.moved_camera_and_covered_marker_alarms import Alarm

LATEST = 5  # poses whose median error must exceed the tolerance: one is a bad measurement, five are a drift


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """What one pose said. error : (6,) m and rad, measured less what was expected of the command, in the platform's
    frame
    struts : (6,) m, commanded less what the nominal model says for the measured pose; innovation : RMS of what was
        expected, 1 is normal
    changes : jumps found with it; unsure : whether it disagrees and the next ones will say why; drift : (m, rad) beyond
        the tolerance, or None
    """

    error: Floats
    struts: Floats
    innovation: float
    changes: tuple[Change, ...]
    unsure: bool
    drift: tuple[float, float] | None


class Learner:
    """Learns from a run's poses. nominal : Hexapod; calibration : to start from, or None; tolerance : (m, rad) of
    drift, or None
    shared : draws that all poses' errors have in common."""

    def __init__(
        self,
        nominal: Hexapod,
        calibration: Calibration | None = None,
        tolerance: tuple[float, float] | None = None,
        shared: int = 0,
    ) -> None:
        self._nominal, self._tolerance = nominal, tolerance
        self._correction = calibration.correction if calibration else Correction(nominal, nominal, (None,) * 6)
        self._online = (
            Online(self._correction.fitted, shared, calibration.scatter, calibration.covariance)
            if calibration
            else Online(nominal, shared)
        )
        self._last_saved = copy(self._online)
        self._calibrated, self._errors = calibration is not None, list[Floats]()
        self._drifting = False

    @property
    def hexapod(self) -> Hexapod:
        """The geometry as learnt by now."""
        return self._online.mechanism

    def expected(self, commanded: Floats) -> RigidTransform:
        """T_base_platform that commanded lengths (6,) m should give, by what is known so far."""
        return mechanisms.kinematics_of(self._nominal).forward(
            commanded - self._correction.rho(commanded), self._online.mechanism
        )

    def save(self) -> None:
        """Remember what is known now."""
        self._last_saved = copy(self._online)

    def restore(self) -> None:
        """Know again what was known when it was last kept, nothing of what came since; poses to come share no
        errors.
        """
        self._online = copy(self._last_saved)
        self._online.new_session()

    def learn(
        self, commanded: Floats, T_base_platform: RigidTransform, covariance: Floats, common: Floats | None = None
    ) -> Learnt:
        """One pose. commanded : (6,) m; covariance : (6, 6) tangent on the right; common : (6, shared) factor of errors
        that poses share.

        Raises RigError as `Online.update` does.
        """
        expected = self.expected(commanded)
        error = pose_difference(expected, T_base_platform)
        struts = commanded - mechanisms.kinematics_of(self._nominal).inverse(T_base_platform, self._nominal)
        update = self._online.update(commanded - self._correction.rho(commanded), T_base_platform, covariance, common)
        fresh = (
            self._drift(pose_difference(self._correction.predict(commanded), T_base_platform))
            if self._calibrated
            else None
        )
        return Learnt(
            error, struts, float(np.sqrt(update.innovation @ update.innovation / 6)), update.changes, update.held, fresh
        )

    def _drift(self, error: Floats) -> tuple[float, float] | None:
        """(m, rad) of the drift from the calibration, once, when it leaves the tolerance."""
        self._errors = [*self._errors[1 - LATEST :], error]
        if self._tolerance is None or len(self._errors) < LATEST:
            return None
        middle = np.median(self._errors, axis=0)
        size = float(np.linalg.norm(middle[:3])), float(np.linalg.norm(middle[3:]))
        before, self._drifting = self._drifting, size[0] > self._tolerance[0] or size[1] > self._tolerance[1]
        return size if self._drifting and not before else None


class LimbWatch:
    """Measuring limbs read as a run goes: once they are known from enough poses, every further one must agree with
    vision.
    """

    def __init__(self, design: Design) -> None:
        self._design, self._stated = (
            design,
            measuring_limb_calibration_slips_and_vision_agreement.stated_limbs(design),
        )
        self._home = measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design).home
        self.channels = self._stated.channels
        self._read: list[tuple[Floats, RigidTransform, Floats]] = []
        self._limbs: loop_closure_checks_of_redundant_measuring_limbs.Limbs | None = None
        self._agreed = True

    def take(self, lengths: Floats, T_base_platform: RigidTransform, covariance: Floats) -> bool:
        """Whether limbs that read lengths (limbs,) m newly disagree with vision's pose and its covariance (6, 6)."""
        if self._limbs is None:
            self._read.append((lengths, T_base_platform, covariance))
            if len(self._read) == measuring_limb_calibration_slips_and_vision_agreement.FEWEST:
                n = np.arange(measuring_limb_calibration_slips_and_vision_agreement.FEWEST)
                read, poses, covariances = zip(*self._read)
                T = RigidTransform.concatenate(poses)
                chosen = loop_closure_checks_of_redundant_measuring_limbs.best_six_limbs(self._stated, self._home, T)
                samples = Samples(
                    n,
                    n.astype(float),
                    np.array(read)[:, chosen],
                    T,
                    np.array(covariances),
                    np.zeros((measuring_limb_calibration_slips_and_vision_agreement.FEWEST, 6, 0)),
                )
                limbs, _ = measuring_limb_calibration_slips_and_vision_agreement.calibrated_limbs_and_identification(
                    samples,
                    measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(self._design, chosen),
                    self._stated.length_sigma,
                )
                self._limbs = replace(limbs, chosen=chosen)
            return False
        T = self._limbs.pose(lengths)
        own, common = self._limbs.uncertainty(T)
        before, self._agreed = (
            self._agreed,
            measuring_limb_calibration_slips_and_vision_agreement.vision_agrees_with_limbs(
                T_base_platform, covariance, T, own, common
            ),
        )
        return before and not self._agreed


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFrame:
    """A frame that was measured. delay : s from the end of its exposure to its pose; learnt : what the learner made of
    it, or None
    blur : {camera: px, width of the markers' edges}, a figure of focus; rms : px of its corners, {camera: px}."""

    shot: RecordedFrame
    sight: Sight
    learnt: Learnt | None
    delay: float
    rms: dict[str, float]
    blur: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class RunState:
    """What displays show. places_and_units : (place, "m" or "rad") of each axis
    phase : in words; frame, frames, step, steps : how far; left : s; lengths, goal : (axes,) m
    ranges : (axes, 2) m; alarms : the latest; seen : the latest MeasuredFrame, None before the first;
        frames is 0 where nobody knows how many there will be; ended : why, None while it goes
    activity : "starting", "moving", "holding" (the struts are to rest) or "ended"; then : what comes next, in words
    events : the latest (s, in words); readings : {channel: value} of the sensors; shot : the latest frame, measured or
        not, None before the first; question : (frame, in words) that the operator is asked, None for nothing
    """

    places_and_units: tuple[tuple[str, str], ...]
    phase: str
    frame: int
    frames: int
    step: int
    steps: int
    left: float
    lengths: Floats
    goal: Floats
    ranges: Floats
    alarms: tuple[Alarm, ...]
    seen: MeasuredFrame | None
    ended: str | None
    activity: str = "starting"
    then: str = ""
    events: tuple[tuple[float, str], ...] = ()
    readings: dict[str, float] = field(default_factory=dict)
    shot: RecordedFrame | None = None
    question: tuple[int, str] | None = None


class RunStateChanges(TypedDict, total=False):
    """Fields of a RunState that have changed."""

    phase: str
    frame: int
    frames: int
    step: int
    steps: int
    left: float
    lengths: Floats
    goal: Floats
    ranges: Floats
    alarms: tuple[Alarm, ...]
    seen: MeasuredFrame | None
    ended: str | None
    activity: str
    then: str
    events: tuple[tuple[float, str], ...]
    readings: dict[str, float]
    shot: RecordedFrame | None
    question: tuple[int, str] | None


def journal_row_in_words(row: Row, unit: str = "mm") -> str:
    """Journal row in words.

    It is for the log of a display; "" for what is no event. unit : name of a thousandth of the axes' m or rad
    """
    if isinstance(row, Departure):
        far = max(abs(goal - start) for goal, start in zip(row.goal, row.start))
        return f"to step {row.step + 1}, {far * 1e3:.1f} {unit}"
    if isinstance(row, Arrival):
        return f"at step {row.step + 1}" if row.reached else f"not at step {row.step + 1}"
    if isinstance(row, Exposed):
        return f"frame {row.frame}" + (" in motion" if row.times else "")
    if isinstance(row, Resumed):
        return f"resumed: {row.found}"
    if isinstance(row, Remark):
        return row.text
    if isinstance(row, PositionUnknown):
        return f"the position is not known: {row.reason}"
    if isinstance(row, Ended):
        return f"ended: {row.reason}" if row.reason else "done"
    return ""


class RunDisplay(Protocol):
    """Something that shows a run."""

    def show(self, state: RunState) -> None:
        """The run as it stands now."""

    def close(self) -> None:
        """The run is over."""
