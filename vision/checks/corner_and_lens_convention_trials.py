"""Trials of other corner and lens conventions.

And the trial measurement of sampled frames that scores every trial.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict, Unpack

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import NotEnoughData, RigError
from rig.model.design import Camera, Design, Target, corners_of_squares_with_edges_moved_inward
from rig.recording.corner_and_pose_csv_tables import Corners
from vision import opencv_lens_model as lens
from vision.corner_observations_and_merging import observations_from_corners
from vision.marker_corner_prediction import are_all_marker_poses_known, marker_map
from vision.recording_adjustment_with_hand_and_stages import Measurement, measure_observations
from vision.recording_measurement import frames_with_enough_markers, unsolved_frames_with_enough_markers

FRAMES = 8  # looked at
CORNER = 2.0  # times its edges' that a corner moves, at angles of 60 degrees; less at all wider ones
BIASES = (-0.5, -0.35, -0.2, 0.2, 0.35, 0.5)  # px
# px; a corner farther than this from where it ought to be, or in a frame without a pose, counts as this far off
LOST = 20.0


class CornerColumns(TypedDict, total=False):
    """Columns of Corners that a mistake changes."""

    camera: list[str]
    marker: Integers
    corner: Integers
    uv: Floats


@dataclass(frozen=True, slots=True, eq=False)
class SampledRecording:
    """design : Design as stated; corners : Corners of some frames; frames : (f,) their numbers; t : (f,) s."""

    design: Design
    corners: Corners
    frames: Integers
    t: Floats

    def with_cameras(self, cameras: Sequence[Camera]) -> "SampledRecording":
        """The same with other cameras in the design."""
        return replace(self, design=replace(self.design, cameras=tuple(cameras)))

    def with_targets(self, targets: Sequence[Target]) -> "SampledRecording":
        """The same with other targets in the design."""
        return replace(self, design=replace(self.design, targets=tuple(targets)))

    def with_corners(self, **columns: Unpack[CornerColumns]) -> "SampledRecording":
        """The same with some columns of the corners replaced."""
        return replace(self, corners=replace(self.corners, **columns))


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """misfit : px, RMS of the corners' distances from where they ought to be, none more than LOST; seen : what was
    tried;
    measured : Measurement, None where nothing could be solved; miss : (n,) px per corner in the observations' order, or
        None; reason : why nothing could be solved; sparse : whether that is because no frame shows enough markers."""

    misfit: float
    seen: SampledRecording
    measured: Measurement | None
    miss: Floats | None
    reason: str = ""
    sparse: bool = False


def sample_frames(
    design: Design, corners: Corners, frames: Integers, t: Floats, count: int = FRAMES
) -> SampledRecording | None:
    """Sample of frames spread over a recording (Seen).

    Each is the richest of its stretch.
    None without corners, and with markers whose places only measuring finds.
    frames : (F,) all frames' numbers; t : (F,) s. What is on a chain's stages below the last is left aside, and what
    was put back: its place is told only to what remounting may do
    """
    if not are_all_marker_poses_known(design):
        return None
    on_stages = [number for target in design.targets if target.stage for number in target.ids]
    if on_stages:
        design, corners = design.without_stages(), _select_corners(corners, ~np.isin(corners.marker, on_stages))
    put_back = [number for target in design.targets if target.turned is not None for number in target.ids]
    if put_back:
        corners = _select_corners(corners, ~np.isin(corners.marker, put_back))
    if not len(corners.frame):
        return None
    rich = np.bincount(np.searchsorted(frames, corners.frame), minlength=len(frames))
    richest = [part[np.argmax(rich[part])] for part in np.array_split(np.arange(len(frames)), min(count, len(frames)))]
    picked = np.array([k for k in richest if rich[k]])
    return SampledRecording(
        design, _select_corners(corners, np.isin(corners.frame, frames[picked])), frames[picked], t[picked]
    )


def _select_corners(corners: Corners, mask: Booleans) -> Corners:
    """Corners of a mask (n,)."""
    rows = np.flatnonzero(mask)
    return Corners(
        corners.frame[rows],
        [corners.camera[i] for i in rows],
        corners.marker[rows],
        corners.corner[rows],
        corners.uv[rows],
        None if corners.covariance is None else corners.covariance[rows],
    )


def measure_trial(sample: SampledRecording, free: tuple[str, ...] = ("poses", "lenses")) -> Trial:
    """Trial of a sample of frames, measured with cameras and lenses adjusted as by `rig measure`.

    free : see vision.bundle.bundle_adjustment
    """
    known = np.isin(sample.corners.marker, [number for target in sample.design.targets for number in target.ids])
    corners = sample.corners if known.all() else _select_corners(sample.corners, known)
    if not len(corners.frame):
        return Trial(LOST, sample, None, None)
    markers = marker_map(sample.design)
    observations = observations_from_corners(corners, sample.frames, sample.design, markers)
    try:
        measured = measure_observations(observations, sample.design, markers, free)
    except (NotEnoughData, RigError, np.linalg.LinAlgError) as error:
        enough = frames_with_enough_markers(observations, sample.design)
        sparse = len(enough) < min(2, len(sample.frames))  # one that contradicts itself proves nothing
        return Trial(LOST, sample, None, None, str(error), sparse)
    o = measured.observations
    miss = np.minimum(np.nan_to_num(np.linalg.norm(measured.residuals, axis=1), nan=LOST), LOST)
    poor = sorted(
        set(measured.unsolved) - set(unsolved_frames_with_enough_markers(measured))
    )  # too little to see is nobody's mistake
    informative = ~np.isin(o.frames[o.frame], poor)
    share = (miss[informative] ** 2).sum() + LOST**2 * (~known).sum()
    return Trial(float(np.sqrt(share / max(informative.sum() + (~known).sum(), 1))), sample, measured, miss)


def least_misfit_with_edge_bias(first: Trial, wanted: float) -> float:
    """Least misfit (px) that a common edge bias leaves.

    Black that spreads alike in every image is due to the cameras.
    wanted : px; where no bias can leave so little, a bound is given and nothing is tried
    """
    if (bound := first.misfit - CORNER * max(BIASES)) > wanted:
        return bound

    def put(bias: float) -> SampledRecording:
        seen, names = first.seen, np.array(first.seen.corners.camera)
        c = seen.corners
        order = np.lexsort((c.corner, c.marker, c.frame, names))
        uv = c.uv.copy()
        quads = order.reshape(-1, 4)
        uv[quads] = corners_of_squares_with_edges_moved_inward(c.uv[quads], bias) if bias else c.uv[quads]
        return seen.with_corners(uv=uv)

    if (
        len(first.seen.corners.frame) % 4
        or (np.bincount(first.seen.corners.corner, minlength=4) * 4 != len(first.seen.corners.frame)).any()
    ):
        return first.misfit
    return min(measure_trial(put(bias)).misfit for bias in BIASES)


def stated_trial_from_cameras_of_other_trial(first: Trial, other: Trial) -> Trial | None:
    """The stated trial measured again from another trial's cameras.

    None unless only targets differ.

    The other trial is of another statement of the targets.
    """
    stated, seen, measured = first.seen, other.seen, other.measured
    if seen.corners is not stated.corners or seen.design.cameras is not stated.design.cameras or measured is None:
        return None
    return measure_trial(stated.with_cameras(measured.design.cameras))


Candidate = tuple[str, str, SampledRecording]
ORDERS = {
    (3, 2, 1, 0): "run counter-clockwise from the bottom left",
    (0, 3, 2, 1): "run counter-clockwise",
    (1, 0, 3, 2): "run counter-clockwise from the top right",
    (2, 1, 0, 3): "run counter-clockwise from the bottom right",
    (1, 2, 3, 0): "begin one corner later (top right)",
    (2, 3, 0, 1): "begin at the opposite corner",
    (3, 0, 1, 2): "begin one corner earlier (bottom left)",
    (0, 1, 3, 2): "are in rows (0 1 over 2 3), not in a circle",
}


def corner_correction_candidates_for_all_cameras(sample: SampledRecording) -> Iterator[Candidate]:
    """Corrections of corner conventions and marker ids to try, all cameras alike.

    Yields (what, what to do, Seen with it undone).

    Returns (mistake, advice, sample)
    """
    yield from _of(sample, [("", np.ones(len(sample.corners.frame), bool))])
    c = sample.corners
    ids = sorted(number for target in sample.design.targets for number in target.ids)
    for by in (1, -1):
        moved = c.marker + by
        if np.isin(moved, ids).mean() > 0.7:
            yield (
                f"corners.csv: marker ids are off by one ({'too small' if by > 0 else 'too large'}): they "
                f"count from {min(ids) - by} where "
                f"rig.toml counts from {min(ids)}",
                f"{'Add' if by > 0 else 'Subtract'} 1, or state the ids that are printed",
                sample.with_corners(marker=moved),
            )


def corner_correction_candidates_by_camera(sample: SampledRecording) -> Iterator[Candidate]:
    """Corrections of corner conventions to try, a single camera at a time.

    Returns (mistake, advice, corrected sample)
    """
    names = np.array(sample.corners.camera)
    if len(sample.design.cameras) > 1:
        yield from _of(
            sample, [(f" of camera {camera.name}", names == camera.name) for camera in sample.design.cameras]
        )


def _of(seen: SampledRecording, parts: list[tuple[str, Floats]]) -> Iterator[Candidate]:
    """Mistakes in parts of the corners. parts : (how they are called, (n,) bool)"""
    c = seen.corners
    size = {camera.name: np.array([camera.width, camera.height], float) for camera in seen.design.cameras}
    wide = np.array([size[name] for name in c.camera])
    for who, rows in parts:
        if not rows.any():
            continue

        def put(uv: Floats, rows: Floats = rows) -> SampledRecording:
            return seen.with_corners(uv=np.where(rows[:, None], uv, c.uv))

        yield f"corners.csv: u and v{who} are exchanged", "u runs to the right, v down", put(c.uv[:, ::-1])
        yield (
            f"corners.csv: images{who} are mirrored left to right (flipped)",
            "Read the corners from unflipped camera images",
            put(np.column_stack([wide[:, 0] - 1 - c.uv[:, 0], c.uv[:, 1]])),
        )
        yield (
            f"corners.csv: images{who} are upside down (v counts upwards)",
            "v is 0 in the top row and runs down",
            put(np.column_stack([c.uv[:, 0], wide[:, 1] - 1 - c.uv[:, 1]])),
        )
        for factor in (2.0, 0.5, 4.0, 0.25):
            yield (
                f"corners.csv: corners{who} are of images of {1 / factor:g} times the size that rig.toml "
                "states (width, height, matrix)",
                "State width, height and matrix of the images that the corners were read from",
                put((c.uv + 0.5) * factor - 0.5),
            )
        for order, text in ORDERS.items():
            yield (
                f"corners.csv: the corners' order is another{who}: they {text}",
                "Corners 0..3 run clockwise from the marker's own top left",
                seen.with_corners(corner=np.where(rows, np.argsort(order)[c.corner], c.corner)),
            )


ALIKE = (0.015, 0.01, 1.0)  # of the focal length, of the width, px: within which two lenses are one


def lens_convention_trials(sample: SampledRecording) -> Iterator[Candidate]:
    """Trials with alternative lenses.

    Matrix and distortion in another order, sign or image size.
    """
    cameras = sample.design.cameras
    for what, do, other in _LENSES:
        mended = [other(camera) for camera in cameras]
        if all(_same(a, b) for a, b in zip(mended, cameras)):
            continue
        message = (
            f"rig.toml: {what} of all cameras" if len(cameras) > 1 else f"rig.toml: camera {cameras[0].name}: {what}"
        )
        yield message, do, sample.with_cameras(tuple(mended))
        for i, camera in enumerate(cameras if len(cameras) > 1 else ()):
            if not _same(mended[i], camera):
                yield (
                    f"rig.toml: camera {camera.name}: {what}",
                    do,
                    sample.with_cameras((*cameras[:i], mended[i], *cameras[i + 1 :])),
                )


def alternative_distortion_conventions(camera: Camera) -> Iterator[tuple[str, str, Camera]]:
    """Alternative conventions of a distortion, sign or order.

    Returns (what, what to do, Camera)
    """
    for what, do, other in _LENSES:
        if "distortion" in what and not _same(other(camera), camera):
            yield what, do, other(camera)


def rms_pixel_difference_of_distortions(a: Camera, b: Camera) -> float:
    """Difference of two cameras' distortions, px RMS over the image of a."""
    x, y = np.meshgrid(
        np.linspace(-0.45, 0.45, 9) * a.width / a.matrix[0, 0], np.linspace(-0.45, 0.45, 9) * a.height / a.matrix[1, 1]
    )
    points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    gap = lens.project(points, a.matrix, a.distortion) - lens.project(points, a.matrix, b.distortion)
    return float(np.sqrt((gap**2).sum(axis=1).mean()))


