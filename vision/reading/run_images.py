"""Images of a run: markers drawn as cameras see them, the level of the markers' white, images saved as PNG."""

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_types import Pixels
from rig.driving.cameras import CameraError
from rig.driving.cameras.grab_and_settling import CLIPPED
from rig.errors import RigError
from rig.formats.output_files import write_bytes
from rig.model.design import Camera
from vision.corners.marker_detection import grey_images_for_reader_and_fit
from vision.corners.whole_image_marker_reader import read_markers
from vision.predict import markers_expected_in_image
from vision.targets import MarkerMap, marker_cells

GREY, BLACK, WHITE = 70, 20, 190  # of 255
CELL = 8  # px of a cell before it is drawn as it is seen
COMPRESSION = 1  # of the PNG files


def render_marker_images(
    cameras: tuple[Camera, ...], T_base_platform: RigidTransform, markers: MarkerMap
) -> dict[str, Pixels]:
    """Render images of the markers as each camera sees them: {camera: (height, width) uint8}, without occlusion."""
    return {camera.name: _picture(camera, T_base_platform, markers) for camera in cameras}


def _picture(camera: Camera, T_base_platform: RigidTransform, markers: MarkerMap) -> Pixels:
    image = np.full((camera.height, camera.width), GREY, np.uint8)
    for row, quad in zip(*markers_expected_in_image(camera, T_base_platform, markers)):
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
    """Save an image as PNG, complete before this returns. Raises FileError where the disk is full."""
    data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION])[1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path.parent} cannot be made: {error.strerror}") from None
    write_bytes(path, data.tobytes())


def marker_white_level(image: Pixels, camera: Camera, markers: MarkerMap) -> tuple[float, float]:
    """(level of white, of 255; share that clips) of the markers in an image; of the whole image where none is read.

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
