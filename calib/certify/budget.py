"""Where a pose's uncertainty comes from: contributions with k = 2, of measuring and of the machine, each with how it was come by.

What is not known is given as not known, with the reason, never as nothing. docs/mathematics.md (30)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.certify.calibration import Calibration
from calib.certify.held_poses import HeldPoses
from calib.certify.repeats import Repeatability
from calib.samples import Samples
from rig.pose import difference
from rig.recording import Recording, Sensors
from vision.measure import Measurement

K = 2.0
PARTS = (slice(0, 3), slice(3, 6))
PLACE = ("x", "y", "z", "rx", "ry", "rz")  # of a camera; its other unknowns are its lens, but for how markers are printed


@dataclass(frozen=True, slots=True)
class Contribution:
    """name; of : "measuring" or "machine"; position, rotation : U of a pose's length (m, rad; k = 2), None where not known; kind : "A" from scatter,
    "B" otherwise; source : how it was come by, or why it is not known."""

    name: str
    of: str
    position: float | None
    rotation: float | None
    kind: str
    source: str


@dataclass(frozen=True, slots=True)
class Budget:
    """rows : Contributions; machine : (m, rad) U of a pose as commanded, k = 2, its known contributions in squares; measuring : of one measured."""

    rows: tuple[Contribution, ...]
    machine: tuple[float, float | None]
    measuring: tuple[float, float | None]


def rms(covariance: np.ndarray) -> tuple[float, float]:
    """(m, rad) RMS standard uncertainty of the lengths, of covariances (n, 6, 6)."""
    position, rotation = (float(np.sqrt(np.trace(covariance[:, p, p], axis1=1, axis2=2).mean())) for p in PARTS)
    return position, rotation


def by_part(measured: Sequence[tuple[Samples, Measurement | None]]) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """(cameras, lenses), each (m, rad) RMS that their uncertainty adds to a pose, None where poses came without their images.

    Where a camera stands and what its lens does go together: cameras' part is what is left were all lenses known, lenses' part the rest, in
    squares, so that both make up what all poses share
    """
    shares: list[list[tuple[float, float]]] = [[], []]
    for samples, measurement in measured:
        if measurement is None:
            return None, None
        adjustment = measurement.adjustment
        lens = adjustment.shared_factor[np.array([part not in PLACE for _, part in adjustment.shared_names], bool) & ~adjustment.of_prints]
        known = (np.linalg.pinv(lens) @ lens)[: samples.common.shape[2]]  # draws that hardly move poses come last, and samples are without them
        left = samples.common @ (np.eye(*known.shape) - known)
        whole, cameras_own = rms(samples.common @ np.swapaxes(samples.common, 1, 2)), rms(left @ np.swapaxes(left, 1, 2))
        shares[0].append(cameras_own)
        shares[1].append((_less(whole[0], cameras_own[0]), _less(whole[1], cameras_own[1])))
    cameras, lenses = (tuple(np.sqrt(np.mean(np.square(part), axis=0)).tolist()) for part in shares)
    return (cameras[0], cameras[1]), (lenses[0], lenses[1])


def budget(poses: HeldPoses, model: np.ndarray, repeat: Repeatability, measured: Sequence[tuple[Samples, Measurement | None]],
           scale: float | None, warmth: tuple[float, float] | None) -> Budget:
    """Budget of held-out poses.

    model : (n, 6, 6) covariance that the calibration's parameters give each pose; repeat : Repeatability
    measured : (Samples, Measurement or None) of each recording
    scale : relative standard uncertainty of the targets' scale, None where nobody states one
    warmth : (m, rad) RMS as `thermometer` has it
    """
    noise, shared = rms(poses.own), rms(sum(c @ np.swapaxes(c, 1, 2) for c in poses.common))
    cameras, lenses = by_part(measured)
    geometry = rms(model)
    seen = [float(np.sqrt((poses.errors[:, p] ** 2).sum(axis=1).mean())) for p in PARTS]
    again = [None if value is None else _less(value, own) for value, own in zip((repeat.position, repeat.rotation), noise)]
    rest = [_less(seen[i], noise[i], shared[i], geometry[i], again[i] or 0.0) for i in range(2)]
    away = float(np.sqrt((poses.T_base_platform.translation**2).sum(axis=1).mean()))
    whole = "images" if cameras else "poses' stated covariance, which does not tell cameras from lenses"
    rows = [_row("finder", "measuring", noise, "A", "each pose's own noise, from its corners" if cameras else "each pose's own noise, as stated"),
            _row("camera", "measuring", cameras or (shared if any(shared) else None), "A", f"places of the cameras, from the {whole}"),
            _row("lens", "measuring", lenses, "A", "lenses, from the images" if lenses else "within camera: poses came without their images"),
            _row("datum", "measuring", None if scale is None else (scale * away, 0.0), "B",
                 "nobody states how good the targets' scale is" if scale is None else "scale of the targets, as stated, at the poses' distance"),
            _row("thermometer", "machine", warmth, "A", "noise of the logged temperatures, through what is corrected by them" if warmth else
                 "nothing is corrected by a logged temperature, so no thermometer adds to a pose"),
            _row("geometry", "machine", geometry, "A", "covariance of the fitted parameters, at the held-out poses"),
            _row("physics", "machine", (rest[0], rest[1]), "A", "what held-out errors show beyond all else: effects that the calibration leaves"),
            _row("repeatability", "machine", None if again[0] is None else (again[0], again[1] or 0.0), "A",
                 "visits to the same configurations, less measuring noise" if again[0] is not None else "no configuration was visited twice")]
    if not poses.rotations:
        rows = [Contribution(r.name, r.of, r.position, None, r.kind, r.source) for r in rows]
    return Budget(tuple(rows), _sum(rows, "machine", poses.rotations, ("datum",)), _sum(rows, "measuring", poses.rotations))


def thermometer(calibration: Calibration, held: Sequence[tuple[Recording, Samples]]) -> tuple[float, float] | None:
    """(m, rad) RMS that the noise of logged temperatures adds to a pose through the physics that is undone; None where none follows one.

    The noise is what a log shows against the straight line through a row's neighbours.
    """
    physics, squares = calibration.physics, []
    for recording, samples in held:
        sensors = recording.sensors
        if physics is None or sensors is None or len(sensors.t) < 3:
            continue
        names = [name for name in physics.channels if name.endswith("temperature_C") and name in sensors.channels]
        plain = calibration.told(recording, samples)
        for name in names:
            log = sensors.channels[name]
            off = float(np.sqrt(np.mean((log[1:-1] - (log[:-2] + log[2:]) / 2) ** 2) / 1.5))
            warmer = replace(recording, sensors=Sensors(sensors.t, {**sensors.channels, name: log + off}))
            moved = difference(*(calibration.correction.predict(one.effective) for one in (plain, calibration.told(warmer, samples))))
            squares.append([(moved[:, p] ** 2).sum(axis=1).mean() / len(held) for p in PARTS])
    if not squares or not np.any(squares):
        return None
    position, rotation = np.sqrt(np.sum(squares, axis=0)).tolist()
    return position, rotation


def _row(name: str, of: str, value: tuple[float, float] | None, kind: str, source: str) -> Contribution:
    return Contribution(name, of, None if value is None else K * value[0], None if value is None else K * value[1], kind, source)


def _less(value: float, *others: float) -> float:
    return float(np.sqrt(max(value**2 - sum(other**2 for other in others), 0.0)))


def _sum(rows: Sequence[Contribution], of: str, rotations: bool, also: tuple[str, ...] = ()) -> tuple[float, float | None]:
    chosen = [row for row in rows if row.of == of or row.name in also]
    return (float(np.sqrt(sum((row.position or 0.0) ** 2 for row in chosen))),
            float(np.sqrt(sum((row.rotation or 0.0) ** 2 for row in chosen))) if rotations else None)
