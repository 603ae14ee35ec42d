"""Joint effect fit of an arm, and held-out scatter.

Geometry and joint effects are fitted together; scatter is of held-out poses beyond them.

Gauss-Newton on the effects' coordinates, all that the geometry can make up for taken out of them: what a joint's own
effect and a length explain alike goes to the length. A held-out figure is of effects refitted without what is held out.
"""

from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from calib.certification.held_out_pose_error_statistics import (
    HeldErrors,
    mean_square_held_out_errors_by_configuration,
    mean_square_pose_errors_caused_by_parameters,
    residuals_corrected_for_absorbed_noise,
)
from calib.correction.physical_effects_of_calibration_and_their_compensation import (
    poses_with_predicted_rotations,
    samples_with_effects,
)
from calib.identify.bounded_and_robust_least_squares_fit import bounded_step_and_covariance
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_error_model_and_instrument_observations import observation_jacobian, observations_of_samples
from calib.models.arm.arm_identification_and_joint_profiles import (
    Identified,
    identify_arm,
    independent_arm_parameter_mask,
    whitened_tilt_rows_and_columns,
)
from calib.models.arm.tilt_observations import TiltWeights, link_rotation_jacobian_by_joints, tilt_equation_rows
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import (
    Coordinate,
    conserved_coordinate_sums,
    effects_with_coordinates,
    fit_coordinates_of_effects,
)
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.base_and_link_tilt_sensors import TiltReadings
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.recording.recording_folder import Commands, Sensors

