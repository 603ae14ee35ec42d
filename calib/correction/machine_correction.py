"""Correction of a machine over its configuration space: geometry fit, remainder, and commands for poses.

KSF(x) = x - IK(GDK(x)): x commanded, GDK the pose it really gives, IK the inverse kinematics as the owner believes it.
It is kept as a fitted geometry (its smooth part) and a remainder rho(x) = x - IK_fitted(GDK(x)). To get a wanted pose,
the command x' is found that solves x' = x + KSF(x') with x = IK(wanted): the fixed point, not only its first step x +
KSF(x).
Source: configuration-space patent, [0024]-[0031], [0130]-[0137].
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, Self, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.interpolation import gaussian_process_interpolation as gaussian_process
from calib.correction.interpolation.gaussian_process_interpolation import Radial
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import Field, RestrictedMap
from calib.correction.interpolation.interpolation_on_grid_of_samples import Simplex
from calib.correction.timed_command_sequence_and_pose_space_correction_map import PoseMap
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    estimate_tolerance_of_stated_geometry,
)
from calib.models.platform.platform_identification import (
    Identified,
    identify_platform,
    inverse_strut_length_jacobian,
    pose_parameter_jacobian,
)
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.effects.framework.parameters_covariates_and_marker_table import PLOT_UNITS
from rig.errors import NotConverged, RigError, Unreachable
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    Parallel,
    require_parallel,
    strut_or_axis_jacobian_by_pose,
)

ITERATIONS = 100
TOLERANCE = 1e-12  # m
ROUNDS = 2  # of fitting the geometry and the remainder in turn


M = TypeVar("M", bound=Commanded)
R = TypeVar("R", bound=Callable[[Floats], Floats])


class Responses(NamedTuple):
    """How poses change (m and rad, on the right). axes : (n, 6, axes) with the axes; back : (n, axes, 6) the axes with
    the pose
    parameters : (n, 6, p) with the geometry's parameters."""

    axes: Floats
    back: Floats
    parameters: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Correction(Generic[M, R]):
    """nominal : the mechanism as its owner believes it; fitted : its smooth part, nominal itself where no parameters
    were sought
    remainder : per axis a Radial or Profile, or None; extension : Field of what is left on top over all axes, or None
    posed : PoseMaps of what these leave, the first first, each of what those before it leave
    physics : names of what a calibration knows besides the configuration: commands by this alone would leave it out,
        and are refused
    """

    nominal: M
    fitted: M
    remainder: tuple[R | None, ...]
    extension: Field | None = field(default=None, kw_only=True)
    posed: tuple[PoseMap, ...] = field(default=(), kw_only=True)
    physics: tuple[str, ...] = field(default=(), kw_only=True)

    @property
    def is_extended(self) -> bool:
        """Whether anything is corrected by a map over configurations or poses."""
        return self.extension is not None or bool(self.posed)

    @property
    def deficient(self) -> bool:
        """Whether the machine has too few axes to take any pose: then it comes as near to wanted ones as it can."""
        return bool(self.nominal.files) and len(self.nominal.pose_coordinates) < 6

    def of_hand(self, hand: str | int) -> Self:
        """The correction of one of several hands, by name or number. Raises RigError: this machine has no hands"""
        raise RigError(f"a mechanism of kind {self.nominal.kind!r} has no hands, so none is chosen: {hand!r}")

    def rho(self, commands: Floats) -> Floats:
        """(..., axes) m, the remainder at commands (..., axes)."""
        commands = np.asarray(commands, float)
        smooth = np.zeros(commands.shape) if self.extension is None else self.extension.value(commands)
        for i, part in enumerate(self.remainder):
            if part is not None:
                smooth[..., i] += part(commands)
        return smooth

    def predict(self, commands: Floats, guess: RigidTransform | None = None) -> RigidTransform:
        """T_base_platform (...) that commands (..., axes) m will really give. Raises NotConverged like the
        mechanism.
        """
        return self.reached_by_maps(
            mechanisms.kinematics_of(self.fitted).forward(
                np.asarray(commands, float) - self.rho(commands), self.fitted, guess
            )
        )

    def reached_by_maps(self, T_base_platform: RigidTransform) -> RigidTransform:
        """The poses (...) at which the machine stands where its geometry alone has it at T (...): maps in pose space
        applied, the first first.
        """
        for one in self.posed:
            T_base_platform = one.applied(T_base_platform)
        return T_base_platform

    def target_poses(self, T_base_platform: RigidTransform) -> RigidTransform:
        """The poses (...) that struts are to be set for so that the machine stands at T (...): maps in pose space
        undone, the last first.

        Raises NotConverged as they do
        """
        for one in reversed(self.posed):
            T_base_platform = one.compensated(T_base_platform)
        return T_base_platform

    def summand(self, commands: Floats) -> Floats:
        """KSF (..., axes) m at commands (..., axes), docs/mathematics.md (19): commanded less what the nominal model
        says for the pose it gives.
        """
        return commands - mechanisms.kinematics_of(self.nominal).inverse(self.predict(commands), self.nominal)

    def single_step(self, T_base_platform: RigidTransform) -> Floats:
        """Commands (..., axes) m of the method's text for wanted poses (...): X + KSF(X), X = IK(wanted).

        `inverse` makes it exact: there KSF is taken where the struts then stand. Source: configuration-space patent,
        [0027], [0030], [0090]
        Raises RigError as `inverse`
        """
        self._refuse_physics()
        x = self.uncorrected(T_base_platform)
        return x + self.summand(x)

    def missed(self, T_base_platform: RigidTransform, commands: Floats) -> Floats:
        """(n, axes) m or rad by which commands (n, axes) differ from those that give wanted poses (n,). Raises
        NotConverged as `inverse`
        """
        return commands - self.inverse_without_physics(T_base_platform)

    def pose_map_standard_error(self, T_base_platform: RigidTransform) -> Floats:
        """(..., 6) m and rad, standard error of what maps in pose space add to poses (...): of the last that holds
        there.
        """
        out = np.zeros((*T_base_platform.shape, 6))
        for one in self.posed:
            weight = (
                one.field.part.weight(one.at(T_base_platform))[0][..., None]
                if isinstance(one.field, RestrictedMap)
                else np.ones(1)
            )
            out = np.sqrt((1 - weight) * out**2 + one.error(T_base_platform) ** 2)
        return out

    def pose_map_covariance(self, T_base_platform: RigidTransform) -> Floats:
        """(..., 6, 6) m and rad, covariance of what maps in pose space add to poses (...)."""
        return np.asarray(self.pose_map_standard_error(T_base_platform)[..., None] ** 2 * np.eye(6))

    def uncorrected(self, T_base_platform: RigidTransform) -> Floats:
        """Commands (..., axes) m that the nominal model gives for wanted poses (...), for comparison."""
        return mechanisms.kinematics_of(self.nominal).inverse(T_base_platform, self.nominal)

    def reached_poses(self, T_base_platform: RigidTransform, commands: Floats) -> RigidTransform:
        """The poses (n,) that commands (n, axes) found for wanted poses (n,) give: these themselves, but for a machine
        of too few axes.
        """
        return self.predict(commands) if self.deficient else T_base_platform

    def goal(self, T_base_platform: RigidTransform, near: Floats) -> Floats:
        """(n, axes) m or rad that the fitted geometry has to get for poses (n,). near : (n, axes), commands where there
        is more than one way. Raises NotConverged as `target_poses`
        """
        return mechanisms.kinematics_of(self.fitted).inverse(self.target_poses(T_base_platform), self.fitted)

    def responses(self, T_base_platform: RigidTransform, effective: Floats) -> Responses:
        """Responses at poses (n,), of which the fitted geometry gets effective (n, axes) m or rad."""
        fitted = require_parallel(self.fitted)
        return Responses(
            inverse_strut_length_jacobian(T_base_platform, fitted),
            strut_or_axis_jacobian_by_pose(T_base_platform, fitted),
            pose_parameter_jacobian(T_base_platform, fitted),
        )

    def scattering(self, scatter: Floats, responses: Responses) -> Floats:
        """(n, 6, k) m and rad, factor of the covariance by which poses scatter. scatter : as a Calibration has it, of
        each strut
        """
        return responses.axes * scatter

    def inverse(self, T_base_platform: RigidTransform) -> Floats:
        """Commands (..., axes) m that give wanted poses (...), to 1e-12 m, docs/mathematics.md (20); limits are for
        `require_commands_in_axis_ranges` to check.

        Raises RigError where a calibration knows physics besides, NotConverged with index, commands and residual (m)
        where the fixed point is not found
        """
        self._refuse_physics()
        return self.inverse_without_physics(T_base_platform)

    def inverse_without_physics(self, T_base_platform: RigidTransform) -> Floats:
        """The commands (..., axes) of `inverse` by the configuration alone, whatever else a calibration knows. Raises
        NotConverged as `inverse`
        """
        fitted = mechanisms.kinematics_of(self.fitted)
        return self.settled(fitted.inverse(self.target_poses(T_base_platform), self.fitted))

    def _refuse_physics(self) -> None:
        """Raise RigError where commands by the configuration alone would leave known physics out."""
        if self.physics:
            raise RigError(
                f"this calibration includes physics that commands must compensate ({', '.join(self.physics)}), and "
                "a correction by "
                "configuration alone omits it: use calib.correct(calibration, wanted), which gives "
                "the same as `rig correct`"
            )

    def near(self, T_base_platform: RigidTransform, guess: Floats) -> Floats:
        """Commands (n, axes) as `inverse` for poses (n,), NaN where none is found. guess : (n, axes), what is near."""
        out, rest = np.full((len(T_base_platform), len(self.nominal.axes)), np.nan), np.arange(len(T_base_platform))
        while len(rest):
            try:
                out[rest] = self.inverse_without_physics(T_base_platform[rest])
                break
            except (NotConverged, Unreachable) as error:
                rest = np.delete(rest, error.index)
        return out

    def settled(self, goal: Floats) -> Floats:
        """Commands c (..., axes) m or rad with c = goal + rho(c): those that make the struts as long as the fitted
        model wants them.

        Raises NotConverged as `inverse`
        """
        if isinstance(self.extension, Simplex) and not any(self.remainder):
            commands, change = self.extension.fixed_points(goal.reshape(-1, goal.shape[-1]), TOLERANCE)
            return self._found(commands, change).reshape(goal.shape)
        commands = goal.copy()
        for _ in range(ITERATIONS):
            new = goal + self.rho(commands)
            change, commands = np.abs(new - commands).max(axis=-1), new
            if change.max(initial=0) < TOLERANCE:
                break
        return self._found(commands, change)

    def _found(self, commands: Floats, change: Floats) -> Floats:
        """The commands (..., axes) of a fixed point; raises NotConverged where its last step still changed them
        (...).
        """
        failed = np.flatnonzero(~(np.ravel(change) < TOLERANCE))
        if len(failed):
            raise NotConverged(
                f"the corrected command of {len(failed)} poses was not found",
                failed,
                commands.reshape(-1, commands.shape[-1])[failed],
                np.ravel(change)[failed],
            )
        return commands


