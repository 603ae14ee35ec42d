"""Lookup table of corrected commands over sensor channels.

Commands of wanted poses at every combination of values, with the covariance of the poses, and how many poses a wanted
uncertainty takes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.api.correct import CorrectOptions, correct
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.numbers_and_units import quantity_text
from rig.model import mechanisms
from rig.recording.corner_and_pose_csv_tables import COVARIANCE_COLUMNS, POSE_COLUMNS
from rig.recording.recording_folder import Sensors
from rig.recording.wanted_poses_and_roll_pitch_yaw import WantedPoses

PARTS = ("position", "rotation")
UNITS = dict(zip(PARTS, ("m", "rad")))
LARGEST = 100_000  # rows
ROUNDING = 1e-6  # of a pose
Point = tuple[float, ...]  # a value of each channel


@dataclass(frozen=True, slots=True, eq=False)
class LookupTable:
    """channels : {name: (k,) values}, a row for each combination and wanted pose; columns : names of the table's
    columns; rows : (n, columns): channels, frame, wanted pose (m, rad), commands (m, rad), upper triangle of the
    covariance of the pose that comes of them (m, rad, on the right)
    interpolation_error : m or rad, greatest of the commands in the middle between rows, interpolated linearly
    uncertainty : (m, rad) standard uncertainty of the poses, RMS; unchanging : (m, rad), that part of it which stays
    when the fitted numbers are known exactly; unlogged : (m, rad), the same without scatter: of channels that nobody
    logged, and of what axes remember; poses : how many were fitted
    unit : of the commands
    """

    channels: dict[str, Floats]
    columns: tuple[str, ...]
    rows: Floats
    interpolation_error: float
    uncertainty: tuple[float, float]
    unchanging: tuple[float, float]
    unlogged: tuple[float, float]
    poses: int
    unit: str

    @property
    def csv(self) -> str:
        """The table as CSV."""
        frame = self.columns.index("frame")
        lines = [
            ",".join(str(int(value)) if k == frame else f"{value:.12g}" for k, value in enumerate(row))
            for row in self.rows.tolist()
        ]
        return "\n".join([",".join(self.columns), *lines, ""])

    def __str__(self) -> str:
        counts = " x ".join(str(len(values)) for values in self.channels.values())
        return (
            f"{len(self.rows)} rows ({counts} of {', '.join(self.channels)}); linear interpolation errs by "
            f"up to {quantity_text(self.interpolation_error, self.unit)} of a command, beside a standard uncertainty "
            f"of the poses of {quantity_text(self.uncertainty[0], 'm')} and {quantity_text(self.uncertainty[1], 'rad')}"
        )

    def poses_for(self, kind: str, wanted: float) -> str:
        """Sentence on how many poses a standard uncertainty takes, RMS over the table, spread as those fitted.

        kind : "position" or "rotation"; wanted : m or rad. What the fitted numbers leave uncertain falls with the
        number of poses, in its square. Scatter may be what so few poses leave open, and fall too, or be the
        machine's own, and stay
        """
        k, unit = PARTS.index(kind), UNITS[kind]
        text = f"{quantity_text(wanted, unit)} of {kind}"
        least, most = (self._poses(k, wanted, rest[k]) for rest in (self.unlogged, self.unchanging))
        if least is None:
            rest = quantity_text(self.unlogged[k], unit)
            return f"no number of poses gives {text}: {rest} come of what was not logged or of what axes remember"
        spread = f"spread as the {self.poses} that were fitted"
        if most is None:
            rest = quantity_text(self.unchanging[k], unit)
            return f"{text} takes at least {least} poses, {spread}, and none suffice where the scatter of {rest} stays"
        return f"{text} takes {least if least == most else f'{least} to {most}'} poses, {spread}"

    def _poses(self, k: int, wanted: float, rest: float) -> int | None:
        """Poses for a wanted uncertainty of a part of poses, where `rest` stays; None where no number suffices."""
        if wanted <= rest:
            return None
        return math.ceil(self.poses * (self.uncertainty[k] ** 2 - rest**2) / (wanted**2 - rest**2) - ROUNDING)


def corrected_command_lookup_table(
    calibration: Calibration, wanted: WantedPoses, channels: Mapping[str, Sequence[float]]
) -> LookupTable:
    """LookupTable of a calibration for wanted poses.

    At every combination of values of sensor channels.
    channels : {name: (k,) values in the channel's unit, ascending}; others stand as when calibrated, and their spread
        is in the covariance
    Every pose is held until all has come to rest. Where axes remember their way, a pose is not approached from one
    side: what that leaves is in the covariance.
    Raises RigError for a channel on which nothing depends, Unreachable for poses that no command reaches
    """
    if wanted.t is not None or wanted.directions:
        raise RigError(
            "a lookup table takes whole poses without times: leave out the column t"
            if wanted.t is not None
            else "a lookup table takes whole poses, not directions"
        )
    values = {name: np.asarray(own, float) for name, own in channels.items()}
    _require_known(calibration, values)
    count = len(wanted.poses.frame) * int(np.prod([len(own) for own in values.values()]))
    if count > LARGEST:
        raise RigError(f"the table would have {count} rows; at most {LARGEST}")
    T = wanted.poses.T_base_platform

    def commands(point: Point, known: Calibration = calibration) -> tuple[Floats, Floats]:
        log = Sensors(np.zeros(1), {name: np.array([value]) for name, value in zip(values, point)})
        done = correct(known, T, CorrectOptions(sensors=log, approach="never"))
        assert done.covariance is not None
        return done.values, done.covariance

    found = {point: commands(point) for point in product(*(own.tolist() for own in values.values()))}
    upper = np.triu_indices(6)
    poses = np.column_stack([T.translation, T.rotation.as_rotvec()])
    rows = np.concatenate(
        [
            np.column_stack(
                [np.tile(point, (len(T), 1)), wanted.poses.frame, poses, q, covariance[:, upper[0], upper[1]]]
            )
            for point, (q, covariance) in found.items()
        ]
    )
    sure = _with_known_numbers(calibration)
    quiet = replace(sure, scatter=np.zeros_like(sure.scatter), strut_covariance=None)
    nominal = calibration.correction.nominal
    return LookupTable(
        values,
        (*values, "frame", *POSE_COLUMNS, *nominal.axes, *COVARIANCE_COLUMNS),
        rows,
        _interpolation_error(values, {point: q for point, (q, _) in found.items()}, lambda point: commands(point)[0]),
        _root_mean_square([covariance for _, covariance in found.values()]),
        _root_mean_square([commands(point, sure)[1] for point in found]),
        _root_mean_square([commands(point, quiet)[1] for point in found]),
        len(calibration.frames),
        mechanisms.travel_unit(nominal),
    )


def _root_mean_square(covariances: list[Floats]) -> tuple[float, float]:
    """(m, rad), RMS over poses of their covariances (n, 6, 6)."""
    square = np.mean([np.einsum("nii->ni", covariance) for covariance in covariances], axis=(0, 1))
    return float(np.sqrt(square[:3].sum())), float(np.sqrt(square[3:].sum()))


def _with_known_numbers(calibration: Calibration) -> Calibration:
    """The calibration as if all numbers that were fitted were known exactly."""
    physics = calibration.physics
    if physics is not None:
        physics = replace(physics, own=np.zeros_like(physics.own), cross=np.zeros_like(physics.cross))
    return replace(calibration, covariance=np.zeros_like(calibration.covariance), physics=physics)


def _require_known(calibration: Calibration, channels: Mapping[str, Floats]) -> None:
    """Raise RigError for channels on which nothing in the calibration depends, or whose values do not ascend."""
    physics = calibration.physics
    known = [] if physics is None else [*physics.channels, *(tilt.channel for tilt in physics.tilts)]
    if not channels:
        raise RigError("a lookup table takes at least one sensor channel and its values")
    for name, values in channels.items():
        if name not in known:
            raise RigError(
                f"the calibration was not learnt with a channel {name!r}; it has "
                f"{', '.join(dict.fromkeys(known)) or 'none: calibrate with --diagnosis or --find'}"
            )
        if values.ndim != 1 or not len(values) or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
            raise RigError(f"the values of {name} must ascend, got {values.tolist()}")


def _interpolation_error(
    channels: Mapping[str, Floats], rows: Mapping[Point, Floats], commands: Callable[[Point], Floats]
) -> float:
    """m or rad, greatest difference in the middle of cells between commands and the mean of those at the corners."""
    sides = [
        list(zip(own[:-1], own[1:])) if len(own) > 1 else [(own[0],)]
        for own in (values.tolist() for values in channels.values())
    ]
    worst = 0.0
    for cell in product(*sides):
        middle = tuple(float(np.mean(side)) for side in cell)
        if middle in rows:
            continue  # a table of one value
        mean = np.mean([rows[corner] for corner in product(*cell)], axis=0)
        worst = max(worst, float(np.abs(commands(middle) - mean).max()))
    return worst
