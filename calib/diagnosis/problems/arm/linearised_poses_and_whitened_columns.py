"""Linearised poses of an arm, and whitened columns of parameters.

Measured poses, linearised about its calibrated geometry.

The columns are of its freedoms and terms, stored as joint directions times pose weights; of a chain too.
A term of hundreds of numbers at one joint moves each pose along one direction, so that products of two such terms are
sums over poses of their weights times one number; no column is ever written out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse.linalg import LinearOperator
from scipy.spatial.transform import RigidTransform

from calib.correction.physical_effects_of_calibration_and_their_compensation import poses_with_predicted_rotations
from calib.diagnosis.problems.arm.minimum_pose_count_for_candidates import require_enough_poses
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import row_pairs_with_same_command
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import arm_correction_and_identification
from calib.models.arm.arm_error_model_and_instrument_observations import (
    KINDS,
    observation_jacobian,
    observations_of_samples,
)
from calib.models.chain import chain_error_model_and_identification as chains
from calib.models.chain.chain_error_model_and_identification import identify_chain
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Context
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism_arm
from rig.model.mechanisms import mechanism_chain as mechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm, require_chain
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Commands, Sensors
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr
from vision.pose_uncertainty_prediction import PredictedUncertainty

SEEN = 1e-4  # of the best told combination of a chain's parameters; others no pose tells, and they explain nothing


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Arms(FieldSummaryRepr):
    """What is known of n poses of an arm or chain. frame : (n,); t : (n,) s; q : (n, joints) rad or m, commanded;
    left : (n, k) m and rad, what the geometry left (k = 6, 3 for positions, 2 for directions)
    freedoms : (n, k, p) change with calibration's parameters; joints : (n, k, joints) with the angles
    own : (n, k, k) the instrument's covariance;
        commands : the whole path; context : what effects may
    look at
    assumed : whether nobody states that covariance, so that a usual one stands for it
    sight : of poses that cameras measure, T_base_platform (m,) -> Foreseen of others that they have yet to see; None of
        an instrument's; hand : (n,) number of the hand that each is of, None of arms with one"""

    frame: Integers
    t: Floats
    q: Floats
    left: Floats
    freedoms: Floats
    joints: Floats
    own: Floats
    commands: Commands
    context: Context
    sight: Callable[[RigidTransform], PredictedUncertainty] | None = None
    assumed: bool = False
    hand: Integers | None = None

    def __len__(self) -> int:
        return len(self.t)

    @property
    def unit(self) -> str:
        """Unit of the first numbers measured of each: "rad" of directions, else "m"."""
        return "rad" if self.left.shape[1] == KINDS["direction"] else "m"

    def repeated(self, rows: Integers | Booleans) -> Integers:
        """Pairs (p, 2) of some of the poses, an index or mask (n,), that repeat a command, of one hand each."""
        pairs = row_pairs_with_same_command(self.q[rows], self.context.moved().units)
        if self.hand is None:
            return pairs
        return pairs[self.hand[rows][pairs[:, 0]] == self.hand[rows][pairs[:, 1]]]

    def directions(self, joint: int | None) -> Floats:
        """(n, k, a) change of what is measured with a joint's angle (index, a = 1), or with the measured tangents
        themselves (None, a = k).
        """
        return (
            np.broadcast_to(np.eye(self.left.shape[1]), self.own.shape)
            if joint is None
            else self.joints[..., joint : joint + 1]
        )

    def measured(self, tangents: Floats) -> Floats:
        """(n, k) what is measured of tangents (n, 6), on the right, by which the tool is displaced.

        Positions alone are measured along the axes of the frame of poses.
        """
        kind = _kind_of_rows(self.left.shape[1])
        if kind == "pose":
            return tangents
        arm = require_arm(self.context.design.mechanism)
        return observation_jacobian(kind, tangents[..., None], self.q, arm, self.hand)[..., 0]

    def displaced(self, effect: Effect) -> Floats:
        """(n, k) by which an effect, of joints or beyond them, changes what is measured of each hand."""
        motion = self.context.moved()
        run = (self.context.design, self.commands, self.t, motion.poses(), (effect,), self.context.sensors)
        values, sway = motion_simulation.effective_commands_and_sway(*run, self.hand)
        return (self.joints @ (values - self.q)[..., None])[..., 0] + self.measured(sway)

    def reached(self, effect: Effect) -> Floats:
        """(n, joints) rad, commands reached at the exposures under an effect of clock or path."""
        return motion_simulation.motion_of_commands(
            self.context.design, self.commands, self.t, (effect,), self.context.sensors
        ).lengths

    @property
    def channels(self) -> dict[str, Floats]:
        """{sensor's channel: (n,)} at the exposures."""
        sensors = self.context.sensors
        return {} if sensors is None else {name: sensors.at(self.t, name) for name in sensors.channels}


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """What calibration fitted. mechanism : Arm or Chain; basis : (p, f) m and rad, what one of each freedom is of the
    parameters
    move : (p,) step -> the mechanism with its parameters moved"""

    mechanism: Arm | Chain
    basis: Floats
    move: Callable[[Floats], Arm | Chain]

    def at(self, sizes: Floats) -> Arm | Chain:
        """The mechanism with its freedoms moved by sizes (f,)."""
        return self.move(self.basis @ sizes)


