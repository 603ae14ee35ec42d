"""Extension of correction summands from the visited configurations over the configuration space.

KSF_PM(x) = x - IK(GDK(x)) at each sample x; KSF_KR is its Field over all of the configuration space. It stands alone,
with the owner's model as IK, or on top of the fitted geometry, where it extends what that leaves.
Source: configuration-space patent, [0026] to [0030], [0126] to [0137]
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction import pose_space_map
from calib.correction.correction import AnyCorrection, Correction, commands_with_pose
from calib.correction.interpolation import interpolation_methods
from calib.correction.interpolation.field import Field, Known
from calib.correction.interpolation.field_combinations import SummedPasses
from calib.correction.interpolation.gaussian_process import Radial, RadialMap
from calib.models.platform.identification import (
    PRIOR,
    Identified,
    geometric_parameters,
    identify_platform,
    strut_length_jacobian,
)
from calib.models.platform.parameter_accuracy import stated_geometry_accuracy
from calib.samples.pose_samples import Samples
from rig.arrays import Floats
from rig.model import mechanisms
from rig.model.mechanism_kinds import Struts
from rig.planning.configuration_sets import FILL, sobol_configurations

PLACES = 500  # at which a single step is held against the fixed point


def measured_summands(samples: Samples, model: Struts) -> Known:
    """Summands (KSF_PM) measured at samples, with variances by the poses' covariance. model : whose IK is used

    Source: configuration-space patent, [0130]
    """
    kinematics = mechanisms.kinematics_of(model)
    A = strut_length_jacobian(samples.T_base_platform, model)
    variances = np.einsum("nij,njk,nik->ni", A, samples.covariance, A)
    return Known(
        samples.commanded,
        samples.commanded - kinematics.inverse(samples.T_base_platform, model),
        variances,
        kinematics.travel(model),
    )


def base_geometry(samples: Samples, nominal: Struts, alone: bool, prior: Floats | None = None) -> Identified:
    """Base geometry (Identified) of an extension; alone : the nominal geometry with nothing fitted.
    alone : the owner's own, with nothing sought. prior : (p,) m, or None: as poses have it.
    """
    if not alone:
        if prior is None:
            prior = stated_geometry_accuracy(identify_platform(samples, nominal), nominal).prior
        return identify_platform(samples, nominal, prior=prior)
    known = measured_summands(samples, nominal)
    n, axes = known.values.shape
    A, p = strut_length_jacobian(samples.T_base_platform, nominal), len(geometric_parameters(nominal))
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


def geometry_residual_summands(samples: Samples, identified: Identified) -> Known:
    """Residual summands of a geometry, shared errors removed."""
    kinematics = mechanisms.kinematics_of(identified.mechanism)
    return Known(
        samples.commanded,
        identified.residuals,
        np.einsum("nii->ni", identified.residual_covariance),
        kinematics.travel(identified.mechanism),
    )


def pass_residual_summands(samples: Samples, correction: AnyCorrection) -> Known:
    """Residual summands of an earlier pass: corrected strut lengths less those of the measured pose.

    Source: configuration-space patent, [0035]
    """
    known = measured_summands(
        replace(samples, T_base_platform=correction.target_poses(samples.T_base_platform)), correction.fitted
    )
    return Known(known.configurations, known.values - correction.rho(samples.commanded), known.variances, known.strokes)


def correction_with_pass(correction: AnyCorrection, field: Field | None) -> AnyCorrection:
    """Correction with one more pass; unchanged where the pass is None."""
    if field is None:
        return correction
    before = correction.extension
    fields = () if before is None else before.fields if isinstance(before, SummedPasses) else (before,)
    return replace(correction, extension=SummedPasses((*fields, field)))


def pass_residual_poses(samples: Samples, correction: AnyCorrection) -> Known:
    """Residual poses of an earlier pass: tangents from its corrected poses to the measured ones.

    Over the coordinates in which the mechanism's poses differ, see `posed.PoseMap`. Source: configuration-space patent,
    [0035]
    """
    nominal, some = correction.nominal, list(pose_coordinate_indices(correction.nominal))
    home = home_pose(nominal)
    T = correction.predict(samples.commanded)
    _, all_over = commands_with_pose(
        sobol_configurations(mechanisms.kinematics_of(nominal).travel(nominal), PLACES, 1.0), correction
    )
    x, box = (pose_space_map.pose_coordinates(poses, home)[:, some] for poses in (T, all_over))
    both = np.concatenate([x, box])
    variances = np.einsum("nii->ni", samples.covariance)[:, some]
    return Known(
        x,
        pose_space_map.pose_error_tangents(T, samples.T_base_platform)[:, some],
        variances,
        np.stack([both.min(axis=0), both.max(axis=0)], axis=1),
    )


def pose_coordinate_indices(mechanism: Struts) -> tuple[int, ...]:
    """Indices of the pose coordinates in which poses of a mechanism differ."""
    return mechanism.pose_coordinates


def home_pose(mechanism: Struts) -> RigidTransform:
    """Home pose of a mechanism, T_base_platform."""
    kinematics = mechanisms.kinematics_of(mechanism)
    return kinematics.forward(kinematics.home(mechanism), mechanism)


def correction_with_map(correction: AnyCorrection, field: Field | None) -> AnyCorrection:
    """Correction with one more map in pose space, applied last; unchanged where the map is None."""
    if field is None:
        return correction
    one = pose_space_map.PoseMap(home_pose(correction.nominal), pose_coordinate_indices(correction.nominal), field)
    return replace(correction, posed=(*correction.posed, one))


def fit_summand_field(samples: Known, kind: str, smoothness_from: Field | None = None) -> Field:
    """Field fitted to summands (KSF_KR). smoothness_from : a Field of the same kind of more samples
    smoothness_from : a Field of the same kind of more samples, whose smoothness holds for these as well.

    Raises RigError as `kinds.fit`
    """
    return (
        RadialMap.fit(samples, smoothness_from)
        if isinstance(smoothness_from, RadialMap) and kind == RadialMap.kind
        else interpolation_methods.fit_field(kind, samples)
    )


def correction_with_field(nominal: Struts, identified: Identified, field: Field | None) -> Correction[Struts, Radial]:
    """Correction of a geometry with a Field for its remainder, or None."""
    return Correction(nominal, identified.mechanism, (None,) * len(nominal.axes), extension=field)


def single_step_errors(correction: AnyCorrection) -> tuple[float, float]:
    """Errors (RMS, greatest) m of the single step X + KSF(X) against the fixed point's commands.

    Source: configuration-space patent, [0030], [0091]
    """
    _, wanted = commands_with_pose(
        sobol_configurations(mechanisms.kinematics_of(correction.nominal).travel(correction.nominal), PLACES, FILL),
        correction,
    )
    off = correction.single_step(wanted) - correction.inverse(wanted)
    return float(np.sqrt((off**2).mean())), float(np.abs(off).max())
