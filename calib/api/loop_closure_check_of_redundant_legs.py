"""Loop closure check of redundant legs.

Six lengths give the platform's pose, the others are checked against it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.certification import (
    loop_closure_checks_of_redundant_measuring_limbs,
    measuring_limb_calibration_slips_and_vision_agreement,
)
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.online.accepted_measuring_limbs_file import Accepted
from rig.array_and_json_types import Floats, Integers, Json
from rig.errors import RigError
from rig.formats.numbers_and_units import count_text
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod
from rig.model.mechanisms.redundant_strut_best_six_legs_and_loop_closures import (
    LegClosures,
    RedundantLegs,
    best_six_leg_indices,
    combine_leg_sets,
    leg_closures,
    leg_lengths_and_pose_and_base_jacobians,
)
from rig.recording.corner_and_pose_csv_tables import write_table
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html

EXACT = 1e-7  # m, of a commanded length: controllers resolve steps, and a calibration's scatter may be none
STRANGE = 5.0  # standard deviations, RMS over the poses, beyond which a closure is not what is expected


@dataclass(frozen=True, slots=True, eq=False)
class LoopClosureOptions:
    """use : names of the six legs that give the pose, None for the six that determine it best; calibration : of the
    struts, None for rig.toml; limbs : as accepted, None for rig.toml
    """

    use: tuple[str, ...] | None = None
    calibration: Calibration | None = None
    limbs: Accepted | None = None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LoopClosureResult(OneLineRepr):
    """legs; closures : of those that do not give the pose; frames : (n,) of the poses; chosen : (6,) indices of the
    legs that give it; requested : whether these were named
    """

    legs: RedundantLegs
    closures: LegClosures
    frames: Integers
    chosen: Integers
    requested: bool

    @property
    def ratio(self) -> Floats:
        """(checks,) RMS closure over what is expected of it."""
        variance = np.einsum("nii->ni", self.closures.covariance)
        return np.sqrt((self.closures.error**2).mean(axis=0) / variance.mean(axis=0))

    @property
    def strange(self) -> bool:
        """Whether a leg closes worse than its errors and the geometry allow."""
        return bool(self.ratio.max() > STRANGE)

    @property
    def condition(self) -> Floats:
        """(n,) condition number of the legs that give the pose."""
        jacobians = leg_lengths_and_pose_and_base_jacobians(self.legs, self.closures.T_base_platform)[1]
        values = np.linalg.svd(jacobians[:, self.chosen], compute_uv=False)
        return values[:, 0] / values[:, -1]

    @property
    def explaining_leg(self) -> int:
        """Index of the leg that, were it alone wrong, would explain most."""
        return int(self.closures.share.argmax())

    def __str__(self) -> str:
        worst = int(self.ratio.argmax())
        name = self.legs.names[self.closures.checks[worst]]
        return (
            f"{count_text(len(self.frames), 'pose')}; {name} closes at {self.ratio[worst]:.2f} times what is expected"
        )

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self))

    def tree(self) -> Json:
        """What `rig limbs closures --json` prints."""
        legs = []
        for i, e, ratio in zip(self.closures.checks, self.closures.error.T, self.ratio):
            worst = int(abs(e).argmax())
            legs.append(
                {
                    "leg": self.legs.names[i],
                    "mean": float(e.mean()),
                    "rms": float((e**2).mean() ** 0.5),
                    "largest": float(e[worst]),
                    "frame": int(self.frames[worst]),
                    "times_expected": float(ratio),
                }
            )
        return {
            "schema": "closure/1",
            "unit": "m",
            "poses": len(self.frames),
            "pose_from": [self.legs.names[i] for i in self.chosen],
            "closures": legs,
            "explained_best_by": self.legs.names[self.explaining_leg],
        }

    def write(self, path: Path) -> None:
        """Write the closures (m) with their expected standard deviations, a row for each frame."""
        sigma = np.sqrt(np.einsum("nii->ni", self.closures.covariance))
        names = [self.legs.names[i] for i in self.closures.checks]
        rows = [
            ",".join([str(frame), *(f"{x:.4e}" for x in (*e, *u))])
            for frame, e, u in zip(self.frames, self.closures.error, sigma)
        ]
        write_table(path, ("frame", *(f"e_{name}" for name in names), *(f"u_{name}" for name in names)), rows)


def close_loops(recording: Recording, options: LoopClosureOptions = LoopClosureOptions()) -> LoopClosureResult:
    """Loop closure errors of a recording's legs, as LoopClosureResult.

    Of those beyond the six that give the pose.

    Measuring limbs next to the struts, as `rig limbs closures` makes it.

    Raises RigError for a recording without limbs' readings, and for other legs than it has
    """
    legs, frames, lengths = _legs(recording, options)
    first = np.arange(6, 12) if len(legs.names) >= 12 else np.arange(6)  # limbs give the pose well enough to choose by
    chosen = (
        _leg_numbers(options.use, legs)
        if options.use is not None
        else best_six_leg_indices(legs, leg_closures(legs, lengths, first).T_base_platform)
    )
    return LoopClosureResult(legs, leg_closures(legs, lengths, chosen), frames, chosen, options.use is not None)


def _legs(recording: Recording, options: LoopClosureOptions) -> tuple[RedundantLegs, Integers, Floats]:
    """(Legs of struts and limbs, frames (n,), lengths (n, legs) m as commanded and read)."""
    machine, stated = (
        require_hexapod(recording.design.mechanism),
        measuring_limb_calibration_slips_and_vision_agreement.stated_limbs(recording.design),
    )
    frames, lengths = measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(recording)
    n = len(stated.channels)
    every, _, values = recording.commanded()
    commanded = values[np.searchsorted(every, frames)]
    struts = ("l", machine, np.full(6, EXACT), np.zeros((42, 42)))
    limbs = ("m", stated, np.full(n, stated.length_sigma), np.zeros((7 * n, 7 * n)))
    calibration = options.calibration
    if calibration is not None:
        calibration.refuse_physics("closing legs")
        fitted = require_hexapod(calibration.correction.fitted)
        struts = ("l", fitted, np.hypot(calibration.scatter, EXACT), calibration.covariance)
        commanded = commanded - calibration.correction.rho(commanded)
    if options.limbs is not None:
        limbs = (
            "m",
            *loop_closure_checks_of_redundant_measuring_limbs.fitted_limbs_with_sigmas_and_covariance(
                options.limbs.limbs, stated
            ),
        )
    return combine_leg_sets([struts, limbs], machine.home), frames, np.hstack([commanded, lengths])


def _leg_numbers(names: Sequence[str], legs: RedundantLegs) -> Integers:
    """(6,) indices of legs by their names. Raises RigError for anything but six of them, each once"""
    plain = [name.strip() for name in names]
    if set(plain) - set(legs.names) or len(set(plain)) != 6 or len(plain) != 6:
        raise RigError(
            f"--use takes six different legs of {legs.names[0]} .. {legs.names[5]} and {legs.names[6]} .. "
            f"{legs.names[-1]}, not {','.join(names)!r}"
        )
    return np.array([legs.names.index(name) for name in plain])