def _kind_of_rows(k: int) -> str:
    """Kind of observation of which a diagnosis has k numbers each."""
    return next(name for name in ("pose", "position", "direction") if KINDS[name] == k)


def linearised_arm_poses_and_geometry(
    samples: Samples,
    design: Design,
    commands: Commands | None = None,
    sensors: Sensors | None = None,
    refuse_few: bool = True,
) -> tuple[Arms, Geometry]:
    """Linearise the poses of Samples about the calibrated geometry.

    design : whose mechanism is the nominal Arm or Chain; commands : the whole path; the samples' own commands in their
        order where None
    refuse_few : whether poses that bear no finding are an error
    Returns (Arms, Geometry)
    Raises NotEnoughData for too few poses, with how many it takes, RigError for what is neither, and what calibrating
        raises
    """
    if samples.measured in ("orientation", "distance"):
        raise RigError(
            f"an arm is diagnosed by its poses, positions or directions; the {samples.measured} alone was measured"
        )
    linear = (
        _of_arm if isinstance(design.mechanism, Arm) else _of_chain if isinstance(design.mechanism, Chain) else None
    )
    if linear is None:
        raise RigError(f"this requires an arm or a chain, not a mechanism of kind {design.mechanism.kind!r}")
    if refuse_few:
        require_enough_poses(samples, design)
    geometry, left, freedoms, joints, own = linear(samples, design)
    commands = Commands(samples.t, samples.commanded) if commands is None else commands
    design = replace(design, mechanism=geometry.mechanism)
    poses = poses_with_predicted_rotations(design, samples)
    motion = motion_simulation.motion_of_commands(design, commands, samples.t, (), sensors, poses)
    context = Context(design, samples.t, sensors, motion)
    freedoms = np.concatenate([freedoms, samples.common[:, : left.shape[1]]], axis=2)
    seen = (samples.frame, samples.t, samples.commanded, left, freedoms, joints, own, commands, context)
    return Arms(*seen, hand=samples.hand), geometry


