"""Claimed reduction of pose errors over the workspace by a calibration.

A posterior at configurations not recorded.

Machines are drawn that are as the poses have them, where the poses tell, and as the owner's tolerance has them, where
these do not: so what is promised away from the recorded configurations holds how far it is extrapolated. Each drawn
machine is driven all over the middle of the strokes, once by the nominal model and once by the calibrated one; the
ratio of the two RMS errors, from draw to draw, is the claim, docs/mathematics.md (21) in draws. How much noise and
misfit there is, is drawn as well (chi-square: few configurations tell it badly).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.held_out_pose_error_statistics import HeldErrors
from calib.certification.held_out_pose_errors_and_distinct_configurations import LEAST
from calib.certification.strut_deviation_size_sampler_and_possible_machine_errors import Machines
from calib.certification.workspace_beyond_recorded_poses import sentences_on_workspace_beyond_recorded_poses
from calib.correction.interpolation.gaussian_process_interpolation import Radial
from calib.correction.machine_correction import (
    AnyCorrection,
    Correction,
    indices_and_poses_of_solvable_commands,
    solvable_commands_and_poses,
)
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import Tolerance, expand_parameter_widths
from calib.models.platform.platform_identification import (
    PRIOR,
    Identified,
    inverse_strut_length_jacobian,
    pose_parameter_jacobian,
)
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Parallel, geometric_parameters, has_struts, is_redundant
from rig.model.mechanisms.user_kinematics_file_mechanism import SCALE
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import FILL, evenly_spread_configurations

PLACES = 128  # of the workspace
DRAWS = 1000
TRUSTED = 20  # degrees of freedom that the poses' stated covariance is worth beside what their residuals say of it
LEAST_ERROR = 1e-12  # m, below which no error counts
EDGES = (0.5, 0.025, 0.975)
# times the logarithms of drawn errors about their median: what the draws leave out, as driven machines of an
# independent truth show it
WIDER = 1.2


@dataclass(frozen=True, slots=True)
class Claim:
    """distinct : configurations recorded; determined : combinations, of `unknowns`, that the poses tell at all (of a
    hexapod: to 5 mm);
    better : those that they tell better than the owner's figures are good; tolerance : how good these are, in words
    workspace : what is meant, in words
    before, after : RMS pose error all over it by the nominal model and corrected, (position m, rotation rad), each
    (median, low, high) with 95 % between; ratio : before / after in position; measured : the same as the recording's
    own instrument would see it; each (median, low, high), None where no factor is claimed; reason : why none is, or
    None
    unexplained : what the poses show that neither noise nor the claim explains, a sentence each; what stands here
        forbids "good"
    unrecorded : a sentence on the parts of the workspace beyond all recorded poses, none where there are no such parts
    """

    distinct: int
    determined: int
    better: int
    unknowns: int
    tolerance: str
    workspace: str
    before: tuple[tuple[float, ...], ...] | None
    after: tuple[tuple[float, ...], ...] | None
    ratio: tuple[float, ...] | None
    measured: tuple[float, ...] | None
    reason: str | None = None
    unexplained: tuple[str, ...] = ()
    unrecorded: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("before", "after", "ratio", "measured"):
            values = getattr(self, name)
            if values is not None and not np.isfinite(values).all():
                raise ValueError(
                    f"{name} of a claim is {values}, expected finite figures, or None where none is claimed"
                )


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """At m places: jacobian (m, 6, k) of the pose's tangent with the parameters; offset (m, 6) pose error of the
    nominal model against the corrected one; own (2,) or (d, 2) m^2 and rad^2, mean square of what no model corrects, or
    draws of it; words : what is meant by it."""

    jacobian: Floats
    offset: Floats
    own: Floats
    words: str

    def squares(self, draws: Floats) -> Floats:
        """(before, after), each (d, 2) m^2 and rad^2, mean over the places, of machines that are draws (d, k) from the
        corrected model.
        """
        out = np.empty((2, len(draws), 2))
        for c, part in enumerate((slice(0, 3), slice(3, 6))):
            J, offset = self.jacobian[:, part].reshape(-1, self.jacobian.shape[2]), self.offset[:, part].ravel()
            Q, m = J.T @ J, len(self.jacobian)
            after = np.einsum("di,ij,dj->d", draws, Q, draws)
            before = after + 2 * draws @ (J.T @ offset) + offset @ offset
            out[:, :, c] = np.stack([before, after]) / m + self.own[..., c]
        return out


class ConfigurationInformation(NamedTuple):
    """What recorded poses tell, as in Claim."""

    distinct: int
    determined: int
    better: int
    unknowns: int
    tolerance: str


def claim_from_machine_draws(
    workspace: Workspace,
    draws: Floats,
    samples: Samples,
    information: ConfigurationInformation,
    rng: np.random.Generator,
) -> Claim:
    """Claim of pose errors over the workspace from drawn machines.

    The machines (d, k) are drawn about the corrected model.
    samples : Samples, for what their instrument adds.

    information : ConfigurationInformation by the poses that the machines were drawn from; rng : numpy Generator
    """
    before, after = workspace.squares(draws)
    return claim_from_mean_square_errors(before, after, workspace.words, samples, information, rng)


def claim_from_mean_square_errors(
    before: Floats,
    after: Floats,
    reference_name: str,
    samples: Samples,
    information: ConfigurationInformation,
    rng: np.random.Generator,
) -> Claim:
    """Claim of pose errors over the workspace from mean square errors.

    The mean squares before and after correction are (d, 2), m^2 and rad^2.
    reference_name : what is meant by it
    """
    count, after = len(after), _wider(after)
    seen = np.full(count, np.trace(samples.covariance[:, :3, :3], axis1=1, axis2=2).mean())
    if samples.common.shape[2]:
        shared = samples.common[:, :3] @ rng.normal(size=(samples.common.shape[2], count))
        seen = seen + (shared**2).sum(axis=1).mean(axis=0)
    least = max(
        float(seen.mean()) / len(samples), LEAST_ERROR**2
    )  # the mean square that so many poses' noise leaves unnoticed
    ratio = np.sqrt(np.maximum(before[:, 0], least) / np.maximum(after[:, 0], least))
    measured = np.sqrt((np.maximum(before[:, 0], least) + seen) / (np.maximum(after[:, 0], least) + seen))
    return Claim(*information, reference_name, _both(before), _both(after), _three(ratio), _three(measured))


def _wider(squares: Floats) -> Floats:
    """Draws (d, 2) of mean squares, spread about their medians by WIDER."""
    middle = np.median(squares, axis=0)
    share = np.divide(squares, middle, out=np.ones_like(squares), where=middle > 0)
    return np.where(middle > 0, middle * share**WIDER, squares)


def _three(values: Floats) -> tuple[float, ...]:
    return tuple(float(value) for value in np.quantile(values, EDGES))


def _both(squares: Floats) -> tuple[tuple[float, ...], ...]:
    return tuple(_three(np.sqrt(column)) for column in squares.T)


def empty_claim_of_too_few_configurations(information: ConfigurationInformation, workspace: str) -> Claim:
    """Empty claim, with its reason, where too few distinct configurations were recorded."""
    return Claim(
        *information,
        workspace,
        None,
        None,
        None,
        None,
        f"{_counted(information.distinct)} do not determine the accuracy at others; a factor takes {LEAST}",
    )


def _counted(distinct: int) -> str:
    return f"{distinct} distinct configuration" + ("" if distinct == 1 else "s")


def draw_variance_ratio(cost: float, degrees_of_freedom: int, count: int, rng: np.random.Generator) -> Floats:
    """Draws (count,) of the ratio of true to stated variances, by a cost and its degrees of freedom.

    cost : whitened squares of a fit, its priors' included; degrees_of_freedom : how many numbers were fitted
    """
    return (TRUSTED + cost) / rng.chisquare(TRUSTED + degrees_of_freedom, count)


def strut_machine_workspace_claim(
    identified: Identified,
    tolerance: Tolerance,
    correction: Correction[Parallel, Radial],
    samples: Samples,
    rng: np.random.Generator,
    machines: Machines | None = None,
    held_out_errors: HeldErrors | None = None,
) -> Claim:
    """Claim over the workspace of a machine on struts.

    By its calibration.
    identified : Identified of one pose a configuration, from which the machines are drawn; tolerance : Tolerance by it;
        correction : Correction
    samples : Samples of one pose a configuration; rng : numpy Generator; machines : Machines drawn with all that struts
    may do beyond their geometry, or None: parameters and scatter alone; held_out_errors : HeldErrors, in place of the
    scatter, of a correction with an extension
    """
    distinct = len(samples)
    determined, better = (
        int((np.linalg.svd(identified.root * width, compute_uv=False) > 1).sum()) for width in (PRIOR, tolerance.prior)
    )
    nominal, fitted = correction.nominal, correction.fitted
    words = "stroke, all struts" if has_struts(nominal) else "travel, all axes"
    free = "closing on a pose" if is_redundant(nominal) else "independent"
    middle = f"the middle {FILL * 100:.0f} % of every {words} {free}"
    information = ConfigurationInformation(
        distinct, determined, better, len(identified.prior), _tolerance_in_words(tolerance)
    )
    if distinct < LEAST:
        return empty_claim_of_too_few_configurations(information, middle)
    commands, T = workspace_commands_and_corrected_poses(correction)
    unrecorded = sentences_on_workspace_beyond_recorded_poses(
        (samples.effective, samples.T_base_platform), (commands, T), mechanisms.axis_place_texts(nominal)
    )
    offset = pose_difference(T, mechanisms.kinematics_of(nominal).forward(commands, nominal))
    back, J = inverse_strut_length_jacobian(T, fitted), pose_parameter_jacobian(T, fitted)
    if machines is not None:
        claim = claim_from_mean_square_errors(
            *machines.squares(J, back, -offset, correction.rho(commands)), middle, samples, information, rng
        )
        corrected = tuple(part is not None for part in correction.remainder)
        axis, units = mechanisms.kinematics_of(nominal).AXIS, mechanisms.axis_units(nominal)
        return replace(claim, unexplained=machines.unexplained(corrected, axis, units), unrecorded=unrecorded)
    stated = mean_square_pose_errors_stated_by_extension(correction, commands, back)
    if held_out_errors is None:
        own = _scatters(identified, rng) @ (back**2).mean(axis=0).reshape(2, 3, -1).sum(axis=1).T + stated
    else:
        own = held_out_errors.own_draws(float(stated[0]), DRAWS, rng)
    draws = _machines(identified, tolerance, nominal, rng) - (
        geometric_parameters(fitted) - geometric_parameters(nominal)
    )
    claim = claim_from_machine_draws(Workspace(J, -offset, own, middle), draws, samples, information, rng)
    return replace(claim, unrecorded=unrecorded)


def workspace_commands_and_corrected_poses(correction: AnyCorrection) -> tuple[Floats, RigidTransform]:
    """Workspace commands, and the corrected machine's poses at them.

    They are commands that have a pose by the nominal model as well: near a singularity only one of the two may have it.
    Returns (commands (m, axes) m, poses (m,) of the corrected machine). Raises NotConverged where none has both
    """
    nominal = correction.nominal
    commands, T = solvable_commands_and_poses(evenly_spread_configurations(nominal, PLACES), correction)
    index, _ = indices_and_poses_of_solvable_commands(
        commands, lambda some: mechanisms.kinematics_of(nominal).forward(some, nominal)
    )
    return commands[index], T[index]


def draw_true_to_stated_pose_variance_ratio_of_fit(
    identified: Identified, nominal: Parallel, count: int, rng: np.random.Generator
) -> Floats:
    """Draws (count,) of the ratio of true to stated pose variances, by a fit's cost and degrees of freedom."""
    return draw_variance_ratio(identified.cost, len(nominal.axes) * int(identified.inliers.sum()), count, rng)


