"""Effects shown by an arm's instruments.

The instruments show them by themselves; they are fitted with the geometry before anything is searched for.
"""

import numpy as np

from calib.diagnosis.engine.cross_validation_and_chance import Z95
from calib.diagnosis.problems.evidence_interface_and_requested_effects import MeasuredFinding, Value
from calib.diagnosis.problems.remainder_covariates_temperature_smoothing_and_repeatability import smooth_temperatures
from calib.models.arm.certification import UNPLACED, start_arm_of_fit
from calib.models.arm.error_model_and_observations import sample_observations
from calib.models.arm.joint_effect_fit_and_held_out_scatter import History, JointFit, fit_geometry_and_effects
from calib.models.arm.pointing_terms import tube_flexure
from calib.samples.pose_samples import Sampled
from rig.effects.catalogue.effect_list import lean_under_link_weight
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import coordinates_of_effects
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.model.motion_simulation import motion_of_commands
from rig.recording.recording_folder import Recording


def measured_effects(recording: Recording, sampled: Sampled) -> tuple[Effect, ...]:
    """Effects that are fitted with an arm's geometry since its instruments show them.

    Small where the fit begins.

    The flexure of a tube, of which directions were measured; the lean of a base on which a tilt sensor was read.
    """
    arm, samples = recording.design.mechanism, sampled.samples
    if not isinstance(arm, Arm) or recording.commands is None:
        return ()
    flexure = tube_flexure(arm) if samples.measured == "direction" else ()
    readings = samples.tilts
    if readings is None or samples.measured in UNPLACED or all(sensor.link for sensor in readings.sensors):
        return flexure
    logged, poses = recording.sensors, samples.T_base_platform
    lean = lean_under_link_weight(
        motion_of_commands(recording.design, recording.commands, samples.t, (), logged, poses)
    )
    return (*flexure, *([] if lean is None else [lean]))


def fit_of_measured_effects(recording: Recording, sampled: Sampled) -> JointFit | None:
    """JointFit of an arm's `measured_effects` with its geometry alone.

    All else is searched for beside it; None where there are none.
    """
    effects = measured_effects(recording, sampled)
    if not effects or recording.commands is None:
        return None
    samples, arm = sampled.samples, require_arm(recording.design.mechanism)
    history = History(recording.design, recording.commands, smooth_temperatures(recording.sensors)[0])
    start = start_arm_of_fit(sample_observations(samples), arm, sampled.instrument)
    return fit_geometry_and_effects(samples, history, start, effects)


def findings_of_measured_effects(fit: JointFit) -> tuple[MeasuredFinding, ...]:
    """Findings of effects that were fitted before the search, with 95 % intervals; of a lean its RMS first."""
    out, coordinates, sigma = list[MeasuredFinding](), coordinates_of_effects(fit.effects), np.sqrt(np.diag(fit.own))
    for number, effect in enumerate(fit.effects):
        parameters = dict[str, Value]()
        before, after = fit.measured.tilts, fit.samples.tilts
        if type(effect).lean is not Effect.lean and before is not None and after is not None:
            turned = np.linalg.norm(np.cross(before.down, after.down), axis=1)
            parameters["rms"] = Value(float(np.sqrt((turned**2).mean())), "rad")
        for parameter in effect.parameters:
            own = [k for k, c in enumerate(coordinates) if (c.effect, c.name) == (number, parameter.name)]
            if own:
                value = np.array([coordinates[k].read(effect) for k in own])
                ends = np.stack([value - Z95 * sigma[own], value + Z95 * sigma[own]])
                several = coordinates[own[0]].index is not None
                read, low_high = (value, ends) if several else (value[0], ends[:, 0])
                unit = parameter.unit.split(", ")[0]
                parameters[parameter.name] = Value(read.tolist(), unit, low_high.tolist())
        out.append(MeasuredFinding(type(effect), effect.place, parameters))
    return tuple(out)
