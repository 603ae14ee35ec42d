"""Refit of an arm's calibration with the findings of a diagnosis as parameters."""

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from calib.certification.platform_certification import Progress, silent_progress
from calib.correction.physics_compensation import Physics
from calib.diagnosis.platform_findings_refit import Findings, sensor_medians_and_standard_deviations
from calib.diagnosis.problems.temperature_smoothing import smooth_temperatures
from calib.models.arm.certification import UNPLACED, CertifiedArm, start_arm
from calib.models.arm.error_model_and_observations import parameter_names, sample_observations
from calib.models.arm.joint_effects_fit_and_held_out_scatter import History, JointFit, Prior, fit_geometry_and_effects
from calib.samples.recording_samples import Sampled
from rig.array_types import Floats
from rig.effects.framework.effect_checks_and_fit_coordinates import coordinates_of_effects
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.mechanism_kinds_and_hexapod_properties import require_arm
from rig.recording.recording_folder import Recording


@dataclass(frozen=True, slots=True, eq=False)
class ArmRefit:
    """together : JointFit of what was found; physics : Physics, of which the geometry does not know yet."""

    together: JointFit
    physics: Physics

    def with_geometry(self, done: CertifiedArm) -> tuple[Physics, Floats]:
        """(Physics, (p, p) covariance of the geometry, m and rad), of a geometry certified on these samples and the
        physics together.
        """
        response = self.together.response(done.found)
        cross, places = response @ self.physics.own, mechanisms.axis_places(done.correction.nominal)
        kept = [place for place, part in zip(places, done.correction.remainder) if part is not None]
        unknown = tuple(
            replace(u, corrected=u.place in kept or (u.place == "rig" and bool(kept))) for u in self.physics.unknown
        )
        return replace(self.physics, cross=cross, unknown=unknown), done.found.covariance + cross @ response.T


@threadpool_limits.wrap(limits=1)
def refit_arm_with_findings(
    recording: Recording, sampled: Sampled, findings: Findings, progress: Progress | None = None
) -> ArmRefit:
    """ArmRefit of a recording's samples: the arm's geometry and the findings' parameters fitted together.

    Raises RigError where neither poses nor positions were measured, and what identifying raises
    """
    said, samples, design = progress or silent_progress, sampled.samples, recording.design
    nominal = require_arm(design.mechanism)
    if samples.measured in UNPLACED:
        raise RigError(f"physics is taken in where poses or positions were measured: {UNPLACED[samples.measured]}")
    commands = recording.commands
    if commands is None:
        raise RigError(f"{recording.folder}: nothing was commanded")
    said("refining physics and geometry together", 0, 1)
    before = None
    if findings.sigma is not None:
        before = Prior(
            np.array([c.read(findings.effects[c.effect]) for c in coordinates_of_effects(findings.effects)]),
            findings.sigma,
        )
    start = start_arm(sample_observations(samples), nominal, sampled.instrument)
    found = fit_geometry_and_effects(
        samples, History(design, commands, smooth_temperatures(recording.sensors)[0]), start, findings.effects, before
    )
    said("refining physics and geometry together", 1, 1)
    physics = Physics(
        found.effects,
        found.own,
        np.zeros((len(parameter_names(nominal)), len(found.own))),
        design.gravity,
        design.actuator,
        design.platform,
        sensor_medians_and_standard_deviations(recording, samples.t),
        findings.unknown,
    )
    return ArmRefit(found, physics)