def linearise_planned_poses(
    arms: Arms, geometry: Geometry, commands: Commands, t: Floats, sensors: Sensors | None
) -> Arms:
    """Linearise the planned poses of an arm at commands and exposures t (n,) s.

    They have no residuals. Returns Arms

    Of a recording that is not there yet; its instrument sees as before.
    frame : of cameras those exposures alone that they will see, numbers among the n
    Raises RigError for a chain, where commands leave the arm's limits, or where cameras see none of it
    """
    if not isinstance(geometry.mechanism, Arm) or geometry.mechanism.hands:
        raise RigError("future poses can be predicted for an arm with one hand only")
    frame, view = np.arange(len(t)), None
    if arms.sight is not None:
        view = arms.sight(
            arm_error_model_and_instrument_observations.predicted_target_poses(commands.at(t), geometry.mechanism)
        )
        frame, t = np.flatnonzero(view.seen), t[view.seen]
        if not len(t):
            raise RigError(f"in none of the plan's {len(view.seen)} exposures a camera would see enough of the hand")
    q, k, design = commands.at(t), arms.left.shape[1], replace(arms.context.design, mechanism=geometry.mechanism)
    kind = _kind_of_rows(k)
    freedoms = (
        observation_jacobian(
            kind,
            arm_error_model_and_instrument_observations.parameter_jacobian(q, geometry.mechanism),
            q,
            geometry.mechanism,
        )
        @ geometry.basis
    )
    joints = observation_jacobian(
        kind, arm_error_model_and_instrument_observations.joint_jacobian(q, geometry.mechanism), q, geometry.mechanism
    )
    context = replace(
        arms.context,
        design=design,
        t=t,
        sensors=sensors,
        motion=motion_simulation.motion_of_commands(
            design, commands, t, (), sensors, mechanism_arm.forward(q, geometry.mechanism)
        ),
    )
    if view is None:
        own = np.broadcast_to(np.median(arms.own, axis=0), (len(t), k, k))
        places = arms.freedoms.shape[2] - freedoms.shape[2]  # of base and tool in earlier recordings alone
        freedoms = np.concatenate([freedoms, np.zeros((len(t), k, places))], axis=2)
    else:
        own, freedoms = view.covariance, np.concatenate([freedoms, view.common], axis=2)
    return Arms(frame, t, q, np.zeros((len(t), k)), freedoms, joints, own, commands, context, arms.sight)


Linear = tuple[Geometry, Floats, Floats, Floats, Floats]  # with what is left, freedoms, joints and own of Arms


def _of_arm(samples: Samples, design: Design) -> Linear:
    """Linear about an arm: its independent parameters are the freedoms."""
    _, found = arm_correction_and_identification(
        samples, require_arm(design.mechanism), design.instrument, profiles=False
    )
    observations, free = observations_of_samples(samples), found.free
    return (
        Geometry(
            found.arm,
            np.eye(len(free))[:, free],
            partial(arm_error_model_and_instrument_observations.arm_with_parameter_step, found.arm),
        ),
        observations.residuals(found.arm),
        observations.jacobian(found.arm)[..., free],
        observations.joint_jacobian(found.arm),
        observations.covariance,
    )