ITERATIONS = 12
SETTLED = 1e-4  # of the squares that a step still gains
HALVINGS = 6
ROUNDS = 2  # of the geometry, which decides what effects are seen through, and the effects
STRAIGHT = ("linear", "inverse")  # roles of parameters that what joints do is linear in


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """What an arm was told besides its samples. design : Design, whose mechanism is the nominal Arm;
    commands : Commands, the whole path
    sensors : Sensors or None."""

    design: Design
    commands: Commands
    sensors: Sensors | None

    def with_effects(self, samples: Samples, effects: tuple[Effect, ...], arm: Arm) -> Samples:
        """Samples as measured, with what effects do to their commands on an arm."""
        return samples_with_effects(replace(self.design, mechanism=arm), samples, self.commands, effects, self.sensors)

    def identified(self, samples: Samples, start: Arm) -> Identified:
        """Identified geometry of samples that were told, by the parameters that the arm as stated has."""
        observations = observations_of_samples(samples)
        return identify_arm(
            observations, start, independent_arm_parameter_mask(require_arm(self.design.mechanism), observations.kind)
        )

    def moved(self, samples: Samples, effects: tuple[Effect, ...], arm: Arm) -> tuple[Floats, Floats, Floats]:
        """(joints (n, joints), hand (n, 6), lean (n, 3)) that commands become under effects, as `machine.reached`, and
        by which the base turns.
        """
        design = replace(self.design, mechanism=arm)
        run = (design, self.commands, samples.t, poses_with_predicted_rotations(design, samples), effects, self.sensors)
        return *motion_simulation.effective_commands_and_sway(
            *run, samples.hand
        ), motion_simulation.base_lean_rotation_vectors(*run)


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What another recording told of c coordinates. values, sigma : (c,)"""

    values: Floats
    sigma: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """What effects' c coordinates do at n samples: joints (n, joints, c) rad or m, hand (n, 6, c) m and rad beyond
    these, lean (n, 3, c) rad of the base.
    """

    joints: Floats
    hand: Floats
    lean: Floats

    @staticmethod
    def of_joints(joints: Floats) -> "Columns":
        """Columns of what moves joints alone, (n, joints, c)."""
        n, c = len(joints), joints.shape[2]
        return Columns(joints, np.zeros((n, 6, c)), np.zeros((n, 3, c)))

    def take(self, index: Booleans) -> "Columns":
        """Of an index or mask (n,)."""
        return Columns(self.joints[index], self.hand[index], self.lean[index])


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """Effects fitted with an arm's geometry. measured : Samples; history : History
    effects : fitted; arm : its geometry beside them; own : (c, c) covariance of their coordinates; columns : Columns
    there; before : Prior or None; samples : Samples with what the effects do to their commands."""

    measured: Samples
    history: History
    effects: tuple[Effect, ...]
    arm: Arm
    own: Floats
    columns: Columns
    before: Prior | None
    samples: Samples = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", self.history.with_effects(self.measured, self.effects, self.arm))

    def without(self, held: Booleans) -> Samples:
        """All samples, with what effects of this structure do to their commands, fitted to those alone that are not
        held (n,) bool.
        """
        rest = _refined(
            self.measured.take(~held), self.history, self.arm, self.effects, self.before, self.columns.take(~held)
        )
        return self.history.with_effects(self.measured, rest.effects, rest.arm)

    def response(self, found: Identified) -> Floats:
        """(p, c) by which the geometry's parameters follow the effects' coordinates, of an arm identified on these
        samples.
        """
        seen = WhitenedSamples.of(self.samples, found)
        out = np.zeros((len(found.free), len(self.own)))
        out[found.free] = -np.linalg.lstsq(seen.nuisances, seen.whitened(self.columns), rcond=None)[0][
            : int(found.free.sum())
        ]
        return out


def fit_geometry_and_effects(
    measured: Samples, history: History, start: Arm, effects: tuple[Effect, ...], prior: Prior | None = None
) -> JointFit:
    """Joint fit (JointFit) of an arm's geometry and effects.

    Raises as `identify_arm`
    """
    arm, columns = start, None
    for _ in range(ROUNDS):
        arm = history.identified(history.with_effects(measured, effects, arm), arm).arm
        columns = _columns(measured, history, effects, arm, columns)
        done = _refined(measured, history, arm, effects, prior, columns)
        effects, arm, columns = done.effects, done.arm, done.columns
    return done


@dataclass(frozen=True, slots=True, eq=False)
class WhitenedSamples:
    """How samples see an arm. W : (m, k, k) weights of those that agree; inliers : (n,) bool; q : (n, joints);
    kind, hand : of Observations; arm : Arm; tilts : TiltWeights of r rows of tilt sensors, None without
    nuisances : (m k + j + r, p + j + ..) whitened columns of the free parameters, of the j shared draws and of how tilt
        sensors are mounted; basis : orthonormal, of the same span."""

    W: Floats
    inliers: Booleans
    q: Floats
    kind: str
    arm: Arm
    nuisances: Floats
    basis: Floats
    tilts: tuple[TiltReadings, TiltWeights] | None = None
    hand: Integers | None = None

    @staticmethod
    def of(samples: Samples, found: Identified) -> "WhitenedSamples":
        o, shared = observations_of_samples(samples), samples.common.shape[2]
        whole = o.kind == "direction" and len(found.scatter) == 6  # as certified, of a whole pose
        scatter = found.scatter[3:5] if whole else found.scatter
        W = np.linalg.inv(np.linalg.cholesky(o.covariance + np.diag(scatter**2)))[found.inliers]
        J = np.concatenate([o.jacobian(found.arm)[..., found.free], o.common], axis=2)[found.inliers]
        stacked = np.concatenate([(W @ J).reshape(-1, J.shape[2]), np.eye(J.shape[2])[J.shape[2] - shared :]])
        known = None if o.tilts is None or found.tilts is None else (o.tilts, found.tilts)
        if known is not None:
            rows, columns = whitened_tilt_rows_and_columns(o, found.arm, known[1])
            mounting = rows.whitened_mounting(known[1])
            own = np.pad(columns[:, found.free], ((0, 0), (0, shared)))
            lower = np.concatenate([own, mounting], axis=1)
            stacked = np.concatenate([np.pad(stacked, ((0, 0), (0, mounting.shape[1]))), lower])
        return WhitenedSamples(
            W,
            found.inliers,
            o.q,
            o.kind,
            found.arm,
            stacked,
            np.linalg.qr(stacked / np.linalg.norm(stacked, axis=0))[0],
            known,
            o.hand,
        )

    def whitened(self, columns: Columns) -> Floats:
        """(m k + j, c) of Columns (n, ..)."""
        J = arm_error_model_and_instrument_observations.joint_jacobian(self.q, self.arm, self.hand)
        moved = J @ columns.joints + columns.hand
        seen = self.W @ observation_jacobian(self.kind, moved, self.q, self.arm, self.hand)[self.inliers]
        seen = seen.reshape(seen.shape[0] * seen.shape[1], seen.shape[2])
        if self.tilts is None:
            return self._padded(seen)
        readings, weights = self.tilts
        turned = (
            link_rotation_jacobian_by_joints(readings, self.q, self.arm) @ columns.joints[:, None]
            + columns.lean[:, None]
        )
        return self._padded(seen, tilt_equation_rows(readings, self.q, self.arm).whitened_columns(weights, turned))

    def left(self, samples: Samples) -> Floats:
        """(m k + j,) whitened residuals of samples, all that the nuisances explain taken out."""
        o = observations_of_samples(samples)
        seen = (self.W @ o.residuals(self.arm)[self.inliers][..., None]).reshape(-1, 1)
        lower = np.zeros((0, 1))
        if self.tilts is not None and o.tilts is not None:
            lower = tilt_equation_rows(o.tilts, o.q, self.arm).whitened_residuals(self.tilts[1])[:, None]
        r = self._padded(seen, lower)[:, 0]
        return r - self.basis @ (self.basis.T @ r)

    def _padded(self, seen: Floats, lower: Floats | None = None) -> Floats:
        """Rows (m k, c) of the instrument, nothing of the shared draws, and rows (r, c) of tilt sensors."""
        lower = np.zeros((0, seen.shape[1])) if lower is None else lower
        between = np.zeros((len(self.nuisances) - len(seen) - len(lower), seen.shape[1]))
        return np.concatenate([seen, between, lower])


@dataclass(frozen=True, slots=True, eq=False)
class _Prior:
    """What is known of c coordinates. values, weight : (c,) of each, 0 where nothing is; ends : (c, 2) bounds;
    conserved : (k, c) sums that stay.
    """

    values: Floats
    weight: Floats
    ends: Floats
    conserved: Floats

    @staticmethod
    def of(coordinates: list[Coordinate], effects: tuple[Effect, ...], before: Prior | None) -> "_Prior":
        loose = np.array([c.loose for c in coordinates]) ** 2
        weight, values = np.zeros(len(loose)), np.zeros(len(loose))
        if before is not None:  # of the first: what was added since is of these samples alone
            count = len(before.sigma)
            weight[:count] = np.maximum(before.sigma, 1e-300) ** -2.0
            values[:count] = weight[:count] * before.values / np.maximum(loose + weight, 1e-300)[:count]
        return _Prior(
            values,
            loose + weight,
            np.array([c.ends for c in coordinates], float).reshape(-1, 2),
            conserved_coordinate_sums(coordinates, effects),
        )

    def cost(self, values: Floats) -> float:
        return float((self.weight * (values - self.values) ** 2).sum())


def _refined(
    measured: Samples, history: History, arm: Arm, effects: tuple[Effect, ...], before: Prior | None, columns: Columns
) -> JointFit:
    """Together from where effects and an Arm stand, with the geometry that is left in the end."""
    coordinates = fit_coordinates_of_effects(effects)
    samples = history.with_effects(measured, effects, arm)
    seen = WhitenedSamples.of(samples, history.identified(samples, arm))
    prior, own = _Prior.of(coordinates, effects, before), np.zeros((0, 0))
    values, left = _values(coordinates, effects), seen.left(samples)
    for _ in range(ITERATIONS if coordinates else 0):
        C = seen.whitened(columns)
        C -= seen.basis @ (seen.basis.T @ C)
        step, own = bounded_step_and_covariance(
            C.T @ left + prior.weight * (prior.values - values),
            C.T @ C + np.diag(prior.weight),
            values,
            prior.ends,
            prior.conserved,
        )
        cost, gain = left @ left + prior.cost(values), 0.0
        for halving in range(HALVINGS):
            tried = effects_with_coordinates(effects, coordinates, values + 0.5**halving * step)
            if tried is None:
                continue
            new, after = _values(coordinates, tried), seen.left(history.with_effects(measured, tried, arm))
            gain = float(cost - after @ after - prior.cost(new))
            if gain >= 0:
                effects, values, left = tried, new, after
                break
        if gain < SETTLED * max(cast(float, cost / len(left)), 1.0):
            break
        columns = _columns(measured, history, effects, arm, columns)
    found = history.identified(history.with_effects(measured, effects, arm), arm)
    return JointFit(measured, history, effects, found.arm, own, columns, before)


def _values(coordinates: list[Coordinate], effects: tuple[Effect, ...]) -> Floats:
    return np.array([c.read(effects[c.effect]) for c in coordinates])


def _columns(
    samples: Samples, history: History, effects: tuple[Effect, ...], arm: Arm, before: Columns | None
) -> Columns:
    """Columns of effects' coordinates at samples, by differences. before : near by, of which what is linear holds
    still; None to work out all
    """
    coordinates = fit_coordinates_of_effects(effects)
    n, k = samples.commanded.shape
    parts = [np.zeros((n, size, len(coordinates))) for size in (k, 6, 3)]
    if before is not None:
        parts = [before.joints.copy(), before.hand.copy(), before.lean.copy()]
    bent = {c.effect for c in coordinates if c.role not in STRAIGHT or any(e.retimes() for e in effects)}
    for i, c in enumerate(coordinates):
        if before is None or c.effect in bent:
            ends, between = c.ends_of(effects, effects)
            for part, high, low in zip(parts, *(history.moved(samples, one, arm) for one in ends)):
                part[..., i] = (high - low) / between
    return Columns(*parts)


UNSTATED = 1.2  # times what is stated, from which a scatter is unexplained


def held_out_geometry_errors(
    identified: Identified, correction: ArmCorrection, fitted_samples: Samples, label: Integers
) -> HeldErrors:
    """Held-out errors (HeldErrors) of an arm's geometry at each configuration.

    fitted_samples : Samples that it was fitted to; label : (m,) configuration of each
    """
    freed = residuals_corrected_for_absorbed_noise(
        identified.residuals[identified.inliers], *_fitted(identified, correction, fitted_samples), label
    )
    return mean_square_held_out_errors_by_configuration(freed, fitted_samples, label)


def mean_square_arm_errors_caused_by_parameters(
    identified: Identified, correction: ArmCorrection, fitted_samples: Samples, folds: Integers
) -> Floats:
    """Mean squares (2,) of held-out errors caused by the parameters, m^2 and rad^2.
    folds : (m,) which are held out together
    """
    return mean_square_pose_errors_caused_by_parameters(*_fitted(identified, correction, fitted_samples), folds)


def _fitted(found: Identified, correction: ArmCorrection, agreed: Samples) -> tuple[Floats, Floats, Floats]:
    """(jacobian (m, 6, p), covariance (p, p), noise (m, 6, 6)) of a fit."""
    J = arm_error_model_and_instrument_observations.parameter_jacobian(agreed.commanded, correction.fitted, agreed.hand)
    return J, found.covariance, observations_of_samples(agreed).covariance + np.diag(found.scatter**2)


def identification_with_held_out_scatter(
    identified: Identified, held_out_errors: HeldErrors, rng: np.random.Generator
) -> Identified:
    """Identification with its scatter raised to that of held-out poses.

    Their scatter beyond the parameters' errors.
    """
    if len(identified.scatter) != 6:
        return identified
    return replace(
        identified, scatter=np.maximum(identified.scatter, np.sqrt(np.repeat(held_out_errors.shown(rng) / 3, 3)))
    )


def unexplained_scatter_sentences(scatter: Floats, covariance: Floats) -> tuple[str, ...]:
    """Sentences on scatter unexplained by the instrument's statement.

    One for positions and one for rotations.
    scatter : (k,) m and rad beyond; covariance : (n, k, k) as stated
    """
    out = []
    for part, name, unit in ((slice(0, 3), "positions", "mm"), (slice(3, 6), "rotations", "mrad")):
        beyond = float(np.sqrt((scatter[part] ** 2).sum()))
        stated = float(np.sqrt(np.einsum("nkk->nk", covariance)[:, part].sum(axis=1).mean())) if beyond else 0.0
        if np.hypot(beyond, stated) > UNSTATED * stated:
            out.append(
                f"{name} of the hand scatter by {beyond * 1e3:.3g} {unit} beyond the {stated * 1e3:.3g} "
                f"{unit} stated for them, which "
                "this calibration does not explain"
            )
    return tuple(out)
