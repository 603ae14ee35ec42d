"""Corner refit with the adjusted lenses.

Of all markers, where these lenses bend markers otherwise.

A marker is fitted as a whole, its sides bent as the lens bends them: a lens as its owner states it, a thousandth off,
moves the corners of a large marker by some thousandths of a pixel, the same in every image where it stands there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rig.compute.parallel_map_and_dask_cluster import path_on_workers
from rig.model.design import Camera
from rig.recording.exposures_and_image_files import read_image
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Corners
from vision.corners import local_lens
from vision.corners.edge_spread_function import PLAIN_EDGE_SPREAD
from vision.corners.marker_detection_and_corner_fit import (
    Detection,
    ReadMarkers,
    fit_read_markers,
    grey_image_at_full_depth,
)
from vision.predict import MarkerMap
from vision.reading.parallel_image_map_and_marker_rendering import map_images_in_processes
from vision.reading.recording_corners import Collected, corners_from_detections, group_corners_by_image

SETTLED = 2e-3  # px, by which a lens may bend a marker otherwise than another: that moves corners by a tenth of it
ROUNDS = 3  # of placing and measuring; a round leaves a few hundredths of what the one before was off by
STRAIGHT = 3  # of a polynomial's terms: where a marker is, and how it is stretched, its corners have anyway


def largest_lens_difference(corners: Corners, fitted_with: Mapping[str, Camera], cameras: Sequence[Camera]) -> float:
    """Largest difference, px, that two lenses make to a marker.

    The lenses fitted with and the adjusted ones.
    corners : all four of every marker
    """
    most, names, centres = (
        0.0,
        np.array(corners.camera)[::4],
        local_lens.local_coordinate_origins_and_scales(corners.uv.reshape(-1, 4, 2)),
    )
    for camera in cameras:
        own = centres[names == camera.name]
        if len(own):
            bent = np.empty((2, len(own), 2, local_lens.TERMS))
            for k, one in enumerate((fitted_with[camera.name], camera)):
                local_lens.fit_local_polynomials(local_lens.ideal_coordinate_table(one), own, bent[k])
            apart = np.abs(bent[1] - bent[0])[..., STRAIGHT:].sum(axis=-1) * own[:, 2:]
            most = max(most, float(np.nanmax(apart)))
    return most


def refit_corners(
    recording: Recording,
    collected: Collected,
    adjusted_cameras: Sequence[Camera],
    marker_map: MarkerMap,
    progress: Callable[[int, int], None] | None = None,
) -> Collected:
    """Corners of all markers refitted with the adjusted cameras.

    Returns Collected
    Raises FileError naming the image that cannot be decoded
    """
    lenses, seen = {camera.name: camera for camera in adjusted_cameras}, group_corners_by_image(collected.corners)
    images = [
        (int(frame), camera, name, ReadMarkers(*seen[int(frame), camera]))
        for frame, camera, name in zip(recording.exposures.frame, recording.exposures.camera, recording.exposures.image)
        if name and (int(frame), camera) in seen
    ]
    folder, spread = path_on_workers(recording.folder), collected.spread

    def one(image: tuple[int, str, str, ReadMarkers]) -> Detection:
        _, camera, name, read = image
        return fit_read_markers(
            grey_image_at_full_depth(read_image(folder / name)),
            lenses[camera],
            marker_map,
            read,
            spread.get(camera, PLAIN_EDGE_SPREAD),
            search_distance=0.0,
        )

    found = map_images_in_processes(one, images, progress)
    corners, correlation = corners_from_detections(
        [(frame, camera, d) for (frame, camera, *_), d in zip(images, found)]
    )
    return replace(collected, corners=corners, correlation=correlation, cameras=lenses)