def mean_square_pose_errors_stated_by_extension(
    correction: AnyCorrection, commands: Floats, inverse_jacobian: Floats
) -> Floats:
    """Mean square pose errors (2,) m^2 and rad^2 of a correction's extension.

    At commands (m, axes).
    inverse_jacobian : (m, 6, axes) change of the pose with the axes there
    """
    square = (
        np.zeros((len(commands), 6))
        if not correction.posed
        else correction.pose_map_standard_error(correction.predict(commands)) ** 2
    )
    if correction.extension is not None:
        square = square + (inverse_jacobian**2 @ (correction.extension.error(commands) ** 2)[..., None])[..., 0]
    return np.asarray(square.mean(axis=0).reshape(2, 3).sum(axis=1))


def _machines(found: Identified, tolerance: Tolerance, nominal: Parallel, rng: np.random.Generator) -> Floats:
    """(DRAWS, p) m, parameters less the owner's, drawn from what poses and owner's tolerance leave."""
    pick = rng.choice(len(tolerance.weight), size=DRAWS, p=tolerance.weight)
    inflated = draw_true_to_stated_pose_variance_ratio_of_fit(found, nominal, DRAWS, rng)
    z = rng.normal(size=(DRAWS, len(found.prior)))
    H = (
        tolerance.information / inflated[:, None, None]
        + np.eye(len(found.prior)) / expand_parameter_widths(tolerance.widths, tolerance.counts)[pick][:, :, None] ** 2
    )
    L = np.linalg.cholesky(H)
    mean = np.linalg.solve(H, (tolerance.right / inflated[:, None])[..., None])[..., 0]
    return mean + np.linalg.solve(np.swapaxes(L, 1, 2), z[..., None])[..., 0]


def _scatters(found: Identified, rng: np.random.Generator) -> Floats:
    """(DRAWS, axes) m^2, draws of what each strut scatters by itself, where it was found to: few residuals tell it
    badly.
    """
    count = int(found.inliers.sum())
    freedom = max(count - len(found.prior) // len(found.scatter), 1)
    noise = np.einsum("nii->ni", found.residual_covariance)[found.inliers].mean(axis=0)
    seen = (found.scatter**2 + noise) * freedom / rng.chisquare(freedom, (DRAWS, len(noise)))
    return np.where(found.scatter > 0, np.maximum(seen - noise, 0), 0)


def _tolerance_in_words(tolerance: Tolerance) -> str:
    joints, zeros = tolerance.prior[0], tolerance.prior[-1]
    if not tolerance.counts[1]:
        return f"parameters good to {joints / SCALE:.2g} of their tolerances, as these poses indicate"
    return (
        f"joints good to {joints * 1e3:.2g} mm and zeros to {zeros * 1e3:.2g} mm a coordinate, as these poses indicate"
    )
