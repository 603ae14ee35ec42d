"""Correction fields: interpolation methods by name, fitting, combination and JSON.

The methods fit these fields over the space to correction summands at samples.

KSF_PM(x) = x - IK(GDK(x)) at each sample x; KSF_KR is its Field over all of the configuration space. It stands alone,
with the nominal model as IK, or on top of the fitted geometry, where it extends what that leaves.
Source: configuration-space patent, [0026] to [0030], [0126] to [0137]
"""

from collections.abc import Callable
from dataclasses import fields as parts_of
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction import timed_command_sequence_and_pose_space_correction_map
from calib.correction.interpolation.delaunay_interpolation_and_grid_interpolation_kernels import Delaunay
from calib.correction.interpolation.gaussian_process_interpolation import Radial, RadialMap
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    Field,
    FieldSamples,
    RestrictedMap,
    SpacePart,
    SummedPasses,
)
from calib.correction.interpolation.interpolation_on_grid_of_samples import Linear, Simplex
from calib.correction.interpolation.polynomial_and_axis_sum_fields import AxisFunctions, Polynomial
from calib.correction.machine_correction import AnyCorrection, Correction, solvable_commands_and_poses
from calib.correction.timed_command_sequence_and_pose_space_correction_map import NAMES, PoseMap, PoseSpace
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    estimate_tolerance_of_stated_geometry,
)
from calib.models.platform.platform_identification import PRIOR, Identified, identify_platform
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.json_toml_and_yaml_loading import json_data
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    Parallel,
    geometric_parameters,
    is_parallel,
    strut_or_axis_jacobian_by_pose,
)
from rig.model.pose import pose_file_entry
from rig.planning.configuration_generators import evenly_spread_configurations

SHAPES = {  # of the arrays: a axes, m outputs, the other letters any number, the same wherever they stand
    **dict.fromkeys(("linear", "simplex"), {"levels": "ragged", "values": "nm", "variances": "nm", "misfit": "m"}),
    "delaunay": {"centre": "a", "half": "a", "samples": "na", "values": "nm", "variances": "nm", "misfit": "m"},
    "axes": {"knots": "ac", "coefficients": "fm", "root": "fk", "noise": "m", "misfit": "m"},
    "polynomial": {
        "low": "a",
        "high": "a",
        "powers": "fa",
        "coefficients": "fm",
        "root": "fk",
        "noise": "m",
        "misfit": "m",
    },
}
METHODS = {one.kind: one for one in (Linear, Simplex, Delaunay, AxisFunctions, RadialMap, Polynomial)}


def fit_field(kind: str, samples: FieldSamples) -> Field:
    """Field of a kind fitted to samples.

    Raises RigError for an unknown kind, and what the kind raises.
    """
    if kind not in METHODS:
        raise RigError(f"there is no method {kind!r} to extend corrections; available: {', '.join(METHODS)}")
    return METHODS[kind].fit(samples)


def field_to_dict(field: Field) -> Json:
    """dict of a Field, as JSON holds it."""
    if isinstance(field, SummedPasses):
        return {"kind": field.kind, "fields": [field_to_dict(one) for one in field.fields]}
    if isinstance(field, RestrictedMap):
        return {
            "kind": field.kind,
            "field": field_to_dict(field.field),
            "low": _bounds(field.part.low),
            "high": _bounds(field.part.high),
        }
    parts = parts_of(field)  # type: ignore[arg-type]
    return {"kind": field.kind} | {part.name: json_data(getattr(field, part.name)) for part in parts if part.init}


