"""Meshes of a rig.

By trimesh: plates, struts, cubes and sheets with markers, and a background.

Every part is a flat grey, a sheet of paper with a marker's ink on it, or a textured face; brightness comes from the
lamps by Lambert's law, face by face, so that the renderer need only multiply. Ink is no texture: it is laid exactly,
see synthetic/marker_drawing_sensor_and_occlusion.py.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.model.design import FACES, Design, Target, face_pose
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, Struts, has_struts
from vision.marker_corner_prediction import MarkerMap, marker_cells, marker_map

WHITE, BLACK, METAL, DARK = 0.85, 0.06, 0.35, 0.12  # albedo
STRUT_RADIUS, ROD_RADIUS = 0.055, 0.03  # of the base's radius
SHARE = 0.55  # of a strut's length that is its thick part
PLATE = 0.012  # m thick


@dataclass(frozen=True, slots=True, eq=False)
class Ink:
    """A marker printed on a sheet. cells : (n, n) 1 white, 0 black, its border among them
    to_body : (4, 3), cells (X, Y, 1) to the body's frame (x, y, z, 1), m"""

    cells: Floats
    to_body: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One mesh of one grey.

    body : "base", "platform", "strut 1 lower" .. "strut 6 upper", of a chain "stage 1", "stage 2 strut 1 lower" .., or
        "world"
    mesh : trimesh in the body's frame, m
    normal : (3,) of a flat part, for its lighting, or None for a round one; centre : (3,) m; albedo : 0..1
    texture : (h, w) float 0..1 that multiplies the albedo, or None; uv : (vertices, 2) texture coordinates; ink : Ink,
        or None
    """

    body: str
    mesh: trimesh.Trimesh
    normal: Floats | None
    centre: Floats
    albedo: float
    texture: Floats | None = None
    uv: Floats | None = None
    ink: Ink | None = None


@dataclass(frozen=True, slots=True)
class Lamp:
    """A point lamp at position (3,) m in the base frame; intensity : what a white face square to it at 1 m shines
    with.
    """

    position: tuple[float, float, float]
    intensity: float


LAMPS = (Lamp((0.6, 0.4, 1.6), 1.3), Lamp((-0.9, -0.3, 1.3), 0.6))
AMBIENT = 0.25


def rig_and_background_meshes(
    design: Design, background: str = "plain", rng: np.random.Generator | None = None, markers: MarkerMap | None = None
) -> list[Part]:
    """Parts (meshes) of a rig and of its background.

    The background is plain or cluttered.
    markers : MarkerMap of where and how large the markers really are, by default as the design has them
    """
    found = []
    for stands in stages_standing_on_struts(design.mechanism):
        if stands.stage.plates is not None:
            for body, joints in zip((stands.base, stands.platform), stands.stage.plates):
                found += _plate(body, joints, design)
        found += _struts(stands)
    placed = markers if markers is not None else marker_map(design)
    carriers = {target.name: target.body for target in design.targets}
    for target in design.targets:
        found += _blank_faces(target) + _black_squares(target)
    for k in range(len(placed.id)):
        found.append(
            _marker_face(
                carriers[placed.target[k]],
                placed.dictionary[k],
                int(placed.id[k]),
                placed.T_body_marker[k],
                placed.side[k],
                placed.side[k] + 2 * placed.margin[k],
            )
        )
    return found + _surroundings(design, background, rng)


class StrutStage(NamedTuple):
    """What stands on struts, by itself or as a chain's stage. stage; prefix : of its struts' names; base,
    platform : names of the bodies between which they stand; number : of what moves, as `mesh_body_matrices` is told
        where that is."""

    stage: Struts
    prefix: str
    base: str
    platform: str
    number: int


def stages_standing_on_struts(mechanism: Mechanism) -> list[StrutStage]:
    """Stages of a mechanism that stand on struts ([StrutStage]), from the base up.

    None for an arm.
    """
    stages, alone = mechanism.stages, not mechanism.bodies
    names = ["base", *(f"stage {k + 1}" for k in range(len(stages) - 1)), "platform"]
    return [
        StrutStage(stage, "" if alone else f"stage {k + 1} ", names[k], names[k + 1], k)
        for k, stage in enumerate(stages)
        if has_struts(stage)
    ]


def base_and_stage_body_matrices(stage_poses: list[RigidTransform]) -> dict[str, Floats]:
    """Matrices {body: (..., 4, 4)} to the base of base, platform and stages, from the stages' poses."""
    *below, platform = (T.as_matrix() for T in stage_poses)
    return {
        "base": np.broadcast_to(np.eye(4), platform.shape),
        "platform": platform,
        **{f"stage {k + 1}": T for k, T in enumerate(below)},
    }