AnyCorrection = Correction[Any, Any]  # of any kind of machine: which one is known only once a file is read


def solvable_commands_and_poses(commands: Floats, correction: AnyCorrection) -> tuple[Floats, RigidTransform]:
    """Commands whose forward kinematics has a solution, and these poses (k,).

    Raises NotConverged where none has.
    """
    index, T = indices_and_poses_of_solvable_commands(commands, correction.predict)
    return commands[index], T


def indices_and_poses_of_solvable_commands(
    commands: Floats, predict: Callable[[Floats], RigidTransform]
) -> tuple[Integers, RigidTransform]:
    """Indices (k,) of commands whose forward kinematics has a solution, and these poses (k,).

    Raises NotConverged where none does
    """
    index = np.arange(len(commands))
    while True:
        try:
            return index, predict(commands[index])
        except NotConverged as error:
            index = np.delete(index, error.index)
            if not len(index):
                raise


def require_commands_in_axis_ranges(commands: Floats, mechanism: Parallel | Arm | Chain, labels: Sequence[str]) -> None:
    """Raise Unreachable where commands leave the mechanism's range.

    Every pose is listed whose commands (n, axes) m or rad do.
    labels : n texts
    """
    places = mechanisms.axis_place_texts(mechanism)
    shown = [PLOT_UNITS[unit] for unit in mechanisms.axis_units(mechanism)]
    beyond = mechanisms.kinematics_of(mechanism).signed_limit_excess(commands, mechanism)
    bad = np.flatnonzero((beyond != 0).any(axis=1))
    if not len(bad):
        return
    lines = []
    for i in bad.tolist():
        axes = [
            f"{places[j]} at {commands[i, j] * scale:.3f} {unit}, {abs(beyond[i, j]) * scale:.3f} {unit} "
            f"{'below' if beyond[i, j] < 0 else 'above'} its range"
            for j in np.flatnonzero(beyond[i])
            for scale, unit in (shown[j],)
        ]
        lines.append(f"{labels[i]}: " + "; ".join(axes))
    raise Unreachable(f"{len(bad)} of {len(commands)} wanted poses cannot be reached:", bad, lines)


