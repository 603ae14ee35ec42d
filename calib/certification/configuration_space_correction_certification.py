"""Certification of corrections extended over the configuration space, by held-out configurations."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from calib.certification.claimed_error_reduction_over_workspace import (
    DRAWS,
    PLACES,
    Claim,
    ConfigurationInformation,
    Workspace,
    claim_from_machine_draws,
    empty_claim_of_too_few_configurations,
    mean_square_pose_errors_stated_by_extension,
    workspace_commands_and_corrected_poses,
)
from calib.certification.held_out_pose_error_statistics import (
    HeldOut,
    compare_errors,
    draw_mean_square_common_pose_errors,
    is_significant_gain,
    mean_square_held_out_errors_by_configuration,
    mean_square_pose_errors_caused_by_parameters,
    pose_errors,
)
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    LEAST,
    axis_travel_limits,
    configuration_numbers,
    mean_sample_per_configuration,
    time_block_folds_of_configurations,
)
from calib.certification.platform_certification import (
    FOLDS,
    SURELY,
    Certified,
    Progress,
    draw_and_add_possible_machines,
    draw_strut_deviation_sizes_beyond_geometry,
    ignore_progress,
    uncertified_geometry,
)
from calib.correction import correction_field_methods_fitting_combination_and_json
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    fit_correction_summand_field,
    fitted_or_nominal_geometry,
    identified_geometry_correction_with_field,
    residual_correction_summands_at_samples,
)
from calib.correction.interpolation.gaussian_process_interpolation import RadialMap
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    Field,
    FieldSamples,
    WeightedField,
)
from calib.correction.interpolation.interpolation_on_grid_of_samples import Grid, grid_lattice_of_configurations
from calib.correction.machine_correction import AnyCorrection, solvable_commands_and_poses
from calib.models.platform.platform_identification import (
    Identified,
    identify_platform,
    inverse_strut_length_jacobian,
    pose_parameter_jacobian,
)
from calib.samples.commanded_and_measured_pose_samples import Samples, pose_covariance_pseudoinverse
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, Parallel, is_redundant
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import FILL, evenly_spread_configurations

AUTO = "auto"
ELSE = "direction, order, temperature or noise explain the residuals as well as the configuration does"
NONE_LOST: Floats = np.zeros((0, 0))
NOTHING_HELD_OUT = "no configurations could be held out of these, by which methods are compared"
NONE = "none"  # of the ways: the geometry, or the nominal model, as it is


class ExtensionRequest(NamedTuple):
    """kind : one of `METHODS` of the interpolation methods, or AUTO; alone : whether on the nominal model instead of
    on top of a fitted geometry.
    """

    kind: str
    alone: bool


class ExtensionBasis(NamedTuple):
    """known : what is to be extended, of some samples; correct : the Correction that it stands on with a Field of that
    on top, or None
    stated_square : mean square (m^2) by which a Field says that positions of other samples may be off."""

    known: FieldSamples
    correct: Callable[[Field | None], AnyCorrection]
    stated_square: Callable[[Field, Samples], float]


class Tried(NamedTuple):
    """A way to extend: held_out : HeldOut, or None; reason : why it could not be tried, or not be taken, or None;
    chosen : whether it was taken; lost : (k, axes) vertices of its grid that were not measured, whose values are
    estimated from the others.
    """

    kind: str
    held_out: HeldOut | None
    reason: str | None
    chosen: bool
    lost: Floats = NONE_LOST


def certify_extended_correction(
    samples: Samples,
    nominal: Parallel,
    request: ExtensionRequest,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Certified, tuple[Tried, ...]]:
    """Certify an extended correction on held-out configurations.

    It is extended over the space.
    Of samples on a grid whole levels are held out in turn, so that what remains is a grid, and where there are LEAST
    configurations besides it, these; else whole stretches. AUTO takes what leaves least there, weighed by the poses'
    covariance, if that is a significant gain against doing without. Raises RigError where the way asked for does not
    take these samples

    Returns (Certified, methods tried)
    """
    report = progress or ignore_progress
    label = configuration_numbers(samples.commanded, axis_travel_limits(nominal))
    report("fitting the geometry", 0, 1)
    found = fitted_or_nominal_geometry(samples, nominal, request.alone)
    sizes = (
        None
        if request.alone or label.max() + 1 < LEAST
        else draw_strut_deviation_sizes_beyond_geometry(samples, uncertified_geometry(nominal, found, label), rng)
    )
    report("fitting the geometry", 1, 1)

    def stand(some: Samples) -> ExtensionBasis:
        geometry = found if some is samples else fitted_or_nominal_geometry(some, nominal, request.alone, found.prior)
        return ExtensionBasis(
            residual_correction_summands_at_samples(some, geometry),
            lambda field: identified_geometry_correction_with_field(nominal, geometry, field),
            lambda field, at: mean_stated_position_variance(field, at, nominal),
        )

    against = None if sizes is None or (sizes.of_place() > SURELY).any() else ELSE
    done, tried = certify_interpolation_method(
        samples, (nominal, label, found), stand, request.kind, rng, report, against
    )
    field = done.correction.extension
    if field is not None:
        done = replace(done, found=_without(samples, nominal, found, field, request.alone))
    elif sizes is not None:  # the geometry as it is, of which more is known
        return draw_and_add_possible_machines(samples, replace(done, left=None), sizes, rng), tried
    return _with_scatter(samples, done, rng), tried


def _with_scatter(samples: Samples, done: Certified, rng: np.random.Generator) -> Certified:
    """The Certified of an extension, its scatter no less than what was left at configurations held out, that freed of
    the parameters' errors.
    """
    if done.left is None:
        return done
    correction, found = done.correction, done.found
    J, out = (
        pose_parameter_jacobian(samples.T_base_platform, correction.fitted),
        inverse_strut_length_jacobian(samples.T_base_platform, correction.fitted),
    )
    noise = samples.covariance + (out * found.scatter**2) @ np.swapaxes(out, 1, 2)
    part = time_block_folds_of_configurations(done.label, min(FOLDS, done.label.max() + 1))
    left = replace(done.left, parameters=mean_square_pose_errors_caused_by_parameters(J, found.covariance, noise, part))
    commands, T = workspace_commands_and_corrected_poses(correction)
    back = inverse_strut_length_jacobian(T, correction.fitted)
    stated = float(mean_square_pose_errors_stated_by_extension(correction, commands, back)[0])
    own = np.sqrt(max(left.own(stated, rng)[0] - stated, 0.0) / (back[:, :3] ** 2).sum(axis=(1, 2)).mean())
    return replace(done, left=left, found=replace(found, scatter=np.maximum(found.scatter, own)))


def certify_interpolation_method(
    samples: Samples,
    basis: tuple[Commanded, Integers, Any],  # Any: what identified the geometry, of each kind of machine its own
    basis_of_samples: Callable[[Samples], "ExtensionBasis"],
    kind: str,
    rng: np.random.Generator,
    progress: Progress,
    refusal_reason: str | None = None,
) -> tuple[Certified, tuple[Tried, ...]]:
    """Certify an interpolation method for an extension.

    It is one method, or the best of all by held-out errors; those tried are returned too.
    basis : nominal, label (n,) of the samples, the geometry; refusal_reason : why none is to be taken of all ways, or
        None
    """
    nominal, label, found = basis
    known, correct, stated_square = basis_of_samples(samples)
    fields: dict[str, Field | None] = {NONE: None}
    refused: dict[str, str] = {}
    for name in correction_field_methods_fitting_combination_and_json.METHODS if kind == AUTO else (kind,):
        progress(f"extending: {name}", 0, 1)
        try:
            fields[name] = fit_correction_summand_field(known, name)
        except RigError as error:
            if kind != AUTO:
                raise
            refused[name] = str(error)
    splits = _splits(samples, label, nominal)
    outcome = None if not splits else _held_out(samples, basis_of_samples, fields, splits, progress)
    auto = kind == AUTO
    kind = kind if not auto else NONE if outcome is None or refusal_reason is not None else _best(outcome)
    held = (
        {}
        if outcome is None
        else {
            name: compare_errors(outcome.before, errors, outcome.samples.total_covariance(), rng, label[outcome.rows])
            for name, errors in outcome.after.items()
        }
    )
    grid = grid_lattice_of_configurations(known.configurations, known.strokes)
    lost = NONE_LOST if grid is None else grid.lost
    reason = refusal_reason or (NOTHING_HELD_OUT if outcome is None else None)
    tried = [
        Tried(
            name,
            held.get(name),
            reason if auto and name != NONE else None,
            name == kind,
            lost if isinstance(field, Grid) else NONE_LOST,
        )
        for name, field in fields.items()
    ]
    tried += [Tried(name, None, reason, False) for name, reason in refused.items()]
    field = fields[kind]
    if outcome is None:
        return Certified(correct(field), found, label, None), tuple(tried)
    left = mean_square_held_out_errors_by_configuration(
        outcome.after[kind], outcome.samples, label[outcome.rows], outcome.stated_square[kind]
    )
    if outcome.is_as_dense and left.stated:  # where noise explains all that is left, there is no error to scale
        scale = float(np.sqrt(left.beyond()[0] / left.stated))
        if isinstance(field, WeightedField):
            field, left = replace(field, misfit=field.misfit * scale), replace(left, scale=scale)
        elif isinstance(field, RadialMap):
            field, left = replace(field, inflation=max(1.0, scale)), replace(left, scale=max(1.0, scale))
    repeated = mean_square_held_out_errors_by_configuration(
        pose_errors(correct(field).predict(samples.effective), samples), samples, label
    ).beyond()
    return Certified(correct(field), found, label, held[kind], left=replace(left, fitted=float(repeated[0]))), tuple(
        tried
    )


def _without(samples: Samples, nominal: Parallel, found: Identified, field: Field, alone: bool) -> Identified:
    """The Identified once its field is taken off: what the field corrects is no scatter of the struts and widens no
    parameter.
    """
    summands = field.value(samples.commanded)
    if not alone:
        repeated = identify_platform(samples, nominal, summands, found.prior)
        found = replace(found, covariance=repeated.covariance, root=repeated.root, scatter=repeated.scatter)
    return replace(found, residuals=found.residuals - summands)


class _Outcome(NamedTuple):
    """Of the rows (m,) held out, as Samples: before (m, 6), and after, by each way, (m, 6); is_as_dense : whether what
    was fitted was as dense;
    stated_square : m^2, mean square by which the fields that each way made without these rows say that their positions
        may be off."""

    is_as_dense: bool
    stated_square: dict[str, float]
    rows: Integers
    samples: Samples
    before: Floats
    after: dict[str, Floats]


def _splits(samples: Samples, label: Integers, nominal: Commanded) -> list[tuple[Booleans, Booleans]]:
    """[(fitted (n,) bool, held out (n,) bool)]; none where there are fewer than LEAST configurations, or where no
    level of a grid can be left out of it.
    """
    if label.max() + 1 < LEAST:
        return []
    found = grid_lattice_of_configurations(samples.commanded, axis_travel_limits(nominal))
    if found is None:
        fold = time_block_folds_of_configurations(label, min(FOLDS, label.max() + 1))
        return [(fold != k, fold == k) for k in np.unique(fold)]
    on = found.vertex >= 0
    if len(np.unique(label[~on])) >= LEAST:
        return [(on, ~on)]
    shape = [len(level) for level in found.levels]
    place = np.unravel_index(np.maximum(found.vertex, 0), shape)
    planes = [on & (place[i] == k) for i, count in enumerate(shape) for k in range(1, count - 1)]
    every = max(1, -(-len(planes) // (2 * FOLDS)))
    limits = axis_travel_limits(nominal)
    splits = [(on & ~plane, plane) for plane in planes[::every]]
    return [one for one in splits if grid_lattice_of_configurations(samples.commanded[one[0]], limits) is not None]


def _held_out(
    samples: Samples,
    stand: Callable[[Samples], "ExtensionBasis"],
    fields: dict[str, Field | None],
    splits: list[tuple[Booleans, Booleans]],
    progress: Progress,
) -> _Outcome:
    rows, before, after = [], [], {name: list[Floats]() for name in fields}
    squares = dict.fromkeys(fields, 0.0)
    progress("cross-validating configurations", 0, len(splits))
    for k, (fitted, out) in enumerate(splits):
        rest = samples.take(out)
        known, correct, stated_square = stand(samples.take(fitted))
        rows.append(np.flatnonzero(out))
        owners = correct(None).nominal  # of an arm, as the rest of the samples place it
        before.append(pose_errors(mechanisms.kinematics_of(owners).forward(rest.commanded, owners), rest))
        for name, field in fields.items():
            own = None if field is None else fit_correction_summand_field(known, name, field)
            after[name].append(pose_errors(correct(own).predict(rest.commanded), rest))
            squares[name] += 0.0 if own is None else len(rest) * stated_square(own, rest)
        progress("cross-validating configurations", k + 1, len(splits))
    at = np.concatenate(rows)
    dense = all(fitted.sum() >= len(samples) * (1 - 1 / FOLDS) - 1 for fitted, _ in splits) or len(splits) == 1
    means = {name: total / len(at) for name, total in squares.items()}
    return _Outcome(
        dense,
        means,
        at,
        samples.take(at),
        np.concatenate(before),
        {name: np.concatenate(errors) for name, errors in after.items()},
    )


def mean_stated_position_variance(field: Field, samples: Samples, nominal: Parallel) -> float:
    """Mean of the position variance that a Field states at samples, m^2."""
    back = inverse_strut_length_jacobian(samples.T_base_platform, nominal)
    return float((back[:, :3] ** 2 @ (field.error(samples.commanded) ** 2)[..., None]).sum(axis=1).mean())


def _best(outcome: _Outcome) -> str:
    """The way that leaves least, if that is a significant gain against doing without."""
    covariance = outcome.samples.total_covariance()
    weight = pose_covariance_pseudoinverse(
        np.where(np.isinf(covariance), 1.0, covariance)
    )  # what was not measured has no error to weigh
    loss = {
        name: np.einsum("ni,nij,nj->n", e, weight, e)
        for name, e in ((name, np.nan_to_num(errors)) for name, errors in outcome.after.items())
    }
    best = min(loss, key=lambda name: loss[name].mean())
    return best if is_significant_gain(loss[NONE] - loss[best]) else NONE


def claim_without_geometry(samples: Samples, certified: Certified, rng: np.random.Generator) -> Claim:
    """Claim of a correction without fitted geometry.

    Its field's error estimate over the workspace.
    """
    correction: AnyCorrection = certified.correction
    kinematics = mechanisms.kinematics_of(correction.nominal)
    each = mean_sample_per_configuration(
        samples, certified.label, inverse_strut_length_jacobian(samples.T_base_platform, correction.nominal)
    )
    information = ConfigurationInformation(
        len(each), 0, 0, 0, f"no parameters were fitted: the summands are extended by {extension_in_words(correction)}"
    )
    free = "closing on a pose" if is_redundant(correction.nominal) else "independent"
    middle = f"the middle {FILL * 100:.0f} % of every stroke, all axes {free}"
    if len(each) < LEAST:
        return empty_claim_of_too_few_configurations(information, middle)
    if certified.left is None:
        return empty_claim_without_held_out_data(information, middle)
    commands, T = solvable_commands_and_poses(evenly_spread_configurations(correction.nominal, PLACES), correction)
    offset = pose_difference(T, kinematics.forward(commands, correction.nominal))
    stated = float(
        mean_square_pose_errors_stated_by_extension(
            correction, commands, inverse_strut_length_jacobian(T, correction.fitted)
        )[0]
    )
    own = certified.left.own_draws(stated, DRAWS, rng) + draw_mean_square_common_pose_errors(samples, DRAWS, rng)
    known = certified.found.covariance  # of what an earlier pass left, where this one does not hold
    draws = (
        rng.multivariate_normal(np.zeros(len(known)), known, DRAWS, method="eigh")
        if known.any()
        else np.zeros((DRAWS, len(known)))
    )
    return claim_from_machine_draws(
        Workspace(pose_parameter_jacobian(T, correction.nominal), -offset, own, middle), draws, each, information, rng
    )


def extension_in_words(correction: AnyCorrection) -> str:
    """By what a correction is extended, over configurations and over poses, in words."""
    methods = [] if correction.extension is None else [correction.extension.kind]
    methods += [f"{one.field.kind} in pose space" for one in correction.posed]
    return " and ".join(methods) or "nothing at all"


def empty_claim_without_held_out_data(information: ConfigurationInformation, workspace: str) -> Claim:
    """Empty claim, with its reason, where no configuration could be held out."""
    return replace(
        empty_claim_of_too_few_configurations(information, workspace),
        reason="no configuration could be held out, so the error between those recorded is unknown; record "
        f"{LEAST} beside the grid, as the plan `division:2,sobol:{2 * LEAST}` does",
    )
