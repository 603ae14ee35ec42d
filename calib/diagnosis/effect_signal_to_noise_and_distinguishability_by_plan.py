"""Signal-to-noise of effects, and their separation by a plan.

The signal of an effect is what calibration cannot take up; separation is of two effects.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.problems.platform.linearisation_operating_point import (
    OperatingPoint,
    observations_grouped_into_sightings,
)
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import linearise
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_identification_and_joint_profiles import independent_arm_parameter_mask
from calib.models.machine_parameters_and_file_entries import independent_parameter_names_units_sizes_and_jacobian
from calib.models.platform.platform_identification import PRIOR
from calib.models.platform.strut_loop_closure_equations import loop_covariance
from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_hexapod, loop_closure_parameter_jacobian
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Commands, Recording, Sensors
from vision.corner_observations_and_merging import observations_from_corners
from vision.marker_corner_prediction import marker_map


@dataclass(frozen=True, slots=True)
class Separation:
    """plan : its text; frames; misfit : standard deviations by which the better of two models beats the other, scaled
    to fit its best, over the plan's exposures; cosine : of the two sensitivities, freedoms taken out"""

    plan: str
    frames: int
    misfit: float
    cosine: float


def separation_of_two_effects_by_plan(
    plan_name: str,
    design: Design,
    commands: Commands,
    t: Floats,
    sensors: Sensors | None,
    effects: list[Effect],
    sigma: tuple[float, float],
) -> Separation:
    """Separation of two effects by one plan.

    They move a machine, and each is as large as expected.
    t : (n,) s exposures; sigma : (m, rad) standard deviation of a measured pose per axis. Raises RigError for what
        nobody commands, and what the machine raises
    """
    poses = [
        motion_simulation.simulate_machine_run(design, commands, t, acting, sensors).T_base_platform
        for acting in ((), *((effect,) for effect in effects))
    ]
    still, moved, m = poses[0], poses[1:], design.mechanism
    if is_hexapod(m):  # what the struts show
        covariance = np.diag(np.repeat(np.square(sigma), 3))
        A = hexapod.jacobian(still, m)
        W = np.linalg.inv(np.linalg.cholesky(loop_covariance(A, covariance)))
        parts = [W @ (hexapod.inverse(T, m) - hexapod.inverse(still, m))[..., None] for T in moved]
        rows = W @ loop_closure_parameter_jacobian(still, m)
        prior = np.full(rows.shape[2], PRIOR)
    else:
        geometry, white = independent_parameter_names_units_sizes_and_jacobian(m), 1 / np.repeat(sigma, 3)
        parts = [pose_difference(still, T) * white for T in moved]
        rows, prior = geometry.jacobian(commands.at(t)) * white[:, None], geometry.size
    a, b = (part.ravel() for part in parts)
    return _signal_separation(plan_name, len(t), (a, b), rows.reshape(-1, rows.shape[-1]), prior)


def _signal_separation(
    text: str, frames: int, parts: tuple[Floats, Floats], freedoms: Floats, prior: Floats
) -> Separation:
    """Separation of two sensitivities (n,), whitened, by freedoms (n, p), whitened, each of which a prior (p,)
    holds.
    """
    Q = np.linalg.qr(np.concatenate([freedoms, np.diag(1 / prior)]))[0]
    a, b = (np.r_[part, np.zeros(len(prior))] for part in parts)
    a, b = a - Q @ (Q.T @ a), b - Q @ (Q.T @ b)
    norms = np.linalg.norm(a), np.linalg.norm(b)
    if min(norms) == 0:
        return Separation(text, frames, float(max(norms)), 0.0)
    cosine = float(a @ b / norms[0] / norms[1])
    return Separation(text, frames, float(min(norms) * np.sqrt(max(1 - cosine**2, 0.0))), cosine)


def platform_effect_signal_to_noise(
    recording: Recording, true_design: Design, noise: float, effects: tuple[Effect, ...], sensors: Sensors
) -> Floats:
    """Signal-to-noise (effects,) of each effect in a platform's corners.

    Cameras and geometry projected out.
    recording : Recording with corners; true_design : Design as it really is; noise : px, standard deviation of a corner
    effects : all that are at work, of the catalogue or not; sensors : Sensors as they truly were
    Raises RigError where corners or commands are missing
    """
    frames, t = recording.exposures.times()
    if recording.corners is None or recording.commands is None:
        raise RigError(f"{recording.folder}: this requires corners and commands")
    commands = recording.commands
    stated = recording.design
    observations = observations_from_corners(recording.corners, frames, stated, marker_map(stated))
    observations = replace(observations, covariance=np.broadcast_to(noise**2 * np.eye(2), (len(observations), 2, 2)))

    def world(acting: Iterable[Effect]) -> OperatingPoint:
        T = motion_simulation.simulate_machine_run(
            true_design, commands, t, [e for e in acting if e.stage != "view"], sensors
        ).T_base_platform
        point = OperatingPoint(true_design, stated, frames, t, T, {}, None, commands, sensors, None, tuple(acting))
        return replace(point, seen=observations_grouped_into_sightings(observations, marker_map(stated)))

    out = []
    for effect in effects:
        acting = [
            e for e in effects if e is effect or not e.discrete
        ]  # faces exchanged are put right before anything else is looked at
        whole, bare = world(acting), world([e for e in acting if e is not effect])
        model = linearise(whole)
        square = model.linear.project(model.fold((whole.pixels() - bare.pixels())[..., None])).gram
        out.append(float(np.sqrt(max(square[0, 0], 0.0))))
    return np.array(out)


def arm_effect_signal_to_noise(
    true_design: Design, commands: Commands, t: Floats, sigma: Floats, effects: tuple[Effect, ...], sensors: Sensors
) -> Floats:
    """Signal-to-noise (effects,) of each effect in an arm's poses.

    The arm's parameters projected out.
    true_design : Design as it really is; commands, t (n,) s : what was commanded, and when it was measured; sensors :
        as they truly were
    sigma : (2,) m and rad, or (1,) m where positions alone are measured. Raises RigError for what is no arm
    """
    whole = motion_simulation.simulate_machine_run(true_design, commands, t, effects, sensors).T_base_platform
    arm, k = true_design.mechanism, 3 * len(sigma)
    if not isinstance(arm, Arm):
        raise RigError(f"this requires an arm, not a mechanism of kind {arm.kind!r}")
    q = motion_simulation.motion_of_commands(true_design, commands, t, effects, sensors).lengths
    free = independent_arm_parameter_mask(arm, "pose" if k == 6 else "position")
    J = (
        arm_error_model_and_instrument_observations.parameter_jacobian(q, arm)[:, :k][..., free]
        / np.repeat(sigma, 3)[:, None]
    )
    Q = np.linalg.qr(J.reshape(len(t) * k, -1))[0]
    out = []
    for i in range(len(effects)):
        bare = motion_simulation.simulate_machine_run(
            true_design, commands, t, [e for j, e in enumerate(effects) if j != i], sensors
        ).T_base_platform
        moved = (pose_difference(bare, whole)[:, :k] / np.repeat(sigma, 3)).ravel()
        out.append(float(np.linalg.norm(moved - Q @ (Q.T @ moved))))
    return np.array(out)
