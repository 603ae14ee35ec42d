"""Parallel map over images, rendered images of markers, and the markers' white level.

By threads, processes or cluster; images are rendered as expected, and saved as PNG.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Pixels
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.compute.worker_processes import executor_map, worker_count
from rig.driving.cameras import CameraError
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import CLIPPED
from rig.errors import RigError
from rig.formats.output_files import write_bytes
from rig.model.design import Camera
from vision.corners.marker_detection_and_corner_fit import grey_images_for_reader_and_fit, read_markers
from vision.marker_corner_prediction import MarkerMap, expected_marker_rows_and_corners_in_image, marker_cells

EACH = 2  # images for each process, below which it is not worth starting any

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_images_in_threads(
    function: Callable[[Item], Result], items: Sequence[Item], progress: Callable[..., None] | None
) -> list[Result]:
    """Map a function over images in threads.

    Results are in order. It is for few items, or shared images.
    progress : called with (done, of)
    """
    with _one_thread_each(), ThreadPoolExecutor(worker_count()) as pool:
        return executor_map(pool, function, items, progress)


def map_images_in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], progress: Callable[..., None] | None
) -> list[Result]:
    """Map a function over images in processes.

    They may be on a cluster; results are in order.
    For many items.

    Each item reads an image of its own; what `function` changes elsewhere is lost.
    """

    def alone(item: Item) -> Result:
        cv2.setNumThreads(1)
        return function(item)

    with _one_thread_each():
        return parallel_map(alone, items, progress, items_per_process=EACH, on_cluster=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Within it OpenCV shares no image among threads: images are what is done at the same time."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


GREY, BLACK, WHITE = 70, 20, 190  # of 255
CELL = 8  # px of a cell before it is drawn as it is seen
COMPRESSION = 1  # of the PNG files


def render_marker_images(
    cameras: tuple[Camera, ...], T_base_platform: RigidTransform, markers: MarkerMap
) -> dict[str, Pixels]:
    """Render images of the markers as each camera sees them.

    There is no occlusion.
    Returns {camera: (height, width) uint8}
    """
    return {camera.name: _picture(camera, T_base_platform, markers) for camera in cameras}


def _picture(camera: Camera, T_base_platform: RigidTransform, markers: MarkerMap) -> Pixels:
    image = np.full((camera.height, camera.width), GREY, np.uint8)
    for row, quad in zip(*expected_marker_rows_and_corners_in_image(camera, T_base_platform, markers)):
        cells = np.kron(marker_cells(markers.dictionary[row], int(markers.id[row])), np.ones((CELL, CELL)))
        printed = (BLACK + (WHITE - BLACK) * cells).astype(np.uint8)
        low, high = CELL - 0.5, len(cells) - CELL - 0.5  # the marker has a ring of white about it
        square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
        H = cv2.getPerspectiveTransform(square, quad.astype(np.float32))
        seen = cv2.warpPerspective(printed, H, (camera.width, camera.height), flags=cv2.INTER_AREA)
        where = cv2.warpPerspective(np.full_like(printed, 255), H, (camera.width, camera.height))
        image[where > 127] = seen[where > 127]
    return cv2.GaussianBlur(image, (0, 0), 0.7)


def save_image(path: Path, image: Pixels) -> None:
    """Save an image as PNG.

    It is complete before this returns.
    Raises FileError where the disk is full.
    """
    data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION])[1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path.parent} cannot be created: {error.strerror}") from None
    write_bytes(path, data.tobytes())


def marker_white_level_and_clipped_share(image: Pixels, camera: Camera, markers: MarkerMap) -> tuple[float, float]:
    """White level of the markers in an image, and the share of their pixels that clips.

    Of the whole image where none is read.

    Returns (level of 255, share that clips)
    Raises CameraError for an image of another size.
    """
    eight, full = grey_images_for_reader_and_fit(image)
    if full.shape != (camera.height, camera.width):
        raise CameraError(
            f"camera {camera.name!r} gives {full.shape[1]} x {full.shape[0]} px, but rig.toml has "
            f"{camera.width} x {camera.height} px"
        )
    quads = read_markers(eight, markers).corners
    boxes = [
        full[max(int(low[1]), 0) : int(high[1]) + 1, max(int(low[0]), 0) : int(high[0]) + 1]
        for low, high in zip(quads.min(axis=1), quads.max(axis=1))
    ] or [full]
    bright = [np.percentile(box, 90) for box in boxes if box.size]
    return float(np.percentile(bright, 90)), float(np.mean([(box >= CLIPPED).mean() for box in boxes if box.size]))
