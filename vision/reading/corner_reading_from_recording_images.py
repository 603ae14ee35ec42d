"""Corners of a recording's images.

Read in parallel, and the search for missed markers.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.compute.parallel_map_and_dask_cluster import path_seen_by_cluster_workers
from rig.errors import FileError
from rig.model.design import Camera, Design
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.exposures_and_image_files import read_grey_or_colour_image, undecodable_images, unusable_images_error
from rig.recording.recording_folder import Recording
from vision.corner_observations_and_merging import correlations_of_whitened_marker_corners
from vision.corners.edge_spread_function import PLAIN_EDGE_SPREAD, EdgeSpread, empty_residual_profile, learn_edge_spread
from vision.corners.marker_detection_and_corner_fit import (
    Detection,
    ReadMarkers,
    detect_markers,
    fit_read_markers,
    grey_image_at_full_depth,
    grey_images_for_reader_and_fit,
    read_markers,
)
from vision.marker_corner_prediction import MarkerMap, expected_marker_rows_and_corners_in_image
from vision.reading import marker_identity_mistakes_and_expected_marker_places
from vision.reading.parallel_image_map_rendered_markers_and_white_level import (
    map_images_in_processes,
    map_images_in_threads,
)
from vision.recording_adjustment_with_hand_and_stages import Measurement

LEARN_FROM = 12  # images of each camera from which its edge spread is learnt
ROUNDS = 4  # of fitting and learning; the edges' width and shape settle together
FALSE_ALARM = 4.0  # px; a marker found farther from where it was expected is not it

Found = tuple[int, str, Detection]  # frame number, camera name, what that image shows


class Unplaced(NamedTuple):
    """A marker that was read in an image and not placed. marker : identity; repeated : whether it is that the image
    shows it twice.
    """

    frame: int
    camera: str
    marker: int
    reason: str
    repeated: bool


@dataclass(frozen=True, slots=True, eq=False)
class Collected:
    """Corners of all images; correlation : (n, 2, 8) of them, see Observations
    left_out : markers read but not placed; spread : {camera: Spread} learnt from its images
    blur : {camera: (k,) px} and noise : {camera: (k,) grey levels} over its markers
    cameras : {camera: Camera} by whose lens the markers of most images were placed."""

    corners: Corners
    correlation: Floats | None
    left_out: list[Unplaced]
    blur: dict[str, Floats]
    noise: dict[str, Floats]
    spread: dict[str, EdgeSpread]
    cameras: dict[str, Camera]

    @property
    def repeated(self) -> list[int]:
        """Identities of markers that one image shows more than once, as often as there are such images."""
        return _repeated(self.left_out)


def image_reader(recording: Recording) -> Callable[[int, str], Floats | None]:
    """Reader of a recording's images.

    A function of (frame number, camera name) -> image, or None without one.
    """
    e = recording.exposures
    names = {(int(frame), camera): name for frame, camera, name in zip(e.frame, e.camera, e.image) if name}

    def read(frame: int, camera: str) -> Floats | None:
        name = names.get((int(frame), camera))
        return (
            None
            if name is None
            else grey_images_for_reader_and_fit(read_grey_or_colour_image(recording.folder / name))[0]
        )

    return read


def read_corners_of_all_images(
    recording: Recording, marker_map: MarkerMap, progress: Callable[[int, int], None] | None = None
) -> Collected:
    """Collect the corners of every image of a recording.
    Raises FileError naming all images that cannot be decoded.
    """
    try:
        return _collected(recording, marker_map, progress)
    except FileError:
        bad = undecodable_images(recording.folder, recording.exposures)
        if not bad:
            raise
        raise unusable_images_error(bad) from None


def _collected(recording: Recording, marker_map: MarkerMap, progress: Callable[[int, int], None] | None) -> Collected:
    """Collected from every image of a recording. progress : called with (done, of), or None.

    Some images of each camera are searched whole: they teach how its edges look, and what to expect of the others.
    There only the places are read where markers ought to be. The whole image is searched after all where half a body's
    markers are not there, where another marker is in the place of one that is not, and on a rig that is not as it is
    stated.
    Raises FileError naming the image that cannot be decoded or has another size than its camera.
    """
    e, design, folder = recording.exposures, recording.design, path_seen_by_cluster_workers(recording.folder)
    work = [(int(e.frame[i]), design.camera(e.camera[i]), name) for i, name in enumerate(e.image) if name]
    tell = _counter(progress, len(work))
    found: dict[int, Detection] = {}
    stated = {camera.name: camera for _, camera, _ in work}
    taught = sorted({k for name in stated for k in _some([i for i, w in enumerate(work) if w[1].name == name])})

    def searched(k: int) -> tuple[Floats, ReadMarkers]:
        _, camera, name = work[k]
        eight, full = grey_images_for_reader_and_fit(_image(folder, camera, name))
        return full, read_markers(eight, marker_map)

    whole = dict(zip(taught, map_images_in_threads(searched, taught, None)))
    spread = {
        name: learn_camera_edge_spread([whole[k] for k in taught if work[k][1].name == name], camera, marker_map)
        for name, camera in stated.items()
    }

    def placed(k: int) -> Detection:
        full, read = whole[k]
        return fit_read_markers(full, work[k][1], marker_map, read, spread[work[k][1].name])

    found.update(zip(taught, map_images_in_threads(placed, taught, tell)))
    rest = [k for k in range(len(work)) if k not in found]
    rows = [(work[k][0], work[k][1].name, found[k]) for k in taught]
    known = (
        marker_identity_mistakes_and_expected_marker_places.learn_expected_marker_places(
            recording, *corners_and_correlation_from_detections(rows), _repeated(_left_out(rows)), marker_map
        )
        if len(rest) > len(taught)
        else None
    )
    cameras = {name: camera for name in stated if known is not None and (camera := known.camera(name)) is not None}

    def bent(k: int) -> Detection:
        camera = cameras[work[k][1].name]
        return fit_read_markers(
            whole[k][0], camera, marker_map, found[k].read, spread[camera.name], search_distance=0.0
        )

    adjusted = [
        k for k in taught if work[k][1].name in cameras
    ]  # whose markers the lens as stated bent otherwise than those of other images
    found.update(zip(adjusted, map_images_in_threads(bent, adjusted, None)))
    whole.clear()
    lenses = stated | cameras

    def one(item: tuple[Camera, str, RigidTransform | None]) -> Detection:
        camera, name, T = item
        return detect_markers(
            _image(folder, camera, name),
            lenses[camera.name],
            marker_map,
            spread[camera.name],
            T if camera.name in cameras else None,
            search_for_others=True,
        )

    if known is None or known.commanded:
        commanded = known.commanded if known else {}
        found.update(
            zip(rest, map_images_in_processes(one, [(*work[k][1:], commanded.get(work[k][0])) for k in rest], tell))
        )
    else:
        found.update(_one_after_the_other(work, rest, found, one, known, design, tell))
    rows = [(frame, camera.name, found[k]) for k, (frame, camera, _) in enumerate(work)]
    return Collected(
        *corners_and_correlation_from_detections(rows),
        _left_out(rows),
        _by_camera(rows, "blur"),
        _by_camera(rows, "noise"),
        spread,
        lenses,
    )


def _image(folder: Path, camera: Camera, name: str) -> Pixels:
    image = read_grey_or_colour_image(folder / name)
    if image.shape[:2] != (camera.height, camera.width):
        raise FileError(
            folder / name,
            f"is {image.shape[1]} x {image.shape[0]} px, but camera {camera.name!r} has "
            f"{camera.width} x {camera.height} px",
        )
    return image


def _some(indices: list[int]) -> list[int]:
    """Those of a camera's images that teach."""
    return [indices[round(k)] for k in np.linspace(0, len(indices) - 1, min(LEARN_FROM, len(indices)))]