def _of_chain(samples: Samples, design: Design) -> Linear:
    """Linear about a chain: the combinations of all stages' parameters that poses tell at all are the freedoms, in
    plausible sizes.
    """
    nominal = require_chain(design.mechanism)
    chain, sigma = identify_chain(samples, nominal).chain, chains.parameter_tolerances(nominal)
    J = chains.parameter_jacobian(samples.commanded, chain) * sigma
    white = np.linalg.inv(np.linalg.cholesky(samples.covariance)) @ J
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->ij", white, white))
    determined = vectors[:, values > SEEN**2 * values[-1]]
    left = pose_difference(mechanism.forward(samples.commanded, chain), samples.T_base_platform)
    geometry = Geometry(chain, sigma[:, None] * determined, partial(chains.chain_with_parameter_step, chain))
    return geometry, left, J @ determined, mechanism.jacobian(samples.commanded, chain), samples.covariance


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Columns (q) side by side. joint : whose direction they follow, values (n, q); None where values (n, k, q) are the
    columns themselves.
    """

    joint: int | None
    values: Floats

    @property
    def count(self) -> int:
        """How many columns."""
        return self.values.shape[-1]


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """directions : (n, k, joints) by which a joint's turn changes what is measured; parts : the columns, in order."""

    directions: Floats
    parts: tuple[Part, ...]

    @property
    def count(self) -> int:
        """How many columns there are."""
        return sum(part.count for part in self.parts)

    def take(self, rows: Booleans) -> "Columns":
        """Of some of the poses, an index or mask (n,)."""
        return Columns(self.directions[rows], tuple(replace(part, values=part.values[rows]) for part in self.parts))

    def whitened(self, W: Floats) -> "Columns":
        """The same with every pose's numbers weighed by W (n, k, k)."""
        return Columns(
            W @ self.directions, tuple(replace(p, values=W @ p.values) if p.joint is None else p for p in self.parts)
        )

    def with_parts(self, parts: Sequence[Part]) -> "Columns":
        """With more columns at the end."""
        return replace(self, parts=(*self.parts, *parts))

    def without_parts(self, numbers: Sequence[int]) -> "Columns":
        """Without some parts."""
        return replace(self, parts=tuple(part for i, part in enumerate(self.parts) if i not in numbers))

    def at(self, sizes: Floats) -> Floats:
        """(n, k, r) what sizes (p, r) come to."""
        n, k, joints = self.directions.shape
        out, turns, start = np.zeros((n, k, sizes.shape[1])), np.zeros((n, joints, sizes.shape[1])), 0
        for part in self.parts:
            moved = part.values @ sizes[start : start + part.count]
            if part.joint is None:
                out += moved
            else:
                turns[:, part.joint] += moved
            start += part.count
        return out + self.directions @ turns

    def along(self, moved: Floats) -> Floats:
        """(n, a, p) products of directions (n, k, a) with the columns, pose by pose."""
        turned = np.swapaxes(moved, 1, 2)
        turns = turned @ self.directions
        out, start = np.empty((len(moved), moved.shape[2], self.count)), 0
        for part in self.parts:
            here = out[..., start : start + part.count]
            if part.joint is None:
                np.matmul(turned, part.values, out=here)
            else:
                np.multiply(turns[..., part.joint, None], part.values[:, None, :], out=here)
            start += part.count
        return out

    def onto(self, moved: Floats) -> Floats:
        """(p, r) products of the columns with what moves (n, k, r), summed over poses."""
        turns = np.swapaxes(self.directions, 1, 2) @ moved
        flat = moved.reshape(-1, moved.shape[2])
        return np.concatenate(
            [
                part.values.reshape(-1, part.count).T @ flat
                if part.joint is None
                else part.values.T @ turns[:, part.joint]
                for part in self.parts
            ]
        )

    def cross(self, other: "Columns") -> Floats:
        """(p, p') products with other columns along the same directions, summed over poses."""
        gram = np.swapaxes(self.directions, 1, 2) @ self.directions
        return np.block([[_product(a, b, self.directions, gram) for b in other.parts] for a in self.parts])

    def gram(self) -> Floats:
        """(p, p) products with each other, summed over poses."""
        gram = np.swapaxes(self.directions, 1, 2) @ self.directions
        count = len(self.parts)
        blocks = {
            (i, j): _product(self.parts[i], self.parts[j], self.directions, gram)
            for i in range(count)
            for j in range(i, count)
        }
        return np.block([[blocks[i, j] if i <= j else blocks[j, i].T for j in range(count)] for i in range(count)])

    def operator(self) -> LinearOperator:
        """The columns (n k, p) as an operator."""
        n, k, _ = self.directions.shape

        def matmat(sizes: Floats) -> Floats:
            return self.at(sizes).reshape(n * k, -1)

        def rmatmat(moved: Floats) -> Floats:
            return self.onto(moved.reshape(n, k, -1))

        return LinearOperator(
            (n * k, self.count),
            matvec=lambda x: matmat(x.reshape(-1, 1))[:, 0],
            rmatvec=lambda y: rmatmat(y.reshape(-1, 1))[:, 0],
            matmat=matmat,
            rmatmat=rmatmat,
            dtype=np.dtype(float),
        )


def _product(a: Part, b: Part, directions: Floats, gram: Floats) -> Floats:
    """(p, q) of two parts. directions : (n, k, joints); gram : (n, joints, joints) of these"""
    if a.joint is None and b.joint is None:
        return a.values.reshape(-1, a.count).T @ b.values.reshape(-1, b.count)
    if a.joint is None:
        along = (directions[:, None, :, b.joint] @ a.values)[:, 0]
        return along.T @ b.values
    if b.joint is None:
        return _product(b, a, directions, gram).T
    return a.values.T @ (gram[:, a.joint, b.joint, None] * b.values)
