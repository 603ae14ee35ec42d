"""Correction tables by sample, axis or grid.

Source: configuration-space patent, [0052], [0061] (data that comprise the correction values), [0130]
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from calib.correction.machine_correction import AnyCorrection
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats, Integers
from rig.errors import NotConverged, RigError
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Parallel, strut_or_axis_jacobian_by_pose
from rig.planning.configuration_generators import FILL, sobol_configurations

# times the typical standard deviation; a direction of the axes that a pose determines worse than that, as of a wrist
# near its singularity, has no summand
LOOSE = 10.0
STEPS, SETTLED = 20, 5e-12  # of axis values that meet a pose, in shares of how far the model may be off
AVERAGED = 256  # configurations over which a table for one joint alone is the mean


def correction_summand_column_names(axes: int) -> tuple[str, ...]:
    """Column names of the table of correction summands (ksf.csv).

    They are frame, x, y, k = x - y, covariance.
    """
    triangle = tuple(f"c{i}{j}" for i in range(axes) for j in range(i, axes))
    return ("frame", *(f"{name}{i + 1}" for name in "xyk" for i in range(axes)), *triangle)


class CorrectionSummands(NamedTuple):
    """KSF_PM of n samples: values (n, axes) m or rad; covariance : (n, axes, axes), by that of the measured poses."""

    values: Floats
    covariance: Floats


def strut_correction_summands(samples: Samples, nominal: Parallel) -> CorrectionSummands:
    """Correction summands of struts at samples.

    Commands less IK of the measured poses by the nominal model.
    """
    A = strut_or_axis_jacobian_by_pose(samples.T_base_platform, nominal)
    return CorrectionSummands(
        samples.commanded - mechanisms.kinematics_of(nominal).inverse(samples.T_base_platform, nominal),
        A @ samples.total_covariance() @ np.swapaxes(A, 1, 2),
    )


def correction_summands_by_nearest_axis_values(
    frame: Integers,
    values: Floats,
    model: Callable[[Floats], tuple[Floats, Floats]],
    covariance: Floats,
    expected_model_error: Floats,
) -> CorrectionSummands:
    """Correction summands of axes by the nearest axis values.

    They are at samples, commands less those nearest values at which a model meets the measurements.
    An axis has one only as far as its pose determines it (see LOOSE) and the model is near. What too few axes,
    positions alone, or more axes than freedoms leave open takes the least values. Variances of what is not determined
    are those of the worst that is.
    frame : (n,) numbers; values : (n, axes) m or rad, commanded; model : values -> (measured less predicted (n, k),
        change of what is predicted (n, k, axes)); covariance : (n, k, k) of what was measured;
        expected_model_error : (axes,) m or rad by which the model may be off, and different axes' values are compared
    Raises RigError naming a frame whose pose the model does not come to
    Source: configuration-space patent, [0026]; damped where undetermined as by truncated singular values, Hansen,
        Rank-deficient and discrete ill-posed problems, 1998, ch. 3
    """
    W = np.linalg.inv(np.linalg.cholesky(covariance))
    left, J = model(values)
    U, s, Vt = np.linalg.svd(W @ J * expected_model_error)
    worst = 1 / np.maximum(s[:, min(U.shape[1], Vt.shape[1]) - 1], 1e-300)
    limit = min(LOOSE * float(np.median(worst)), 1.0)
    x, V = values / expected_model_error, np.swapaxes(Vt, 1, 2)
    across, along = np.swapaxes(U[..., : s.shape[1]], 1, 2), V[..., : s.shape[1]]
    far = np.abs(across @ (W @ left[..., None]))[..., 0]
    determined = (s * limit >= 1) & (far <= s)
    across, along = across * determined[..., None], along * determined[:, None]
    undetermined = np.eye(s.shape[1]) * ~determined[:, None]
    for _ in range(STEPS):  # Newton along the directions that are determined
        left, J = model(x * expected_model_error)
        rest = across @ W @ np.concatenate([J * expected_model_error @ along, left[..., None]], axis=2)
        step = (along @ np.linalg.solve(rest[..., :-1] + undetermined, rest[..., -1:]))[..., 0]
        x += step
        if np.abs(step).max() < SETTLED:
            break
    else:
        worst_of = int(np.abs(step).max(axis=1).argmax())
        raise RigError(
            f"frame {frame[worst_of]}: the model does not reach the measured pose near its axis "
            "values; is it that machine's?"
        )
    variances = np.full((len(x), Vt.shape[1]), limit**2)
    variances[:, : s.shape[1]] = np.where(determined, 1 / np.maximum(s, 1 / limit) ** 2, limit**2)
    own = (V * variances[:, None]) @ np.swapaxes(V, 1, 2)
    return CorrectionSummands(
        values - x * expected_model_error, own * np.outer(expected_model_error, expected_model_error)
    )


def correction_summand_csv_rows(samples: Samples, summands: CorrectionSummands) -> Iterator[str]:
    """Rows of the table of correction summands (ksf.csv), one for each sample."""
    upper = np.triu_indices(summands.values.shape[1])
    for frame, x, k, C in zip(samples.frame, samples.commanded, *summands):
        yield ",".join(
            [str(frame), *(f"{value:.12f}" for value in (*x, *(x - k), *k)), *(f"{value:.9e}" for value in C[upper])]
        )


class JointTables(NamedTuple):
    """levels, trims : (axes, count) m or rad: what is to be added to each axis' command at its own levels;
    left : (axes,) RMS of what a table for each axis alone cannot hold of the whole correction."""

    levels: Floats
    trims: Floats
    left: Floats


def axis_correction_tables(correction: AnyCorrection, count: int) -> JointTables:
    """Correction table of each axis alone.

    The mean of the remainder over the other axes.

    c = x + trim, c the fixed point c = x + rho(c) at the axis' own level x, the other axes all over their strokes
    """
    strokes = mechanisms.kinematics_of(correction.nominal).travel_ranges(correction.nominal)
    others = sobol_configurations(strokes, AVERAGED, FILL)
    levels = np.linspace(strokes[:, 0], strokes[:, 1], count, axis=1)
    trims, left = np.empty(levels.shape), np.empty(len(levels))
    for i, own in enumerate(levels):
        wanted = np.repeat(others[None], count, axis=0)
        wanted[..., i] = own[:, None]
        found = correction.settled(wanted)[..., i] - own[:, None]
        trims[i] = found.mean(axis=1)
        left[i] = np.sqrt(((found - trims[i][:, None]) ** 2).mean())
    return JointTables(levels, trims, left)


def grid_commands_and_corrections(
    correction: AnyCorrection, divisions: int, fill: float = FILL
) -> tuple[Floats, Floats]:
    """Commands x on an even grid, and their corrections k.

    x + k is to be commanded for x.

    Returns (x, k), both (vertices, axes) m or rad
    Raises RigError where a vertex has no pose
    """
    strokes = mechanisms.kinematics_of(correction.nominal).travel_ranges(correction.nominal)
    levels = strokes.mean(axis=1)[:, None] + fill * np.ptp(strokes, axis=1)[:, None] / 2 * np.linspace(
        -1, 1, divisions + 1
    )
    x = np.stack(np.meshgrid(*levels, indexing="ij"), axis=-1).reshape(-1, len(strokes))
    try:
        wanted = mechanisms.kinematics_of(correction.nominal).forward(x, correction.nominal)
        return x, correction.inverse(wanted) - x
    except NotConverged as error:
        raise RigError(
            f"{len(error.index)} of the grid's {len(x)} vertices close on no pose; use a smaller share of the strokes"
        ) from None
