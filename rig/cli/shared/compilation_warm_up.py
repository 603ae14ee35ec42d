"""What is compiled, or loaded, with the first frame of a run, done while the struts home: the rig as stated is drawn,
measured, learnt from.
"""

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.online.run_learning import Learner
from rig.model import mechanisms
from rig.model.design import Camera, Design
from vision.corners.marker_detection import detect_markers
from vision.predict import expected
from vision.reading.live_measurement import Live
from vision.targets import MarkerMap, marker_cells, marker_map

GREY, BLACK, WHITE = 70, 20, 190  # of 255
CELL = 8  # px of a cell before it is drawn as it is seen


def warm_up(design: Design) -> None:
    """Measure one picture of a hexapod at home, learn from it, and forget it all."""
    m = design.mechanism
    if m.kind != "hexapod" or not design.cameras or not any(target.body == "platform" for target in design.targets):
        return
    markers, live = marker_map(design), Live(design)
    images = draw_markers(design.cameras, m.home, markers)
    live.take(0, images)
    live.close()
    for camera in design.cameras:
        detect_markers(images[camera.name], camera, markers, T_base_platform=m.home)
    learner, lengths = Learner(m), mechanisms.kinematics_of(m).inverse(m.home, m)
    for _ in range(2):  # the second is held against the first
        learner.learn(lengths, m.home, 1e-10 * np.eye(6))


def draw_markers(
    cameras: tuple[Camera, ...], T_base_platform: RigidTransform, markers: MarkerMap
) -> dict[str, np.ndarray]:
    """{camera: (height, width) uint8} of markers alone, nothing in front of anything."""
    return {camera.name: _picture(camera, T_base_platform, markers) for camera in cameras}


def _picture(camera: Camera, T_base_platform: RigidTransform, markers: MarkerMap) -> np.ndarray:
    image = np.full((camera.height, camera.width), GREY, np.uint8)
    for row, quad in zip(*expected(camera, T_base_platform, markers)):
        cells = np.kron(marker_cells(markers.dictionary[row], int(markers.id[row])), np.ones((CELL, CELL)))
        printed = (BLACK + (WHITE - BLACK) * cells).astype(np.uint8)
        low, high = CELL - 0.5, len(cells) - CELL - 0.5  # the marker has a ring of white about it
        square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
        H = cv2.getPerspectiveTransform(square, quad.astype(np.float32))
        seen = cv2.warpPerspective(printed, H, (camera.width, camera.height), flags=cv2.INTER_AREA)
        where = cv2.warpPerspective(np.full_like(printed, 255), H, (camera.width, camera.height))
        image[where > 127] = seen[where > 127]
    return cv2.GaussianBlur(image, (0, 0), 0.7)