def mesh_body_matrices(mechanism: Mechanism, stage_poses: list[RigidTransform]) -> dict[str, Floats]:
    """Matrices {body: (4, 4)} to the base of all bodies that have meshes, at one pose, struts included."""
    poses = {"world": np.eye(4), **base_and_stage_body_matrices(stage_poses)}
    for stands in stages_standing_on_struts(mechanism):
        T_below = RigidTransform.from_matrix(poses[stands.base])
        ends = strut_ends(stands.stage, T_below.inv() * stage_poses[stands.number])
        for i, (low, high) in enumerate(zip(*(T_below.apply(end) for end in ends))):
            along = (high - low) / np.linalg.norm(high - low)
            side = np.cross(along, [1.0, 0, 0] if abs(along[0]) < 0.9 else [0, 1.0, 0])
            side /= np.linalg.norm(side)
            frame = np.eye(4)
            frame[:3, :3] = np.stack([side, np.cross(along, side), along], axis=1)
            for name, at, scale in (("lower", low, SHARE), ("upper", high, -SHARE)):
                matrix = frame.copy()
                matrix[:3, 3] = at
                matrix[:3, 2] *= scale * np.linalg.norm(high - low)
                if scale < 0:
                    matrix[:3, 1] *= -1  # keeps the handedness
                poses[f"{stands.prefix}strut {i + 1} {name}"] = matrix
    return poses


def part_brightness(part: Part, matrix: Floats) -> float:
    """Brightness 0..1 of a part at its body's matrix (4, 4).

    Albedo times the light of the lamps.
    """
    centre = matrix[:3, :3] @ part.centre + matrix[:3, 3]
    light = AMBIENT
    for lamp in LAMPS:
        to_lamp = np.array(lamp.position) - centre
        distance = float(np.linalg.norm(to_lamp))
        facing = 0.5 if part.normal is None else max(0.0, float(matrix[:3, :3] @ part.normal @ to_lamp) / distance)
        light += lamp.intensity * facing / distance**2
    return float(min(1.0, part.albedo * min(light, 1.0 / WHITE)))


def plate_radius(body: str, joints: Floats, design: Design) -> float:
    """Radius, m, of the plate that carries a body's joints (6, 3) m and its cubes."""
    cubes = [
        float(np.linalg.norm(target.pose.translation[:2])) + 0.8 * target.edge
        for target in design.targets
        if target.body == body and target.edge and target.pose is not None
    ]
    return max([1.12 * float(np.linalg.norm(joints[:, :2], axis=1).max()), *cubes])


def _plate(body: str, joints: Floats, design: Design) -> list[Part]:
    """A disc just under the plane of joints."""
    disc = trimesh.creation.cylinder(radius=plate_radius(body, joints, design), height=PLATE, sections=96)
    disc.apply_translation([0, 0, joints[:, 2].mean() - PLATE / 2 - 0.002])
    return [Part(body, disc, np.array([0, 0, 1.0]), np.zeros(3), DARK)]


def strut_ends(mechanism: Struts, T_base_platform: RigidTransform) -> tuple[Floats, Floats]:
    """Ends (lower, upper) (..., axes, 3) m of the struts in the base frame at poses (...)."""
    matrix = T_base_platform.as_matrix()
    low, joints = mechanism.strut_joints
    high = joints @ np.swapaxes(matrix[..., :3, :3], -1, -2) + matrix[..., None, :3, 3]
    return np.broadcast_to(low, high.shape), high