def _one_after_the_other(
    work: list[tuple[int, Camera, str]],
    rest: list[int],
    found: dict[int, Detection],
    one: Callable[[tuple[Camera, str, RigidTransform | None]], Detection],
    known: marker_identity_mistakes_and_expected_marker_places.Expectation,
    design: Design,
    tell: Callable[..., None] | None,
) -> dict[int, Detection]:
    """{index: Detection} of images frame by frame, each expected where the frame before was."""
    out: dict[int, Detection] = {}
    last: RigidTransform | None = None
    for frame in sorted({frame for frame, *_ in work}):
        own = [k for k, (number, *_) in enumerate(work) if number == frame]
        fresh = [k for k in own if k in rest]
        out.update(zip(fresh, map_images_in_threads(one, [(*work[k][1:], last) for k in fresh], tell)))
        last = known.locate(
            corners_and_correlation_from_detections([(frame, work[k][1].name, out.get(k) or found[k]) for k in own])[0],
            frame,
            design,
        )
    return out


def _counter(progress: Callable[[int, int], None] | None, total: int) -> Callable[..., None] | None:
    """A progress that goes on counting where the one before has ended."""
    done = iter(range(1, total + 1))
    return (lambda *_: progress(next(done), total)) if progress else None


def _left_out(rows: Iterable[Found]) -> list[Unplaced]:
    return [Unplaced(frame, name, *one) for frame, name, d in rows for one in d.left_out]