def find_matching_lens_convention(sample: SampledRecording, adjusted: tuple[Camera, ...]) -> Candidate | None:
    """The convention of the stated lenses that matches the adjusted ones, or None.

    adjusted : the Cameras of Seen, adjusted from lenses of which nothing is known
    """
    found = [
        one
        for one in lens_convention_trials(sample)
        if all(is_same_lens_within_calibration_drift(a, b) for a, b in zip(one[2].design.cameras, adjusted))
    ]
    return (
        found[0]
        if found
        and not all(is_same_lens_within_calibration_drift(a, b) for a, b in zip(sample.design.cameras, adjusted))
        else None
    )


def is_same_lens_within_calibration_drift(a: Camera, b: Camera) -> bool:
    """Whether two cameras have the same lens within the drift of a calibrated lens."""
    gap = np.abs(a.matrix[:2] - b.matrix[:2])
    return bool(
        gap[[0, 1], [0, 1]].max() < ALIKE[0] * a.matrix[0, 0]
        and gap[:, 2].max() < ALIKE[1] * a.width
        and rms_pixel_difference_of_distortions(a, b) < ALIKE[2]
    )


def _same(a: Camera, b: Camera) -> bool:
    return np.array_equal(a.matrix, b.matrix) and np.array_equal(a.distortion, b.distortion) and a.pose is b.pose


