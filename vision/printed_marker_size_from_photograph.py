"""Printed marker size from a photograph.

It shows markers with a sheet or ruler of known size.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.errors import FileError, RigError
from rig.model.design import Camera, Design
from rig.recording.exposures_and_image_files import MOST_OF_A_PHOTOGRAPH, read_grey_or_colour_image
from vision.corners.marker_detection_and_corner_fit import detect_markers
from vision.marker_corner_prediction import MarkerMap, marker_map

CORNERS = np.array(
    [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]
)  # of a square of side 1, from its top left, clockwise, y up
LEAST_SHARE = 0.1  # of the photograph, that the sheet must cover
SAMPLES = 60  # places along a side of the sheet where its edge is looked for
READ = 1.0  # px, standard deviation of an end of a ruler as somebody points at it


@dataclass(frozen=True, slots=True)
class Printed:
    """scale : (n,) true over nominal size, along each direction that was measured; directions : their names, as said to
    a user
    uncertainty : (n,) standard, of scale; markers : how many; bend : px, by which a straight edge of the sheet is bent,
        NaN where none was seen"""

    scale: tuple[float, ...]
    directions: tuple[str, ...]
    uncertainty: tuple[float, ...]
    markers: int
    bend: float

    @property
    def mean_scale(self) -> float:
        """Mean of the scales along all directions."""
        return sum(self.scale) / len(self.scale)


def measure_printed_marker_scale(
    photo: Path, design: Design, sheet: tuple[float, float, float], ruler: tuple[Floats, float] | None = None
) -> Printed:
    """Measure the printed scale of markers in a photograph.

    It is by a ruler or, without one, by the whole sheet.
    sheet : width, height and their standard uncertainty, m; ruler : (2, 2) px of two of its lines, and m between them
    Raises FileError for a file that is no picture, RigError as `print_scales_across_and_along_sheet` and
        `print_scale_by_ruler`
    """
    if not photo.is_file():
        raise FileError(photo, "no such file")
    try:
        image = read_grey_or_colour_image(photo, MOST_OF_A_PHOTOGRAPH)
    except FileError as error:
        raise FileError(
            photo, f"is not a readable picture (truncated?): {str(error).removeprefix(error.path).lstrip(': ')}"
        ) from None
    if ruler is not None:
        return print_scale_by_ruler(image, design, *ruler)
    width, height, uncertainty = sheet
    return print_scales_across_and_along_sheet(image, design, (width, height), uncertainty)


def print_scales_across_and_along_sheet(
    image: Pixels, design: Design, paper: tuple[float, float], tolerance: float
) -> Printed:
    """Printed scales of the markers across and along a whole sheet.

    image : as cv2.imread gives it; paper : (width, height) m; tolerance : m, standard uncertainty of both. Raises
    RigError where no marker of the rig or no full sheet is seen
    """
    seen, side = _seen(image, design)
    ends, bend = _sheet(image, seen.reshape(-1, 2))
    best = None
    for turn in (
        0,
        1,
    ):  # which two of its corners are the ends of a short side, is told by the markers, which are square
        square = np.array([(0, paper[1]), (paper[0], paper[1]), (paper[0], 0), (0, 0)])
        H = cv2.getPerspectiveTransform(np.roll(ends, turn, axis=0).astype(np.float32), square.astype(np.float32))
        metric = cv2.perspectiveTransform(seen.reshape(1, -1, 2), H.astype(np.float64)).reshape(-1, 4, 2)
        sides = np.roll(metric, -1, axis=1) - metric
        along = np.abs(sides[..., 1]) > np.abs(sides[..., 0])
        ratio = np.linalg.norm(sides, axis=-1) / side[:, None]
        across, up = ratio[~along], ratio[along]
        unlike = abs(np.log(across.mean() / up.mean())) if len(across) and len(up) else np.inf
        if best is None or unlike < best[0]:
            best = unlike, (across, up), np.linalg.norm(ends[1] - ends[0])
    assert best is not None
    scale = tuple(float(part.mean()) for part in best[1])
    scatter = [part.std(ddof=1) / np.sqrt(len(part)) for part in best[1]]
    seen_as = [np.hypot(tolerance / paper[k], bend / best[2]) for k in (0, 1)]
    return Printed(
        scale,
        ("across the sheet", "along the sheet"),
        tuple(float(np.hypot(a, b)) for a, b in zip(scatter, seen_as)),
        len(seen),
        bend,
    )


def print_scale_by_ruler(image: Pixels, design: Design, ends: Floats, length: float) -> Printed:
    """Printed scale of the markers along a ruler.

    ends : (2, 2) px of two of its lines; length : m between them. The markers are taken to be printed as large one way
    as the other. Raises RigError where no marker of the rig is seen
    """
    seen, side = _seen(image, design)
    H = _plane(seen, side)
    back = np.linalg.inv(H)

    def nominal(points: Floats) -> float:
        first, second = cv2.perspectiveTransform(points.reshape(1, 2, 2), back)[0]
        return float(np.linalg.norm(second - first))

    found = nominal(ends)
    by_end = [nominal(ends + READ * step.reshape(2, 2)) - found for step in np.eye(4)]
    residual = _misfit(H, seen, side)
    own = residual / np.linalg.norm(seen[:, 1] - seen[:, 0], axis=-1).mean() / np.sqrt(len(seen))
    return Printed(
        (length / found,),
        ("along the ruler",),
        (float(np.hypot(np.linalg.norm(by_end) / found, own)),),
        len(seen),
        float("nan"),
    )


def _seen(image: Pixels, design: Design) -> tuple[Floats, Floats]:
    """((m, 4, 2) px corners of the rig's markers, (m,) m their sides as stated)."""
    markers = marker_map(design)
    height, width = image.shape[:2]
    matrix = np.array([[1.2 * max(width, height), 0, width / 2], [0, 1.2 * max(width, height), height / 2], [0, 0, 1]])
    found = detect_markers(
        image, Camera("photograph", width, height, matrix, np.zeros(5), RigidTransform.identity()), markers
    )
    if not len(found.marker):
        raise RigError("no marker of the rig is seen in the photograph")
    return found.corners.astype(np.float64), _sides(markers, found.marker)


def _sides(markers: MarkerMap, numbers: Integers) -> Floats:
    side = dict(zip(markers.id.tolist(), markers.side.tolist()))
    return np.array([side[int(number)] for number in numbers])


def _sheet(image: Pixels, inside: Floats) -> tuple[Floats, float]:
    """((4, 2) px corners of the sheet around some points, clockwise from one of its own; px by which its edges are
    bent).
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
    grey = grey if grey.dtype == np.uint8 else (grey / 257).astype(np.uint8)
    bright = cv2.threshold(cv2.GaussianBlur(grey, (0, 0), 2), 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[1]
    outlines, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for outline in sorted(outlines, key=cv2.contourArea, reverse=True)[:3]:
        hull = cv2.convexHull(outline)
        rough = cv2.approxPolyDP(hull, 0.02 * cv2.arcLength(hull, True), True).reshape(-1, 2).astype(float)
        within = hull.min() > 1 and bool((hull.reshape(-1, 2).max(axis=0) < np.array(grey.shape[::-1]) - 2).all())
        whole = len(rough) == 4 and cv2.contourArea(hull) > LEAST_SHARE * grey.size and within
        if whole and all(cv2.pointPolygonTest(hull, (float(u), float(v)), False) > 0 for u, v in inside):
            fits = [_edge(grey, rough[k], rough[(k + 1) % 4]) for k in range(4)]
            lines = [line for line, _ in fits]
            corners = np.array(
                [
                    np.linalg.solve(
                        np.stack([lines[k - 1][:2], lines[k][:2]]), -np.array([lines[k - 1][2], lines[k][2]])
                    )
                    for k in range(4)
                ]
            )
            turned = (
                np.linalg.det(np.stack([corners[1] - corners[0], corners[2] - corners[1]])) < 0
            )  # counter-clockwise as one looks at it
            return (corners[::-1] if turned else corners), max(bend for _, bend in fits)
    raise RigError(
        "no full sheet is seen around the markers: lay it flat on a plain, darker ground, all four "
        "corners in the photograph, "
        "or lay a ruler next to it and give --ruler"
    )


def _edge(grey: Pixels, a: Floats, b: Floats) -> tuple[Floats, float]:
    """((3,) line n u + m v + c = 0 px through the sheet's edge near a to b (2,) px; px RMS by which the edge leaves
    it).
    """
    along = (b - a) / np.linalg.norm(b - a)
    normal = np.array([-along[1], along[0]])
    reach = max(4, int(0.01 * np.linalg.norm(b - a)))
    offsets = np.arange(-reach, reach + 0.5, 0.5)
    places = a + np.linspace(0.08, 0.92, SAMPLES)[:, None] * (b - a)
    points = (places[:, None] + offsets[:, None] * normal).astype(np.float32)
    steps = np.abs(
        np.diff(cv2.remap(grey.astype(np.float32), points[..., 0], points[..., 1], cv2.INTER_LINEAR), axis=1)
    )
    strong = np.where(steps > 0.5 * steps.max(axis=1, keepdims=True), steps, 0)
    at = (strong * (offsets[:-1] + 0.25)).sum(axis=1) / np.maximum(strong.sum(axis=1), 1e-9)
    found = places + at[:, None] * normal
    vx, vy, x, y = cv2.fitLine(found.astype(np.float32), cv2.DIST_HUBER, 0, 1e-3, 1e-3).ravel().astype(float)
    line = np.array([-vy, vx, vy * x - vx * y])
    return line, float(np.sqrt(np.median((found @ line[:2] + line[2]) ** 2)) / 0.6745)


def _plane(seen: Floats, side: Floats) -> Floats:
    """(3, 3) homography from the paper (m, as large as stated) to the image, in which all markers are squares of their
    sides.
    """
    first = cv2.getPerspectiveTransform((side[0] * CORNERS).astype(np.float32), seen[0].astype(np.float32))
    start = cv2.perspectiveTransform(seen.reshape(1, -1, 2), np.linalg.inv(first)).reshape(-1, 4, 2)
    top = start[:, 1] - start[:, 0]
    places = np.column_stack([start.mean(axis=1), np.arctan2(top[:, 1], top[:, 0])])[1:]
    x = np.concatenate([(first / first[2, 2]).ravel()[:8], places.ravel()])
    scale = np.abs(x) + 1e-3

    def residual(p: Floats) -> Floats:
        return (_projected(p, side) - seen).ravel()

    done = scipy.optimize.least_squares(residual, x, x_scale=scale, method="lm" if len(seen) > 1 else "trf")
    return np.append(done.x[:8], 1.0).reshape(3, 3)


def _projected(p: Floats, side: Floats) -> Floats:
    """(m, 4, 2) px of squares: 8 numbers of the homography, then x, y (m) and turn (rad) of all but the first, which is
    the origin.
    """
    H, places = np.append(p[:8], 1.0).reshape(3, 3), np.vstack([np.zeros(3), p[8:].reshape(-1, 3)])
    c, s = np.cos(places[:, 2]), np.sin(places[:, 2])
    turned = side[:, None, None] * np.einsum(
        "mij,kj->mki", np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2), CORNERS
    )
    points = np.concatenate([turned + places[:, None, :2], np.ones((len(side), 4, 1))], axis=-1) @ H.T
    return points[..., :2] / points[..., 2:]


def _misfit(H: Floats, seen: Floats, side: Floats) -> float:
    """px RMS, by which sides in the plane of a homography differ from those stated."""
    plane = cv2.perspectiveTransform(seen.reshape(1, -1, 2), np.linalg.inv(H)).reshape(-1, 4, 2)
    ratio = np.linalg.norm(np.roll(plane, -1, axis=1) - plane, axis=-1) / side[:, None]
    return float(np.sqrt(np.mean((ratio - 1) ** 2)) * np.linalg.norm(seen[:, 1] - seen[:, 0], axis=-1).mean())
