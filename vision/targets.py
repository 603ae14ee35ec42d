"""Targets of a rig: the place of each marker's corners on its body, from cubes and listed markers."""

from dataclasses import dataclass, field
from functools import cache

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import FACES, Design, Marker, Target
from rig.model.pose import transform_points

_OUT = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
SQUARE = np.array(
    [[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]]
)  # corners 0..3, clockwise from the top left
NORMAL = np.array([0.0, 0.0, 1.0])  # out of the paper


@dataclass(frozen=True, slots=True, eq=False)
class MarkerMap:
    """All markers of a rig, one row each.

    id : (m,), as printed; on_platform : (m,) bool, on what moves: the platform, or a stage of a chain below it;
        stage : (m,) number (from 1) of
    that stage, 0 for the base's and the platform's own; T_body_marker : RigidTransform (m,); side, margin : (m,) m;
    dictionary, target : m names
    shift : (m,) added to an identity where the same print is another row, as that of a cube that was put back turned; 0
        for all by default
    heights : (m, 4) m by which the corners stand off the marker's plane, along its normal; (1, 4) zeros by default
    corners : (m, 4, 3) m, body frame, corner 0 the marker's own top left, then clockwise; they follow from pose, side
        and heights
    """

    id: Integers
    on_platform: Booleans
    T_body_marker: RigidTransform
    side: Floats
    margin: Floats
    dictionary: list[str]
    target: list[str]
    stage: Floats
    shift: Floats = field(default_factory=lambda: np.zeros(1, int))
    heights: Floats = field(default_factory=lambda: np.zeros((1, 4)))
    corners: Floats = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners", transform_points(self.T_body_marker, self.in_marker))

    @property
    def in_marker(self) -> Floats:
        """(m, 4, 3) m, the corners in each marker's frame."""
        return self.side[:, None, None] * SQUARE + self.heights[..., None] * NORMAL

    @property
    def key(self) -> Floats:
        """(m,) of each row, no two equal: its identity, shifted."""
        return self.id + self.shift

    def rows(self, keys: Integers) -> Integers:
        """Row of each key (n,) -> (n,); -1 for one that no target has."""
        own = self.key
        order = np.argsort(own)
        at = np.minimum(np.searchsorted(own[order], keys), len(order) - 1)
        return np.where(own[order][at] == keys, order[at], -1)


def markers_of_target(target: Target) -> tuple[Marker, ...]:
    """Markers of a target: its listed ones, or those on a cube's faces.
    On faces they are centred, top to +z on the sides and to +y on +z and -z.

    Raises ValueError for a target that lists neither faces nor markers.
    """
    if target.listed:
        return target.listed
    edge, side = target.edge, target.marker
    if edge is None or side is None:
        raise ValueError(
            f"expected a target that lists markers or a cube with edge and marker, got {target.name!r} with "
            f"{edge} and {side}"
        )
    seat = target.seat
    return tuple(Marker(number, side, seat * face_pose(face, edge), (edge - side) / 2) for face, number in target.faces)


def face_pose(face: str, edge: float) -> RigidTransform:
    """Pose T_cube_marker of a face ("+x" .. "-z") on a cube of that edge (m): x right, y up, z out.

    Raises ValueError for a face that there is not.
    """
    if face not in FACES:
        raise ValueError(f"expected a face out of {FACES}, got {face!r}")
    out = np.array(_OUT[face], float)
    up = np.array([0, 1, 0] if face[1] == "z" else [0, 0, 1], float)
    rotation = Rotation.from_matrix(np.stack([np.cross(up, out), up, out], axis=-1))
    return RigidTransform.from_components(out * edge / 2, rotation)


def marker_map(design: Design) -> MarkerMap:
    """MarkerMap of all markers of a Design.
    Raises ValueError for a design without targets.
    """
    rows = [(marker, target) for target in design.targets for marker in markers_of_target(target)]
    if not rows:
        raise ValueError(f"design {design.name!r} has no targets")
    return MarkerMap(
        id=np.array([marker.id for marker, _ in rows]),
        on_platform=np.array([target.body != "base" for _, target in rows]),
        T_body_marker=RigidTransform.concatenate([marker.pose for marker, _ in rows]),
        side=np.array([marker.side for marker, _ in rows]),
        margin=np.array([marker.margin for marker, _ in rows]),
        dictionary=[target.dictionary for _, target in rows],
        target=[target.name for _, target in rows],
        stage=np.array([target.stage for _, target in rows]),
        shift=np.array([target.shift for _, target in rows]),
    )


@cache
def marker_cells(dictionary_name: str, number: int) -> Floats:
    """(n + 4, n + 4) cells of a marker of a dictionary, 1 white, with black border and white ring."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary_name))
    bits = cv2.aruco.generateImageMarker(dictionary, number, dictionary.markerSize + 2) > 127
    return np.pad(bits, 1, constant_values=True).astype(np.float64)