def _matrix(fx: float, fy: float, cx: float, cy: float) -> Floats:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def _parts(c: Camera) -> tuple[float, float, float, float]:
    return c.matrix[0, 0], c.matrix[1, 1], c.matrix[0, 2], c.matrix[1, 2]


def _with_matrix(order: tuple[int, int, int, int]) -> Callable[[Camera], Camera]:
    def other(c: Camera) -> Camera:
        parts = _parts(c)
        if min(parts) <= 0:
            return c
        return replace(c, matrix=_matrix(*(parts[k] for k in order)))

    return other


def _scaled(factor: float) -> Callable[[Camera], Camera]:
    return lambda c: replace(
        c,
        matrix=_matrix(
            c.matrix[0, 0] * factor,
            c.matrix[1, 1] * factor,
            (c.matrix[0, 2] + 0.5) * factor - 0.5,
            (c.matrix[1, 2] + 0.5) * factor - 0.5,
        ),
    )


def focal_length_scaler(factor: float) -> Callable[[Camera], Camera]:
    """Function that scales the focal length of a camera by a factor."""
    return lambda c: replace(
        c, matrix=_matrix(c.matrix[0, 0] * factor, c.matrix[1, 1] * factor, c.matrix[0, 2], c.matrix[1, 2])
    )


