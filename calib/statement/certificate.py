"""What a certificate states, from a calibration and recordings that it was not made from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.certify import conformity, tolerance_limits
from calib.certify.budget import Budget, budget, thermometer
from calib.certify.calibration import Calibration
from calib.certify.conformity import Conformity
from calib.certify.held_out import Figures, errors_of, figures
from calib.certify.held_poses import HeldPoses, held_poses
from calib.certify.promise import Bound, Cell, Promise, cells, promised
from calib.certify.repeats import Iso9283, Repeatability, iso9283, repeatability
from calib.certify.reversal import AxisTest, iso230
from calib.confounds import Confounds, of_recordings
from calib.pipeline import Sampled
from calib.pose_covariance import pose_covariance
from calib.statement.conditions import Conditions, Volume, conditions, volume
from rig.errors import NotEnoughData
from rig.notebook import shown
from rig.recording import Recording



@dataclass(frozen=True, slots=True)
class Asked:
    """coverage, confidence : of the promise; tolerances : {"position": m, "rotation": rad} to judge against, either or none
    scale : relative standard uncertainty of the targets' scale, None where nobody certified it; scale_source : who did, in words."""

    coverage: float = 0.95
    confidence: float = 0.95
    tolerances: tuple[tuple[str, float], ...] = ()
    scale: float | None = None
    scale_source: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """What is certified. machine : its kind; calibrated_from : recording, in words; asked : Asked; promise, cells : whole volume and boxes of it
    errors : (n, 6) m and rad of the poses that count, for drawing; before, after : Figures by the owner's model and calibrated, of those
    provenance : {what: value} of inputs' hashes, versions, seed and arguments; confounds : of the held-out recordings."""

    machine: str
    asked: Asked
    promise: Promise
    cells: tuple[Cell, ...]
    volume: Volume
    repeatability: Repeatability
    iso9283: Iso9283
    iso230: tuple[AxisTest, ...]
    conformity: tuple[Conformity, ...]
    budget: Budget
    conditions: Conditions
    errors: np.ndarray
    before: Figures
    after: Figures
    provenance: dict[str, Any]
    confounds: Confounds | None = None

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        from calib.statement import words  # which stands on this

        return shown(words.promise_line(self), [
            words.scale_line(self), words.volume_line(self), *words.rest_lines(self), *words.conformity_lines(self)])


def certified(calibration: Calibration, held: Sequence[tuple[Recording, Sampled]], asked: Asked, provenance: dict[str, Any],
              rng: np.random.Generator) -> Certificate:
    """Certificate of a Calibration by recordings held out. rng : numpy Generator, for the draws of shared errors

    Raises NotEnoughData where these have too few configurations at rest
    """
    poses = together(calibration, held)
    promise = promised(poses, asked.coverage, asked.confidence, asked.scale or 0.0, rng)
    again = repeatability(poses)
    at = poses.first
    return Certificate(calibration.correction.nominal.kind, asked, promise, cells(poses, asked.coverage, asked.confidence, asked.scale or 0.0, rng),
                       volume(poses, calibration.correction.nominal), again, iso9283(poses), iso230(calibration.correction, poses),
                       _judged(poses, asked, rng), budget(poses, _model(calibration, poses), again,
                                                          [(s.samples, s.measurement) for _, s in held], asked.scale,
                              thermometer(calibration, [(recording, s.samples) for recording, s in held])),
                       conditions(poses, [recording for recording, _ in held], [s.source for _, s in held]),
                       poses.errors[at], figures(poses.plain[at]), figures(poses.errors[at]), provenance,
                       of_recordings([recording for recording, _ in held]))


def together(calibration: Calibration, held: Sequence[tuple[Recording, Sampled]]) -> HeldPoses:
    """HeldPoses of recordings under a calibration."""
    parts = []
    for recording, sampled in held:
        assert recording.commands is not None  # sample_recording refuses a recording without
        samples = calibration.told(recording, sampled.samples)
        plain, errors = errors_of(calibration.correction, samples)
        parts.append((samples, recording.commands, plain, errors))
    return held_poses(calibration.correction, parts)


def _model(calibration: Calibration, poses: HeldPoses) -> np.ndarray:
    """(n, 6, 6) of the parameters alone: what axes and poses scatter shows in the poses themselves."""
    geometry = Calibration(calibration.correction, calibration.covariance, np.zeros_like(calibration.scatter), (), (), None, {})
    return pose_covariance(geometry, poses.T_base_platform, poses.commanded)


def _judged(poses: HeldPoses, asked: Asked, rng: np.random.Generator) -> tuple[Conformity, ...]:
    if not asked.tolerances:
        return ()
    try:
        tolerance_limits.enough(len(poses.first), asked.coverage, conformity.GUARD)
    except NotEnoughData:
        return tuple(Conformity(name, value, float("nan"), 0.0, float("inf"), float("inf"), conformity.OPEN) for name, value in asked.tolerances)
    guarded = promised(poses, asked.coverage, conformity.GUARD, asked.scale or 0.0, rng)
    bounds: dict[str, Bound | None] = {"position": guarded.position, "rotation": guarded.rotation}
    out = []
    for name, value in asked.tolerances:
        bound = bounds[name]
        if bound is None:
            raise NotEnoughData("no rotation was measured, so none can be held against a tolerance")
        out.append(conformity.judged(name, value, bound))
    return tuple(out)