def _repeated(left_out: Iterable[Unplaced]) -> list[int]:
    return [one.marker for one in left_out if one.repeated]


def learn_camera_edge_spread(
    read_images: Sequence[tuple[Floats, ReadMarkers]], camera: Camera, marker_map: MarkerMap
) -> EdgeSpread:
    """Learn the edge spread of a camera from images that were read.
    read_images : (image (height, width) in 255ths of white, ReadMarkers of it) each
    """

    def first(item: tuple[Floats, ReadMarkers]) -> tuple[Floats, Detection]:
        full, read = item
        return full, fit_read_markers(full, camera, marker_map, read)

    seen = [(full, d.read) for full, d in map_images_in_threads(first, read_images, None) if len(d.marker)]
    spread = PLAIN_EDGE_SPREAD
    for _ in range(ROUNDS if seen else 0):

        def repeated(item: tuple[Floats, ReadMarkers], spread: EdgeSpread = spread) -> tuple[Detection, Floats]:
            full, read = item
            profile = empty_residual_profile()
            return fit_read_markers(
                full, camera, marker_map, read, spread, search_distance=0.0, profile=profile
            ), profile

        done = map_images_in_threads(repeated, seen, None)
        blur = np.concatenate([d.blur for d, _ in done])
        if len(blur):
            spread = learn_edge_spread(
                spread, sum((profile for _, profile in done[1:]), done[0][1]), float(np.median(blur))
            )
    return spread