def _terms(change: Callable[[Floats], Floats]) -> Callable[[Camera], Camera]:
    def other(c: Camera) -> Camera:
        d = np.zeros(max(5, len(c.distortion)))
        d[: len(c.distortion)] = c.distortion
        return replace(c, distortion=change(d)) if len(d) == 5 else c

    return other


_ORDER = "Write matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"


_LENS = "Write k1, k2, p1, p2, k3 as OpenCV has them"


_LENSES = (
    ("fx, fy and cx, cy are exchanged in the matrix", _ORDER, _with_matrix((2, 3, 0, 1))),
    ("the matrix has fx, cx, fy, cy in another order", _ORDER, _with_matrix((0, 2, 1, 3))),
    ("cx and cy are exchanged in the matrix", _ORDER, _with_matrix((0, 1, 3, 2))),
    ("the matrix is of images of half the size", "Scale the matrix with the images", _scaled(2.0)),
    ("the matrix is of images of twice the size", "Scale the matrix with the images", _scaled(0.5)),
    ("the focal length is half of what it should be", "State it in pixels", focal_length_scaler(2.0)),
    ("the focal length is twice what it should be", "State it in pixels", focal_length_scaler(0.5)),
    ("the sign of the distortion is reversed", _LENS, _terms(lambda d: -d)),
    ("distortion is in another order (k1 k2 k3 p1 p2)", _LENS, _terms(lambda d: d[[0, 1, 3, 4, 2]])),
    ("distortion is in another order (k1 p1 k2 p2 k3)", _LENS, _terms(lambda d: d[[0, 2, 1, 3, 4]])),
    ("distortion is in another order (p1 p2 k1 k2 k3)", _LENS, _terms(lambda d: d[[2, 3, 0, 1, 4]])),
    ("k1 and k2 of the distortion are exchanged", _LENS, _terms(lambda d: d[[1, 0, 2, 3, 4]])),
)
