"""Values of rig.toml that no camera or machine has: degrees for radians, wrong matrices, lenses or limits."""

from collections.abc import Iterator

import numpy as np

from rig.checks.mistake_report import Mistake
from rig.formats.json_tree import Json
from rig.model.design import Camera, Design
from rig.model.mechanism_geometry import Arm
from rig.model.mechanism_kinds import has_links

TURN = 2.2 * np.pi  # rad; nobody writes a rotation vector that is longer
WIDE = (0.15, 20.0)  # focal length in image widths that lenses have
SQUARE = 0.15  # share by which pixels may differ from square
CENTRE = 0.2  # share of the image by which the principal point may be off its middle
SLIP = 0.06  # likewise, where exchanging cx and cy brings it to the middle
MIDDLE = 0.03  # likewise, of one that is in the middle
TANGENTIAL = 0.03


def implausible_values(design: Design) -> Iterator[Mistake]:
    """Mistakes of implausible values in a Design: camera matrices, lenses, an arm's rows and limits."""
    if has_links(design.mechanism):
        yield from _arm(design.mechanism)
    for camera in design.cameras:
        yield from _matrix(camera)
        yield from _lens(camera)


def overlong_rotation_vectors(tree: Json) -> Iterator[Mistake]:
    """Mistakes of overlong rotation vectors (beyond one turn, so in degrees) in the tree of a rig.toml."""
    found = []
    for kind in ("camera", "target"):
        for entry in tree.get(kind, []):
            for part in [entry, *(entry["marker"] if isinstance(entry.get("marker"), list) else [])]:
                rotvec = part.get("pose", {}).get("rotvec")
                if rotvec is not None and np.linalg.norm(rotvec) > TURN:
                    found.append((f"{kind} {entry.get('name')}", float(np.linalg.norm(rotvec))))
    home = tree.get("mechanism", {}).get("home", {}).get("rotvec")
    if home is not None and np.linalg.norm(home) > TURN:
        found.append(("mechanism.home", float(np.linalg.norm(home))))
    if found:
        name, length = found[0]
        others = f", and of {len(found) - 1} more" if len(found) > 1 else ""
        yield Mistake(
            f"rig.toml: rotations are in degrees: rotvec of {name} is {length:.4g} long{others}",
            "State every rotvec in radians: axis times angle",
            True,
            0.9,
        )


def _matrix(camera: Camera) -> Iterator[Mistake]:
    (fx, _, cx), (_, fy, cy), _ = camera.matrix
    w, h, name = camera.width, camera.height, f"rig.toml: camera {camera.name}"
    aside = abs(cx / w - 0.5), abs(cy / h - 0.5)
    off, turned = max(aside), max(abs(cy / w - 0.5), abs(cx / h - 0.5))
    if min(aside) < MIDDLE and off > SLIP and abs(np.log(fx / fy)) <= SQUARE:
        which, other = (
            ("width", f"{2 * cx + 1:.0f} x {h}") if aside[0] > MIDDLE else ("height", f"{w} x {2 * cy + 1:.0f}")
        )
        yield Mistake(
            f"{name}: {which} is of another image size than the matrix: the principal point ({cx:g}, {cy:g}) "
            f"is the middle of {other} px, "
            f"not of {w} x {h}",
            "State width, height and matrix of the same images; of images cropped to one side all is well",
            False,
            0.85,
        )
        return
    if off <= CENTRE and not (off > SLIP and turned < off / 4) and abs(np.log(fx / fy)) <= SQUARE:
        if not WIDE[0] < fx / w < WIDE[1]:
            yield Mistake(
                f"{name}: a focal length of {fx:g} px is implausible for an image of {w} px (in millimetres, "
                "or another image's?)",
                "State the matrix in pixels of the images that are used",
                True,
                0.8,
            )
        return
    if turned < min(off, 0.1) and w != h:
        exchanged = "cx and cy are exchanged" if abs(np.log(fx / fy)) <= SQUARE else "width and height are exchanged"
        yield Mistake(
            f"{name}: {exchanged}, or width and height are: the principal point ({cx:g}, {cy:g}) lies far "
            "from the middle of "
            f"{w} x {h} px",
            "Write matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] and width, height of its images",
            True,
            0.85,
        )
    elif max(abs(fx / w - 0.5), abs(fy / h - 0.5)) < 0.1 and off > CENTRE:
        yield Mistake(
            f"{name}: fx, fy and cx, cy are exchanged: ({fx:g}, {fy:g}) is the middle of the image, ({cx:g}, "
            f"{cy:g}) is not",
            "Write matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
            True,
            0.9,
        )
    elif abs(cx / w / (cy / h) - 1) < 0.2:
        yield Mistake(
            f"{name}: width and height are of another image size than the matrix: the principal point "
            f"({cx:g}, {cy:g}) is {cx / w * 2:.3g} "
            f"times as far out as the middle of {w} x {h} px",
            "Scale the matrix with the images, or state the images' width and height",
            True,
            0.85,
        )
    else:
        yield Mistake(
            f"{name}: the matrix is in another order: f ({fx:g}, {fy:g}), principal point ({cx:g}, {cy:g}) "
            f"of {w} x {h} px",
            "Write matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
            True,
            0.8,
        )


def _lens(camera: Camera) -> Iterator[Mistake]:
    d = camera.distortion
    if np.abs(d[2:4]).max() > TANGENTIAL:
        yield Mistake(
            f"rig.toml: camera {camera.name}: distortion is in another order: p1, p2 (the third and fourth) "
            f"are ({d[2]:g}, {d[3]:g}), and "
            "no lens has such",
            "Write k1, k2, p1, p2, k3 (OpenCV's order; others put k3 before p1)",
            True,
            0.7,
        )


def _arm(arm: Arm) -> Iterator[Mistake]:
    rows = arm.rows
    if np.abs(rows[:, [0, 3]]).max() > TURN:
        yield Mistake(
            "rig.toml: angles of mechanism.joints are in degrees: theta or alpha is "
            f"{np.abs(rows[:, [0, 3]]).max():.4g}",
            "State theta and alpha in radians",
            True,
            0.95,
        )
    widest = np.abs(arm.limits[~arm.slides]).max(initial=0.0)
    if widest > 12 * np.pi:
        yield Mistake(f"rig.toml: mechanism.limits are in degrees: {widest:.4g}", "State limits in radians", False, 0.9)