def search_missed_markers(
    recording: Recording,
    collected: Collected,
    measurement: Measurement,
    marker_map: MarkerMap,
    progress: Callable[[int, int], None] | None = None,
) -> Collected:
    """Search for missed markers, added to Collected.

    They are those expected by the measured poses that were not read.
    measurement : Measurement of the collected corners. A marker is added where its bits are read and it is found within
    FALSE_ALARM of its place.
    """
    camera_of = {camera.name: camera for camera in measurement.design.cameras}
    seen = defaultdict(set)
    for frame, name, number in zip(
        collected.corners.frame.tolist(), collected.corners.camera, collected.corners.marker.tolist()
    ):
        seen[frame, name].add(number)
    bodies = {
        k: dict(zip(m.frames.tolist(), m.T_base_platform)) for k, m in {0: measurement, **measurement.stages}.items()
    }
    work, folder = [], path_seen_by_cluster_workers(recording.folder)
    for frame, camera_name, name in zip(
        recording.exposures.frame.tolist(), recording.exposures.camera, recording.exposures.image
    ):
        camera = camera_of.get(camera_name)
        if name and camera is not None and camera.mount != "moving":
            work += [
                (camera, name, stage, poses[frame], seen[frame, camera_name], frame)
                for stage, poses in bodies.items()
                if frame in poses
            ]

    spread = collected.spread

    def one(item: tuple[Camera, str, int, RigidTransform, set[int], int]) -> Detection | None:
        camera, name, stage, T, read, _ = item
        rows, places = expected_marker_rows_and_corners_in_image(camera, T, marker_map)
        fresh = [
            k for k, row in enumerate(rows) if marker_map.stage[row] == stage and int(marker_map.id[row]) not in read
        ]
        if not fresh:
            return None
        numbers, places = marker_map.id[rows[fresh]], places[fresh]
        full = grey_image_at_full_depth(read_grey_or_colour_image(folder / name))
        d = fit_read_markers(
            full,
            camera,
            marker_map,
            ReadMarkers(numbers, places),
            spread.get(camera.name, PLAIN_EDGE_SPREAD),
            verify=True,
        )
        at = [numbers.tolist().index(number) for number in d.marker]
        return d.take(np.abs(d.corners - places[at]).max(axis=(1, 2)) < FALSE_ALARM if len(at) else np.zeros(0, bool))

    found = [
        (frame, camera.name, d)
        for (camera, *_, frame), d in zip(work, map_images_in_processes(one, work, progress))
        if d is not None
    ]
    extra, correlation = corners_and_correlation_from_detections(found)
    return replace(
        collected,
        corners=_joined(collected.corners, extra),
        correlation=np.concatenate([collected.correlation, correlation]),
    )


def corners_and_correlation_from_detections(detections: Sequence[Found]) -> tuple[Corners, Floats]:
    """Corners of Detections, and their correlation (n, 2, 8).

    Detections are rows (frame, camera name, Detection).
    """
    sizes = [len(d.marker) for *_, d in detections]
    covariance = np.concatenate([d.covariance for *_, d in detections] or [np.zeros((0, 8, 8))])
    own = np.stack([covariance[:, 2 * c : 2 * c + 2, 2 * c : 2 * c + 2] for c in range(4)], axis=1).reshape(-1, 2, 2)
    names = [name for (_, name, _), size in zip(detections, sizes) for _ in range(4 * size)]
    marker = np.concatenate([d.marker for *_, d in detections] or [np.zeros(0, int)])
    uv = np.concatenate([d.corners for *_, d in detections] or [np.zeros((0, 4, 2))]).reshape(-1, 2)
    frame = np.repeat(np.array([number for number, *_ in detections], int), 4 * np.array(sizes, int))
    return (
        Corners(frame, names, np.repeat(marker, 4), np.tile(np.arange(4), len(marker)), uv, own),
        correlations_of_whitened_marker_corners(covariance).reshape(-1, 2, 8),
    )


def group_corners_by_image(corners: Corners) -> dict[tuple[int, str], tuple[Integers, Floats]]:
    """Corners grouped by image.

    Returns {(frame number, camera name): (identities (m,), corners (m, 4, 2) px)}
    """
    rows: dict[tuple[int, str], list[int]] = {}
    for k, image in enumerate(zip(corners.frame[::4].tolist(), corners.camera[::4])):
        rows.setdefault(image, []).append(k)
    return {image: (corners.marker[::4][own], corners.uv.reshape(-1, 4, 2)[own]) for image, own in rows.items()}


def _joined(a: Corners, b: Corners) -> Corners:
    return Corners(
        np.r_[a.frame, b.frame],
        a.camera + b.camera,
        np.r_[a.marker, b.marker],
        np.r_[a.corner, b.corner],
        np.concatenate([a.uv, b.uv]),
        np.concatenate([a.covariance, b.covariance]),
    )


def _by_camera(rows: Sequence[Found], what: str) -> dict[str, Floats]:
    names = list(dict.fromkeys(name for _, name, _ in rows))
    return {name: np.concatenate([getattr(d, what) for _, other, d in rows if other == name]) for name in names}
