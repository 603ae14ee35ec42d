"""A calibration as it is kept: what corrects, how well its parameters are known, what it is worth, and where it came
from.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.certify.calibration_verdict import claim_lines
from calib.certify.held_out_errors import HeldOut
from calib.certify.workspace_claim import Claim
from calib.correct.correction import Correction
from calib.correct.physics import Physics
from calib.samples.confounded_conditions import Confounds
from calib.samples.pose_samples import Samples
from calib.workspace.workspace_cells import Workspace
from rig.errors import RigError
from rig.recording.recording_folder import Recording
from rig.report.notebook_display import result_html


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """correction : Correction, of an arm an ArmCorrection; covariance : (42, 42) m^2 of the fitted parameters, of an
    arm (12 + 5 n, 12 + 5 n) in the order of calib.models.arm.error_model; scatter : (6,) m of each strut beyond the
    poses' noise, of an arm (6,) m and rad of the pose; frames : numbers of the frames fitted; left_out : of those that
    did not agree
    held_out : HeldOut, or None where too few configurations were recorded to hold any out
    provenance : what went in, by which versions and arguments; claim : Claim, or None in files of before there was one
    physics : Physics that was found beyond the geometry and is undone with it, or None
    workspace : Workspace, what the correction does to it, or None in files of before it was worked out
    confounds : Confounds of the recording that was fitted, or None where no recording states them
    strut_covariance : (axes, axes) m^2 of what struts do beyond the geometry, where they may do it together, with
    scatter^2 on its diagonal; None where each is by itself, and in files of before it was worked out"""

    correction: Correction[Any, Any]
    covariance: np.ndarray
    scatter: np.ndarray
    frames: tuple[int, ...]
    left_out: tuple[int, ...]
    held_out: HeldOut | None
    provenance: dict[str, Any]
    claim: Claim | None = None
    physics: Physics | None = None
    workspace: Workspace | None = None
    confounds: Confounds | None = None
    strut_covariance: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.physics is not None and self.physics.compensable_effects():
            names = tuple(f"{effect.label()} at {effect.place}" for effect in self.physics.compensable_effects())
            object.__setattr__(self, "correction", replace(self.correction, physics=names))

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        held = self.held_out
        rows = (
            []
            if held is None
            else [
                ("held-out poses", "position RMS, mm", "95 %, mm", "max, mm", "rotation RMS, mrad"),
                *(
                    (name, *(f"{x * 1e3:.4f}" for x in figures.position), f"{figures.rotation[0] * 1e3:.4f}")
                    for name, figures in (("owner's model", held.before), ("corrected", held.after))
                ),
            ]
        )
        first, *rest = ["a calibration of before claims were made"] if self.claim is None else claim_lines(self.claim)
        return result_html(first, rest, rows)

    def with_physics(self, recording: Recording, samples: Samples) -> Samples:
        """The samples of a recording with what physics says of their commands, under the recording's own sensors and
        history.
        """
        if self.physics is None or recording.commands is None:
            return samples
        return self.physics.with_effects(self.correction.fitted, samples, recording.commands, recording.sensors)

    def refuse_kind(self, kind: str, named: str) -> None:
        """Raise RigError for what is of another kind of mechanism. named : it, in words"""
        if kind != self.correction.nominal.kind:
            raise RigError(
                f"{named} is of a mechanism of kind {kind!r}, the calibration of one of kind "
                f"{self.correction.nominal.kind!r}"
            )

    def refuse_physics(self, what: str) -> None:
        """Raise RigError where this holds physics: commands then mean something else at another time, which `what` (a
        sentence's beginning) does not follow."""
        if self.physics is not None and self.physics.compensable_effects():
            raise RigError(
                f"{what} takes commands as they are, and this calibration knows physics that changes them "
                f"({', '.join(self.correction.physics)}); give one made without --diagnosis and --find"
            )