def _struts(stands: StrutStage) -> list[Part]:
    radius = np.linalg.norm(stands.stage.base_joints, axis=1).mean()
    found = []
    for i in range(len(stands.stage.axes)):
        for name, width, grey in (("lower", STRUT_RADIUS, METAL), ("upper", ROD_RADIUS, 0.6)):
            rod = trimesh.creation.cylinder(radius=width * radius / 2, height=1.0, sections=24)
            rod.apply_translation([0, 0, 0.5])
            found.append(Part(f"{stands.prefix}strut {i + 1} {name}", rod, None, np.array([0, 0, 0.5]), grey))
    return found


def _blank_faces(target: Target) -> list[Part]:
    """The faces of a cube that carry no marker."""
    marked = dict(target.faces)
    return [
        _quad(target.body, target.seat * face_pose(face, target.edge), target.edge / 2, WHITE)
        for face in FACES
        if target.edge is not None and face not in marked
    ]


def _black_squares(target: Target) -> list[Part]:
    """The squares of a board's chessboard that carry no marker."""
    if target.board is None or target.T_body_board is None:
        return []
    middles = target.board.in_board_frame(target.board.black_squares())
    poses = [target.T_body_board * RigidTransform.from_translation(middle) for middle in middles]
    return [_quad(target.body, T, target.board.pitch / 2, BLACK) for T in poses]


def _marker_face(
    body: str, dictionary: str, number: int, T_body_marker: RigidTransform, side: float, size: float
) -> Part:
    """Part of a square white sheet of a size (m) with a marker of a side (m) in its middle; posed x right, y up, z
    out.
    """
    cells = marker_cells(dictionary, number)[1:-1, 1:-1]
    cell = side / len(cells)
    on_sheet = np.array([[cell, 0, -side / 2], [0, -cell, side / 2], [0, 0, 0], [0, 0, 1]])
    return _quad(
        body, T_body_marker, size / 2, WHITE, ink=Ink(np.ascontiguousarray(cells), T_body_marker.as_matrix() @ on_sheet)
    )


def _quad(
    body: str,
    T: RigidTransform,
    half: float,
    albedo: float,
    texture: Floats | None = None,
    uv: Floats | None = None,
    ink: Ink | None = None,
) -> Part:
    corners = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    mesh = trimesh.Trimesh(T.apply(corners), [[0, 3, 2], [0, 2, 1]], process=False)
    return Part(body, mesh, T.rotation.as_matrix()[:, 2], T.translation, albedo, texture, uv, ink)


def _surroundings(design: Design, background: str, rng: np.random.Generator | None) -> list[Part]:
    reach = 3.0 * max([0.5] + [float(np.linalg.norm(camera.pose.translation)) for camera in design.cameras])
    if background == "plain":
        room = trimesh.creation.icosphere(subdivisions=3, radius=reach)
        room.invert()
        return [Part("world", room, None, np.zeros(3), 0.28)]
    if background != "cluttered":
        raise ValueError(f"background is 'plain' or 'cluttered', not {background!r}")
    rng = np.random.default_rng(0) if rng is None else rng
    found = []
    for face in FACES:
        pose = RigidTransform.from_translation([0, 0, 0]) * face_pose(face, 2 * reach)
        quad = _quad("world", pose, reach, 0.9, _clutter_texture(rng), np.array([[0, 1], [1, 1], [1, 0], [0, 0.0]]))
        quad.mesh.invert()
        found.append(quad)
    return found


def _clutter_texture(rng: np.random.Generator, size: int = 1024) -> Floats:
    """(size, size) 0..1 picture of blobs, bars and squares, dark squares on white among them, that a detector must not
    believe.
    """
    picture = cv2.GaussianBlur(rng.random((size, size)).astype(np.float32), (0, 0), 30)
    picture = (picture - picture.min()) / np.ptp(picture) * 0.6
    for _ in range(160):
        x, y, w, h = rng.integers(0, size, 2).tolist() + rng.integers(6, 90, 2).tolist()
        angle, grey = float(rng.uniform(0, 180)), float(rng.random())
        box = cv2.boxPoints(((x, y), (w, h), angle)).astype(np.int32)
        cv2.fillPoly(picture, [box], grey, cv2.LINE_AA)
    return picture.astype(float)