def _bounds(values: Floats) -> list[float | None]:
    """Bounds of a part; null where there is none."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _part(table: Entries, axes: int) -> SpacePart:
    low, high = (table.array(name, (axes,), nulls=True) for name in ("low", "high"))
    try:
        return SpacePart(np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high))
    except ValueError as error:
        table.fail(f"{table.name('low')}: {error}", "low")


def field_from_entries(entries: Entries, axes: int) -> Field:
    """Field over so many axes from its entries, as `field_to_dict` gives them.

    Raises FileError for anything else.
    """
    named = entries.text("kind", (*METHODS, SummedPasses.kind, RestrictedMap.kind))
    if named == SummedPasses.kind:
        return SummedPasses(tuple(field_from_entries(one, axes) for one in entries.tables("fields")))
    if named == RestrictedMap.kind:
        return RestrictedMap(field_from_entries(entries.table("field"), axes), _part(entries, axes))
    kind = METHODS[entries.text("kind", tuple(METHODS))]
    build: Callable[..., Field] = kind
    if kind is RadialMap:
        parts = _ragged(entries, "parts")
        found = [
            None
            if one is None
            else gaussian_process_from_entries(
                Entries(one, (*entries.path, "parts", i), entries.file, entries.places), axes
            )
            for i, one in enumerate(parts)
            if one is None or isinstance(one, dict)
        ]
        inflation = entries.number("inflation") if "inflation" in entries.tree else 1.0
        return RadialMap(tuple(found), entries.array("low", (axes,)), entries.array("high", (axes,)), inflation)
    sizes: dict[str, int] = {"a": axes}
    read = {
        name: _levels(entries, axes) if shape == "ragged" else _array(entries, name, shape, sizes)
        for name, shape in SHAPES[kind.kind].items()
    }
    try:
        return build(**read)
    except (ValueError, RigError) as error:
        entries.fail(f"{entries.name('kind')}: a field of kind {kind.kind!r} cannot be: {error}", "kind")


def gaussian_process_from_entries(entries: Entries, axes: int) -> Radial:
    """Gaussian process from its entries in a file.

    Raises FileError where it is none.
    """
    inputs = entries.array("inputs", (None, axes))
    half, lengths = entries.array("half", (axes,)), entries.array("lengths", (2,))
    for name, values in (("half", half), ("lengths", lengths)):
        if (values <= 0).any():
            entries.fail(f"{entries.name(name)} must be positive, not {values.tolist()}", name)
    return Radial(
        entries.array("centre", (axes,)),
        half,
        entries.whole("axis", 0, most=axes - 1),
        inputs,
        entries.array("weights", (len(inputs),)),
        entries.array("sizes", (2,)),
        lengths,
        entries.number("noise"),
        entries.array("variances", (len(inputs),), None) if "variances" in entries.tree else None,
    )


def _array(table: Entries, name: str, shape: str, sizes: dict[str, int]) -> Floats:
    found = table.array(name, tuple(sizes.get(letter) for letter in shape))
    sizes.update(zip(shape, found.shape))
    return found


def _levels(table: Entries, axes: int) -> tuple[Floats, ...]:
    listed = _ragged(table, "levels")
    if len(listed) != axes:
        table.fail(f"{table.name('levels')} must list {axes} axes, got {len(listed)}", "levels")
    inner = Entries(dict(enumerate(listed)), (*table.path, "levels"), table.file, table.places)
    return tuple(inner.array(i, (None,)) for i in range(axes))


def _ragged(table: Entries, name: str) -> list[object]:
    value = table.get(name)
    if not isinstance(value, list):
        table.fail(f"{table.name(name)} must be a list", name)
    return value


PLACES = 500  # at which a single step is held against the fixed point


def measured_correction_summands(samples: Samples, model: Parallel) -> FieldSamples:
    """Correction summands (KSF_PM) measured at samples, with variances by the poses' covariance.

    Source: configuration-space patent, [0130]
    """
    kinematics = mechanisms.kinematics_of(model)
    A = strut_or_axis_jacobian_by_pose(samples.T_base_platform, model)
    variances = np.einsum("nij,njk,nik->ni", A, samples.covariance, A)
    return FieldSamples(
        samples.commanded,
        samples.commanded - kinematics.inverse(samples.T_base_platform, model),
        variances,
        kinematics.travel_ranges(model),
    )


def fitted_or_nominal_geometry(
    samples: Samples, nominal: Parallel, without_fit: bool, prior: Floats | None = None
) -> Identified:
    """Geometry fitted to samples, or the nominal one with nothing fitted (Identified).

    An extension starts from it.
    without_fit : the owner's own, with nothing sought. prior : (p,) m, or None: as poses have it.
    """
    if not without_fit:
        if prior is None:
            prior = estimate_tolerance_of_stated_geometry(identify_platform(samples, nominal), nominal).prior
        return identify_platform(samples, nominal, prior=prior)
    known = measured_correction_summands(samples, nominal)
    n, axes = known.values.shape
    A, p = strut_or_axis_jacobian_by_pose(samples.T_base_platform, nominal), len(geometric_parameters(nominal))
    covariance = A @ samples.covariance @ np.swapaxes(A, 1, 2)
    return Identified(
        nominal,
        np.zeros((p, p)),
        np.zeros(samples.common.shape[2]),
        np.zeros((p, p)),
        known.values,
        covariance,
        np.zeros(axes),
        np.ones(n, bool),
        np.full(p, PRIOR),
        0.0,
    )


def residual_correction_summands_at_samples(samples: Samples, identified: Identified) -> FieldSamples:
    """Residual correction summands that a fitted geometry leaves at its samples.

    Shared errors removed.
    """
    kinematics = mechanisms.kinematics_of(identified.mechanism)
    return FieldSamples(
        samples.commanded,
        identified.residuals,
        np.einsum("nii->ni", identified.residual_covariance),
        kinematics.travel_ranges(identified.mechanism),
    )


def residual_correction_summands_of_pass(samples: Samples, correction: AnyCorrection) -> FieldSamples:
    """Residual correction summands that an earlier pass leaves.

    Corrected strut lengths less measured ones.
    Source: configuration-space patent, [0035]
    """
    known = measured_correction_summands(
        replace(samples, T_base_platform=correction.target_poses(samples.T_base_platform)), correction.fitted
    )
    return FieldSamples(
        known.configurations, known.values - correction.rho(samples.commanded), known.variances, known.strokes
    )


def correction_with_additional_pass(correction: AnyCorrection, field: Field | None) -> AnyCorrection:
    """Correction with an additional pass (a Field).

    Unchanged where the field is None.
    """
    if field is None:
        return correction
    before = correction.extension
    fields = () if before is None else before.fields if isinstance(before, SummedPasses) else (before,)
    return replace(correction, extension=SummedPasses((*fields, field)))


def residual_pose_tangents_of_pass(samples: Samples, correction: AnyCorrection, space: PoseSpace) -> FieldSamples:
    """Residual pose tangents that an earlier pass leaves.

    From its corrected poses to the measured ones.
    Over the coordinates of a pose space; of an arm or a chain all six of them, since these are the hand's and not the
    base's. Source: configuration-space patent, [0035]
    """
    nominal, some = correction.nominal, list(space.coordinates)
    T = correction.predict(samples.commanded)
    x = timed_command_sequence_and_pose_space_correction_map.pose_coordinates(T, space.home)[:, some]
    both, given = x, list(range(len(NAMES)))
    if is_parallel(nominal):
        _, all_over = solvable_commands_and_poses(evenly_spread_configurations(nominal, PLACES, 1.0), correction)
        box = timed_command_sequence_and_pose_space_correction_map.pose_coordinates(all_over, space.home)[:, some]
        both, given = np.concatenate([x, box]), some
    return FieldSamples(
        x,
        timed_command_sequence_and_pose_space_correction_map.pose_error_tangents(T, samples.T_base_platform)[:, given],
        np.einsum("nii->ni", samples.covariance)[:, given],
        np.stack([both.min(axis=0), both.max(axis=0)], axis=1),
    )


def home_pose(mechanism: Parallel) -> RigidTransform:
    """Home pose of a mechanism, T_base_platform."""
    kinematics = mechanisms.kinematics_of(mechanism)
    return kinematics.forward(kinematics.home_values(mechanism), mechanism)


def pose_space_of_mechanism(mechanism: Parallel) -> PoseSpace:
    """Pose space of a mechanism.

    It is on struts; coordinates are those in which its poses differ, rotations counted from home.
    """
    return PoseSpace(home_pose(mechanism), mechanism.pose_coordinates)


def correction_with_pose_space_map(
    correction: AnyCorrection, field: Field | None, space: PoseSpace | None = None
) -> AnyCorrection:
    """Correction with a map in pose space (a Field) added, applied last.

    space : over which it is, by default that of the mechanism. Unchanged where the field is None.
    """
    if field is None:
        return correction
    one = PoseMap(*(space or pose_space_of_mechanism(correction.nominal)), field)
    return replace(correction, posed=(*correction.posed, one))


def fit_correction_summand_field(samples: FieldSamples, kind: str, smoothness_from: Field | None = None) -> Field:
    """Field of a kind fitted to correction summands.
    smoothness_from : a Field of the same kind of more samples, whose smoothness holds for these as well.

    Raises RigError as `fit_field`
    """
    return (
        RadialMap.fit(samples, smoothness_from)
        if isinstance(smoothness_from, RadialMap) and kind == RadialMap.kind
        else fit_field(kind, samples)
    )


def identified_geometry_correction_with_field(
    nominal: Parallel, identified: Identified, field: Field | None
) -> Correction[Parallel, Radial]:
    """Correction of an identified geometry with a Field.

    The field is for its remainder; None for none.
    """
    return Correction(nominal, identified.mechanism, (None,) * len(nominal.axes), extension=field)


def rms_and_greatest_strut_single_step_error(correction: AnyCorrection) -> tuple[float, float]:
    """Errors (RMS, greatest) m of struts corrected in a single step, not taken to the fixed point.

    The single step is X + KSF(X).

    Source: configuration-space patent, [0030], [0091]
    """
    _, wanted = solvable_commands_and_poses(evenly_spread_configurations(correction.nominal, PLACES), correction)
    off = correction.single_step(wanted) - correction.inverse(wanted)
    return float(np.sqrt((off**2).mean())), float(np.abs(off).max())


def pose_map_dict(pose_map: PoseMap) -> Json:
    """dict of a PoseMap, as JSON holds it."""
    return {
        "home": pose_file_entry(pose_map.home),
        "coordinates": [NAMES[i] for i in pose_map.coordinates],
        "field": field_to_dict(pose_map.field),
    }


def pose_map_from_entries(entries: Entries, nominal: Commanded) -> PoseMap:
    """PoseMap of a mechanism from its entries, as `pose_map_dict` gives them.

    Raises FileError for anything else.
    """
    stated = entries.texts("coordinates")
    some = nominal.pose_coordinates
    if not is_parallel(nominal) and stated:  # of these, those in which its samples differed
        some = tuple(i for i in some if NAMES[i] in stated)
    if stated != tuple(NAMES[i] for i in some):
        entries.fail(
            f"{entries.name('coordinates')} must be {', '.join(NAMES[i] for i in nominal.pose_coordinates)} for a "
            f"mechanism of kind {nominal.kind!r}",
            "coordinates",
        )
    return PoseMap(entries.pose("home"), some, field_from_entries(entries.table("field"), len(some)))
