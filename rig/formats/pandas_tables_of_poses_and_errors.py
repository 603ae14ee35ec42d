"""Pandas tables of poses and errors.

pandas is imported only here; names of columns end with their units.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import MissingLibrary
from rig.model.pose import pose_to_vector

DataFrame: TypeAlias = Any  # of pandas, which need not be installed
Column: TypeAlias = Sequence[object] | Floats | Integers | Booleans
POSE_COLUMNS_WITH_UNITS = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")


def pandas_table(names: Sequence[str], rows: Iterable[Sequence[object]]) -> DataFrame:
    """DataFrame of rows with names of columns. Raises MissingLibrary without pandas."""
    return pandas_table_of_columns(dict(zip(names, zip(*rows))) or {name: () for name in names})


def pandas_table_of_columns(columns: Mapping[str, Column]) -> DataFrame:
    """DataFrame of columns {name: (n,) values}. Raises MissingLibrary without pandas."""
    try:
        import pandas
    except ImportError:
        raise MissingLibrary("to_pandas() needs the package pandas: pip install 'rig[pandas]'") from None
    return pandas.DataFrame(dict(columns))


def pandas_table_of_poses(frame: Integers, T: RigidTransform, covariance: Floats | None) -> DataFrame:
    """DataFrame of poses.

    A row for each: frame, position (m), rotation vector (rad), and their standard deviations.
    frame : (n,); T : RigidTransform (n,); covariance : (n, 6, 6) m, rad, on the right, or None. Standard deviations,
    `sigma_x_m` .. `sigma_rz_rad`, are along and about the axes of the moved body, as the covariance is.
    Raises MissingLibrary without pandas
    """
    columns: dict[str, Column] = {"frame": frame, **_six("", pose_to_vector(T))}
    if covariance is not None:
        columns |= _six("sigma_", np.sqrt(np.einsum("nii->ni", covariance)))
    return pandas_table_of_columns(columns)


def pandas_table_of_errors(frame: Integers, errors: Mapping[str, Floats]) -> DataFrame:
    """DataFrame of pose errors, a row for each pose.

    frame : (n,); errors : {name: (n, 6) m, rad}, whose columns are `NAME_x_m` .. `NAME_rz_rad`
    Raises MissingLibrary without pandas
    """
    columns: dict[str, Column] = {"frame": frame}
    for name, values in errors.items():
        columns |= _six(f"{name}_", values)
    return pandas_table_of_columns(columns)


def _six(prefix: str, values: Floats) -> dict[str, Column]:
    """Six columns, one for each coordinate of poses (n, 6)."""
    return {f"{prefix}{name}": column for name, column in zip(POSE_COLUMNS_WITH_UNITS, values.T)}