def identify_geometry(samples: Samples, nominal: Parallel, similar_fit: Identified | None = None) -> Identified:
    """Geometry identified from samples.

    No remainder is taken off.
    similar_fit : Identified of most of the same samples, whose prior is taken over, or None: these samples show how
    good the owner's figures are. Raises NotEnoughData as `identify_platform` does
    """
    if similar_fit is None:
        first = identify_platform(samples, nominal)
        return identify_platform(
            samples, nominal, prior=estimate_tolerance_of_stated_geometry(first, nominal).prior, similar_fit=first
        )
    return identify_platform(samples, nominal, prior=similar_fit.prior, similar_fit=similar_fit)


def fit_geometry_and_remainder_of_correction(
    samples: Samples,
    nominal: Parallel,
    remainder: str | tuple[Radial | None, ...] = "find",
    geometry: Identified | None = None,
    axes_with_remainder: Booleans | None = None,
) -> tuple[Correction[Parallel, Radial], Identified]:
    """Correction with geometry and remainder fitted to samples.

    Geometry fitted, then its remainder extended.
    samples : Samples; nominal : the owner's
    remainder : "find" keeps a strut's where it stands out of the noise; "none" fits the geometry alone; a tuple of
    Radial or None takes over size and smoothness from there; geometry : `identify_geometry` of the same, where it is
    known already
    axes_with_remainder : (axes,) bool, the struts that may have one where it is to be found; all by default
    Returns (Correction, Identified)
    Raises RigError for a machine without struts, NotEnoughData as `identify`
    """
    nominal = require_parallel(nominal)
    found = identify_geometry(samples, nominal) if geometry is None else geometry
    parts: tuple[Radial | None, ...] = (None,) * len(nominal.axes)
    like = remainder if isinstance(remainder, tuple) else parts
    if (
        remainder == "none"
        or (remainder == "find" and not found.scatter.any())
        or (like is remainder and not any(like))
    ):
        return Correction(nominal, found.mechanism, parts), found
    may = np.ones(len(nominal.axes), bool) if axes_with_remainder is None else axes_with_remainder
    for _ in range(ROUNDS):
        parts = _remainder(samples, found, nominal, parts, like, may)
        found = identify_platform(
            samples, nominal, Correction(nominal, nominal, parts).rho(samples.effective), found.prior, found
        )
        if remainder == "find":
            if not any(parts):
                break
            like = parts
    return Correction(nominal, found.mechanism, parts), found


def _remainder(
    samples: Samples,
    found: Identified,
    nominal: Parallel,
    before: tuple[Radial | None, ...],
    like: tuple[Radial | None, ...],
    may: Booleans,
) -> tuple[Radial | None, ...]:
    """Per strut a Radial of what the geometry leaves; without one to be like, where it leaves more than noise, or
    None.
    """
    good = found.inliers
    left = found.residuals + Correction(nominal, nominal, before).rho(samples.effective)
    variances = np.einsum("nii->ni", found.residual_covariance)
    given, ranges = any(like), mechanisms.kinematics_of(nominal).travel_ranges(nominal)

    def part(i: int) -> Radial | None:
        if (like[i] is None) if given else not (found.scatter[i] and may[i]):
            return None
        return gaussian_process.fit_gaussian_process(
            samples.effective[good], left[good, i], variances[good, i], i, ranges, like[i]
        )

    axes = range(len(like))
    return tuple([part(i) for i in axes] if given else parallel_map(part, axes, items_per_process=1))
