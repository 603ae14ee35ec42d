"""Checked loading of a user's kinematics file.

Of its functions: shapes, numbers, round trip, derivatives; and the cached loading of one.
"""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import FileError
from rig.model.user_kinematics_file import FREEDOMS, KinematicsFile, run_kinematics_source_without_function_checks
from rig.model.user_kinematics_file_derivatives import axis_change_columns_by_freedom, axis_change_columns_by_parameter

TRIED = 6  # poses at which a file is checked
AROUND = (4e-3, 0.02)  # m, rad; about home, where these lie
MIDDLE = 0.3  # of every travel about home, where forward is tried
ROUND_TRIP = 1e-9  # m or rad
RIGID = 1e-9  # of a rotation matrix
ALIKE = 1e-5  # of the largest derivative; complex step and differences agree to that
SINGULAR = 1e-6  # of the largest singular value of the axes' change with the freedoms at home


@lru_cache(16)
def load_checked_kinematics_source(source: str, name: str) -> KinematicsFile:
    """Load a source text as a checked KinematicsFile.

    name : of its file, in errors.
    Raises FileError with the line of what is wrong: what is missing, of another shape, no number, in another unit, or
    no round trip
    """
    file = run_kinematics_source_without_function_checks(source, name)
    poses = _poses_about_home(file)
    _require_home(file)
    file = replace(file, batched=_is_batched(file, "inverse", poses))
    values = file.inverse(poses, file.nominal)
    _require_numbers(file, "inverse", values, poses[:, :3, 3].round(6).tolist(), "poses at")
    file = _with_derivatives(file, poses)
    columns = axis_change_columns_by_freedom(file, file.home[None], file.nominal)[0]
    sizes = np.linalg.svd(columns / np.linalg.norm(columns, axis=0).clip(1e-300), compute_uv=False)
    if not sizes[-1] > SINGULAR * sizes[0]:
        raise file.error("inverse is singular at home: the axes do not hold all freedoms there", "inverse")
    return _with_forward(file) if file.has_forward else file


def _poses_about_home(file: KinematicsFile) -> Floats:
    """(TRIED, 4, 4) poses about home, home first."""
    rng, out = np.random.default_rng(1), np.tile(file.home, (TRIED, 1, 1))
    for k in range(1, TRIED):
        for freedom in file.freedoms:
            move = rng.uniform(-1, 1)
            if freedom < 3:
                out[k, freedom, 3] += AROUND[0] * move
            else:
                angle, (i, j) = AROUND[1] * move, [(freedom - 2) % 3, (freedom - 1) % 3]
                turn = np.eye(3)
                turn[i, i] = turn[j, j] = np.cos(angle)
                turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
                out[k, :3, :3] = turn @ out[k, :3, :3]
    return out


def _require_home(file: KinematicsFile) -> None:
    """Raise FileError where home is out of the axes' travel, or has no values."""
    values = file.inverse(file.home[None], file.nominal)[0]
    if np.iscomplexobj(values):
        raise file.error("inverse returns complex numbers for real poses", "inverse")
    for axis, value in zip(file.axes, values.tolist()):
        if not np.isfinite(value):
            raise file.error(f"inverse returns {value} for axis {axis.name} at home", "inverse")
        if not axis.low <= value <= axis.high:
            raise file.error(
                f"home needs axis {axis.name} at {value:.6g} {axis.unit}, outside its travel {axis.low:g} .. "
                f"{axis.high:g} {axis.unit}",
                "home",
            )


def _is_batched(file: KinematicsFile, name: str, given: Floats) -> bool:
    """Whether a function of the file takes many at once as it takes one. Raises FileError where it does not take one
    alone.
    """
    alone, together = (
        partial(one.inverse if name == "inverse" else one.forward, given, file.nominal)
        for one in (replace(file, batched=batched, forward_batched=batched) for batched in (False, True))
    )
    expected = alone()
    try:
        answer = together()
    except FileError:  # of a function that is written for one pose, which is as good
        return False
    return bool(np.allclose(answer, expected, rtol=1e-12, atol=1e-12, equal_nan=True))


def _require_numbers(file: KinematicsFile, name: str, found: Floats, given: list[object], what: str) -> None:
    """Raise FileError where something found (n, ..) is no finite number."""
    bad = np.flatnonzero(~np.isfinite(found.reshape(len(found), -1)).all(axis=1))
    if len(bad):
        k = int(bad[0])
        raise file.error(f"{name} returns {found[k].tolist()} for {what} {given[k]}"[:300], name)


def _derivatives(file: KinematicsFile, poses: Floats) -> Floats:
    free = np.flatnonzero(file.tolerances)
    return np.concatenate(
        [
            axis_change_columns_by_freedom(file, poses, file.nominal),
            axis_change_columns_by_parameter(file, poses, file.nominal, free),
        ],
        axis=2,
    )


