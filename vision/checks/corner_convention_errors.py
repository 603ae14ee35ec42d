"""What corners may be: u and v exchanged, mirrored, of another size of image, their order or their numbers another."""

from collections.abc import Iterator

import numpy as np

from vision.checks.trial_measurement import Seen

Candidate = tuple[str, str, Seen]
ORDERS = {
    (3, 2, 1, 0): "run counter-clockwise from the bottom left",
    (0, 3, 2, 1): "run counter-clockwise",
    (1, 0, 3, 2): "run counter-clockwise from the top right",
    (2, 1, 0, 3): "run counter-clockwise from the bottom right",
    (1, 2, 3, 0): "begin one corner on (top right)",
    (2, 3, 0, 1): "begin at the opposite corner",
    (3, 0, 1, 2): "begin one corner back (bottom left)",
    (0, 1, 3, 2): "are in rows (0 1 over 2 3), not around",
}


def corner_mistake_trials(seen: Seen) -> Iterator[Candidate]:
    """(what, what to do, Seen with it undone) of mistakes in corners, all cameras alike; and in identities."""
    yield from _of(seen, [("", np.ones(len(seen.corners.frame), bool))])
    c = seen.corners
    ids = sorted(number for target in seen.design.targets for number in target.ids)
    for by in (1, -1):
        moved = c.marker + by
        if np.isin(moved, ids).mean() > 0.7:
            yield (
                f"corners.csv: marker ids are off by one ({'too small' if by > 0 else 'too large'}): they "
                f"count from {min(ids) - by} where "
                f"rig.toml counts from {min(ids)}",
                f"{'Add' if by > 0 else 'Subtract'} 1, or state the ids that are printed",
                seen.with_corners(marker=moved),
            )


def single_camera_trials(seen: Seen) -> Iterator[Candidate]:
    """The same, of one camera at a time."""
    names = np.array(seen.corners.camera)
    if len(seen.design.cameras) > 1:
        yield from _of(seen, [(f" of camera {camera.name}", names == camera.name) for camera in seen.design.cameras])


def _of(seen: Seen, parts: list[tuple[str, np.ndarray]]) -> Iterator[Candidate]:
    """Mistakes in parts of the corners. parts : (how they are called, (n,) bool)"""
    c = seen.corners
    size = {camera.name: np.array([camera.width, camera.height], float) for camera in seen.design.cameras}
    wide = np.array([size[name] for name in c.camera])
    for who, rows in parts:
        if not rows.any():
            continue

        def put(uv: np.ndarray, rows: np.ndarray = rows) -> Seen:
            return seen.with_corners(uv=np.where(rows[:, None], uv, c.uv))

        yield f"corners.csv: u and v{who} are exchanged", "u runs to the right, v down", put(c.uv[:, ::-1])
        yield (
            f"corners.csv: images{who} are mirrored left to right (flipped)",
            "Read the corners from images as the camera gives them",
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
