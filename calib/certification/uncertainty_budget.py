"""Uncertainty budget of a pose.

Contributions of measuring and of the machine, and the expanded uncertainty.

Each is expanded so that 95 % of the error's lengths lie within it: by a factor of the RMS length that depends on the
directions of the error, 1.61 where all three are alike and 1.96 where there is one. What is not known is given as not
known, with the reason, never as nothing.
docs/mathematics.md (30)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.held_out_pose_errors_and_distinct_configurations import HeldPoses, Repeatability
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.formats.pandas_tables_of_poses_and_errors import DataFrame, pandas_table
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Recording, Sensors
from vision.recording_adjustment_with_hand_and_stages import Measurement

COVERAGE = 0.95  # of lengths within an expanded uncertainty
DRAWS = 100_000  # of errors, for the factor of that
PARTS = (slice(0, 3), slice(3, 6))
BUDGET_COLUMNS = ("contribution", "of", "position_m", "rotation_rad", "kind", "source")
PLACE = (
    "x",
    "y",
    "z",
    "rx",
    "ry",
    "rz",
)  # of a camera; its other unknowns are its lens, but for how markers are printed


@dataclass(frozen=True, slots=True)
class Expanded:
    """position, rotation : m, rad, within which COVERAGE of the lengths lie; k : (of position, of rotation), by which
    each exceeds the RMS length rotation None where none was measured."""

    position: float
    rotation: float | None
    k: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Contribution:
    """name; of : "measuring" or "machine"; position, rotation : U of a pose's length (m, rad), None where not known;
    k : coverage factors of both
    kind : "A" from scatter, "B" otherwise; source : how it was determined, or why it is not known."""

    name: str
    of: str
    position: float | None
    rotation: float | None
    k: tuple[float, float] | None
    kind: str
    source: str


@dataclass(frozen=True, slots=True)
class Budget:
    """rows : Contributions; machine : of a pose as commanded, the sum of its known contributions' covariances;
    measuring : of one measured.
    """

    rows: tuple[Contribution, ...]
    machine: Expanded
    measuring: Expanded

    def to_pandas(self) -> DataFrame:
        """DataFrame of the contributions, a row for each: BUDGET_COLUMNS. Raises MissingLibrary without pandas."""
        return pandas_table(
            BUDGET_COLUMNS, [(r.name, r.of, r.position, r.rotation, r.kind, r.source) for r in self.rows]
        )


def expanded_uncertainty_over_poses(covariance: Floats) -> Expanded:
    """Expanded uncertainty of errors with covariances (n, 6, 6), every pose as likely."""
    u = rms_position_and_rotation_uncertainty(covariance)
    k = _coverage_factor(covariance[:, PARTS[0], PARTS[0]]), _coverage_factor(covariance[:, PARTS[1], PARTS[1]])
    return Expanded(k[0] * u[0], k[1] * u[1], k)


def _coverage_factor(covariance: Floats) -> float:
    """COVERAGE quantile over RMS of the lengths of errors normal with covariances (n, 3, 3), every pose as likely; by
    draws with a fixed seed.
    """
    if not covariance.any():
        return float(np.sqrt(chdtri(3, 1 - COVERAGE) / 3))
    values, vectors = np.linalg.eigh(covariance)
    each = -(-DRAWS // len(covariance))
    z = np.random.default_rng(0).normal(size=(len(covariance), each, 3)) * np.sqrt(np.maximum(values, 0.0))[:, None]
    found: float = np.quantile(np.linalg.norm(z, axis=2), COVERAGE) / np.sqrt(
        np.trace(covariance, axis1=1, axis2=2).mean()
    )
    return float(found)


def rms_position_and_rotation_uncertainty(covariance: Floats) -> tuple[float, float]:
    """RMS standard uncertainty (m, rad) of the lengths of position and rotation errors, of covariances (n, 6, 6)."""
    position, rotation = (float(np.sqrt(np.trace(covariance[:, p, p], axis1=1, axis2=2).mean())) for p in PARTS)
    return position, rotation


def pose_covariances_by_cameras_and_by_lenses(
    measured: Sequence[tuple[Samples, Measurement | None]],
) -> tuple[Floats, Floats] | None:
    """Covariances (n, 6, 6) of poses by the uncertainty of cameras and of lenses.

    None without images.

    Where a camera stands and what its lens does go together: cameras' part is what is left were all lenses known,
    lenses' part the rest, so that both make up what all poses share
    """
    shares: list[tuple[Floats, Floats]] = []
    for samples, measurement in measured:
        if measurement is None:
            return None
        adjustment = measurement.adjustment
        lens = adjustment.shared_factor[
            np.array([part not in PLACE for _, part in adjustment.shared_names], bool) & ~adjustment.of_prints
        ]
        known = (np.linalg.pinv(lens) @ lens)[
            : samples.common.shape[2]
        ]  # draws that hardly move poses come last, and samples are without them
        left = samples.common @ (np.eye(*known.shape) - known)
        whole, cameras = samples.common @ np.swapaxes(samples.common, 1, 2), left @ np.swapaxes(left, 1, 2)
        shares.append((cameras, whole - cameras))
    return np.concatenate([c for c, _ in shares]), np.concatenate([rest for _, rest in shares])


def uncertainty_budget(
    poses: HeldPoses,
    model: Floats,
    repeat: Repeatability,
    measured: Sequence[tuple[Samples, Measurement | None]],
    scale: float | None,
    thermometer_covariances: Floats | None,
) -> Budget:
    """Uncertainty budget of held-out poses.

    model : (n, 6, 6) covariance that the calibration's parameters give each pose; repeat : Repeatability
    measured : (Samples, Measurement or None) of each recording
    scale : relative standard uncertainty of the targets' scale, None where nobody states one
    thermometer_covariances : (n, 6, 6) as `thermometer_covariance` has it
    """
    shared = np.sum([c @ np.swapaxes(c, 1, 2) for c in poses.common], axis=0)
    noise = rms_position_and_rotation_uncertainty(poses.own)
    seen = [float(np.sqrt((poses.errors[:, p] ** 2).sum(axis=1).mean())) for p in PARTS]
    repeatability = [
        None if value is None else _less(value, own) for value, own in zip((repeat.position, repeat.rotation), noise)
    ]
    rest = [
        _less(
            seen[i],
            noise[i],
            rms_position_and_rotation_uncertainty(shared)[i],
            rms_position_and_rotation_uncertainty(model)[i],
            repeatability[i] or 0.0,
        )
        for i in range(2)
    ]
    physics = _alike(poses.errors, rest)
    returns = None if repeatability[0] is None else _alike(poses.errors, [repeatability[0], repeatability[1] or 0.0])
    place = np.pad(poses.T_base_platform.rotation.inv().apply(poses.T_base_platform.translation), ((0, 0), (0, 3)))
    datum = None if scale is None else scale**2 * place[:, :, None] * place[:, None, :]
    parts = pose_covariances_by_cameras_and_by_lenses(measured)
    cameras, lenses = (shared if shared.any() else None, None) if parts is None else parts
    whole = "images" if parts else "stated covariance of the poses, which does not separate cameras from lenses"
    rows = [
        _row(
            "finder",
            "measuring",
            poses.own,
            "A",
            "each pose's own noise, from its corners" if parts else "each pose's own noise, as stated",
        ),
        _row("camera", "measuring", cameras, "A", f"places of the cameras, from the {whole}"),
        _row(
            "lens",
            "measuring",
            lenses,
            "A",
            "lenses, from the images" if parts else "within camera: poses came without their images",
        ),
        _row(
            "datum",
            "measuring",
            datum,
            "B",
            "the uncertainty of the targets' scale is not stated"
            if scale is None
            else "scale of the targets, as stated, at the poses' distance",
        ),
        _row(
            "thermometer",
            "machine",
            thermometer_covariances,
            "A",
            "noise of the logged temperatures, through the corrections that use them"
            if thermometer_covariances is not None
            else "no correction uses a logged temperature, so thermometers contribute nothing",
        ),
        _row("geometry", "machine", model, "A", "covariance of the fitted parameters, at the held-out poses"),
        _row("physics", "machine", physics, "A", "held-out errors beyond all other contributions: unmodelled effects"),
        _row(
            "repeatability",
            "machine",
            returns,
            "A",
            "visits to the same configurations, less measuring noise"
            if returns is not None
            else "no configuration was visited twice",
        ),
    ]
    machine = model + physics + sum(part for part in (returns, datum) if part is not None)
    one = poses.own + shared
    totals = [
        expanded_uncertainty_over_poses(
            machine if thermometer_covariances is None else machine + thermometer_covariances.mean(axis=0)
        ),
        expanded_uncertainty_over_poses(one if datum is None else one + datum),
    ]
    if not poses.rotations:
        rows = [replace(row, rotation=None) for row in rows]
        totals = [replace(total, rotation=None) for total in totals]
    return Budget(tuple(rows), *totals)


def _alike(errors: Floats, sizes: Sequence[float]) -> Floats:
    """(n, 6, 6) covariance of lengths of RMS sizes (m, rad) in the directions in which errors (n, 6) lie, the same for
    every pose.
    """
    out = np.zeros((len(errors), 6, 6))
    for part, size in zip(PARTS, sizes):
        moment = errors[:, part].T @ errors[:, part]
        if size > 0:
            out[:, part, part] = moment * (size**2 / np.trace(moment))
    return out


def thermometer_covariance(calibration: Calibration, poses: Sequence[tuple[Recording, Samples]]) -> Floats | None:
    """Covariance (n, 6, 6) of poses by thermometer noise.

    None where there is none.

    The noise is what a log shows against the straight line through a row's neighbours.
    """
    physics, found, followed = calibration.physics, [], False
    for recording, samples in poses:
        sensors = recording.sensors
        added = np.zeros((len(samples), 6, 6))
        if physics is not None and sensors is not None and len(sensors.t) > 2:
            plain = calibration.with_physics(recording, samples)
            for name in (
                name for name in physics.channels if name.endswith("temperature_C") and name in sensors.channels
            ):
                log = sensors.channels[name]
                off = float(np.sqrt(np.mean((log[1:-1] - (log[:-2] + log[2:]) / 2) ** 2) / 1.5))
                warmer = replace(recording, sensors=Sensors(sensors.t, {**sensors.channels, name: log + off}))
                moved = pose_difference(
                    *(
                        calibration.correction.predict(one.effective)
                        for one in (plain, calibration.with_physics(warmer, samples))
                    )
                )
                added, followed = added + moved[:, :, None] * moved[:, None, :], followed or bool(moved.any())
        found.append(added)
    return np.concatenate(found) if followed else None


def _row(name: str, of: str, covariance: Floats | None, kind: str, source: str) -> Contribution:
    if covariance is None:
        return Contribution(name, of, None, None, None, kind, source)
    U = expanded_uncertainty_over_poses(covariance)
    return Contribution(name, of, U.position, U.rotation, U.k, kind, source)


def _less(value: float, *others: float) -> float:
    return float(np.sqrt(max(value**2 - sum(other**2 for other in others), 0.0)))