def _with_derivatives(file: KinematicsFile, poses: Floats) -> KinematicsFile:
    """The file with complex steps where they agree with differences; else differences, which agree with those of half
    the step. Raises FileError where they do not.
    """
    plain = _derivatives(file, poses)
    size = np.abs(plain).max(axis=(0, 1))
    if not size[len(file.freedoms) :].all():
        free = np.flatnonzero(file.tolerances)
        k = int(np.flatnonzero(size[len(file.freedoms) :] == 0)[0])
        raise file.error(
            f"parameter {file.names[free[k]]!r} changes no axis at any pose about home: give it the tolerance 0",
            "parameters",
        )
    size = np.maximum(size, np.finfo(float).tiny)  # a freedom that moves no axis is singular, which is checked next
    by_complex = replace(file, complex_step=True)
    try:
        exact: Floats | None = _derivatives(by_complex, poses)
    except FileError:  # of functions that take real numbers only, such as arctan2
        exact = None
    if exact is not None and (np.abs(exact - plain).max(axis=(0, 1)) < ALIKE * size).all():
        return by_complex
    half = _derivatives(replace(file, shorter=0.5), poses)
    off = np.abs(half - plain).max(axis=(0, 1)) / size
    if not (off < ALIKE).all():
        every = [f"freedom {FREEDOMS[k]}" for k in file.freedoms]
        every += [f"parameter {file.names[k]!r}" for k in np.flatnonzero(file.tolerances)]
        raise file.error(
            f"inverse is not smooth: its change with {every[int(np.nanargmax(off))]} by differences of two steps "
            f"differs by {np.nanmax(off):.2g} of itself",
            "inverse",
        )
    return file


def _with_forward(file: KinematicsFile) -> KinematicsFile:
    """The file whose forward undoes its inverse. Raises FileError where it does not."""
    rng = np.random.default_rng(2)
    home = file.inverse(file.home[None], file.nominal)[0]
    span = np.array([[axis.low, axis.high] for axis in file.axes])
    moves = rng.uniform(-1, 1, (TRIED, len(file.axes)))
    moves[0] = 0
    values = home + MIDDLE * np.where(moves < 0, home - span[:, 0], span[:, 1] - home) * moves
    file = replace(file, forward_batched=_is_batched(file, "forward", values))
    for p in (file.nominal, file.nominal + file.tolerances * rng.uniform(-1, 1, len(file.tolerances))):
        poses = file.forward(values, p)
        whole = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
        if not whole[0] or whole.mean() < 0.5:
            k = int(np.flatnonzero(~whole)[0])
            raise file.error(f"forward returns no finite pose for axis values {values[k].round(6).tolist()}", "forward")
        R = poses[whole, :3, :3]
        if (
            np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max() > RIGID
            or np.abs(poses[whole, 3] - [0, 0, 0, 1]).max() > RIGID
            or (np.linalg.det(R) < 0).any()
        ):
            raise file.error("forward returns matrices that are no poses (rotation, position, 0 0 0 1)", "forward")
        off = np.abs(file.inverse(poses_with_locked_coordinates_at_home(file, poses[whole]), p) - values[whole]).max(
            axis=1
        )
        if not off.max() < ROUND_TRIP:
            k = int(np.argmax(np.nan_to_num(off, nan=np.inf)))
            raise file.error(
                f"inverse(forward(values)) is {off[k]:.3g} off values {values[whole][k].round(6).tolist()} (m or rad): "
                "they are no round trip",
                "forward",
            )
    left = poses_with_locked_coordinates_at_home(file, file.forward(home[None], file.nominal))[0] - file.home
    if not np.abs(left).max() < ROUND_TRIP:
        raise file.error(
            f"forward(inverse(home)) is {np.abs(left).max():.3g} off home (m or rad): it gives another assembly",
            "forward",
        )
    return file


def poses_with_locked_coordinates_at_home(file: KinematicsFile, poses: Floats) -> Floats:
    """Poses (n, 4, 4) with the locked coordinates as at home.

    Those that are no freedoms.

    The nearest that the platform can take.
    """
    if len(file.freedoms) == 6:
        return poses
    out = np.tile(file.home, (len(poses), 1, 1))
    at = [freedom for freedom in file.freedoms if freedom < 3]
    out[:, at, 3] = poses[:, at, 3]
    if 5 in file.freedoms:
        angle = np.arctan2(poses[:, 1, 0] - poses[:, 0, 1], poses[:, 0, 0] + poses[:, 1, 1])
        out[:, 0, 0] = out[:, 1, 1] = np.cos(angle)
        out[:, 1, 0] = np.sin(angle)
        out[:, 0, 1] = -out[:, 1, 0]
    return out
