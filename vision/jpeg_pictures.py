"""Images made small enough for a page: JPEG, no wider than a page shows them."""

import cv2
import numpy as np

from rig.recording.exposures_and_images import read_image
from rig.recording.recording_folder import Recording
from vision.corners.marker_detection import grey_image

WIDTH = 960  # px, of images on a page at most
QUALITY = 80


def encode_jpeg(image: np.ndarray) -> bytes:
    """JPEG of an image (height, width) or (height, width, 3) as cameras give it, no wider than a page needs."""
    eight = grey_image(image)[0]
    if eight.shape[1] > WIDTH:
        eight = cv2.resize(eight, (WIDTH, round(eight.shape[0] * WIDTH / eight.shape[1])), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


def frame_jpegs(recording: Recording, frame: int) -> dict[str, bytes]:
    """{camera name: JPEG} of a frame of a recording; empty where it has no images. Raises FileError for one that cannot
    be read.
    """
    e = recording.exposures
    rows = [k for k in np.flatnonzero(e.frame == frame) if e.image[k]]
    return {e.camera[k]: encode_jpeg(read_image(recording.folder / e.image[k])) for k in rows}
