"""Trials of target mistakes in rig.toml.

Wrong size, exchanged or turned targets, wrong faces or pose.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats, Pixels
from rig.model.design import Camera, Target
from vision.checks.corner_and_lens_convention_trials import SampledRecording, Trial
from vision.marker_corner_prediction import SQUARE, marker_map

Candidate = tuple[str, str, SampledRecording]
PRINTED = 0.01  # a scale of the print beyond this is a mistake, below it a print_scale (its usual size ends at 0.005)
NAMED = 0.006  # share by which a ratio may differ from one that has a name
LEAST_CORNERS = 8  # of one marker, from which it is said to be elsewhere
EDGES = (-0.02, -0.01, -0.005, 0.005, 0.01, 0.02)  # m
PAIRS = 12  # pairs of markers in one image from which a scale is told
CONTENT = {"4X4": 4, "5X5": 5, "6X6": 6, "7X7": 7, "ORIGINAL": 5, "36h": 6, "25h": 5, "16h": 4}


def _cube_turns() -> list[Rotation]:
    """The 23 turns of a cube into itself, the least ones first."""
    turns = {
        tuple(np.round(R.as_matrix().ravel()).astype(int).tolist()): R
        for R in (
            Rotation.from_euler("zyx", [a, b, c], degrees=True)
            for a in (0, 90, 180, 270)
            for b in (0, 90, 180, 270)
            for c in (0, 90, 180, 270)
        )
    }
    return sorted((R for R in turns.values() if R.magnitude() > 0.1), key=lambda R: round(R.magnitude(), 6))


def _marker_scale_ratios(seen: SampledRecording) -> dict[str, tuple[float, int]]:
    """{body: (true over stated side of its markers, pairs that say so)}: distances between targets in one image against
    the stated ones.

    Each marker alone has its distance from the camera in units of its own side; how far two targets of one body are
    apart is stated.
    """
    markers = marker_map(seen.design)
    ratios: dict[str, list[float]] = {}
    c, cameras = seen.corners, {camera.name: camera for camera in seen.design.cameras}
    rows = markers.rows(c.marker)
    order = np.lexsort((c.corner, rows, np.array(c.camera), c.frame))
    order = order[rows[order] >= 0]
    images: dict[tuple[int, str], dict[int, list[int]]] = {}
    for i in order.tolist():
        images.setdefault((int(c.frame[i]), c.camera[i]), {}).setdefault(int(rows[i]), []).append(i)
    middles = markers.T_body_marker.translation
    for (_, name), seen_here in images.items():
        alone = {
            row: _alone(c.uv[own], cameras[name], float(markers.side[row]))
            for row, own in seen_here.items()
            if len(own) == 4
        }
        places = {row: place for row, place in alone.items() if place is not None}
        for a, b in combinations(places, 2):
            if markers.on_platform[a] == markers.on_platform[b] and markers.target[a] != markers.target[b]:
                apart = float(np.linalg.norm(places[a] - places[b]))
                ratios.setdefault("platform" if markers.on_platform[a] else "base", []).append(
                    float(np.linalg.norm(middles[a] - middles[b])) / max(apart, 1e-9)
                )
    return {body: (float(np.median(values)), len(values)) for body, values in ratios.items()}


def _alone(uv: Floats, camera: Camera, side: float) -> Pixels | None:
    """(3,) m, a marker's middle in its camera, from its four corners alone; None where they are no square's image."""
    found = cv2.solvePnPGeneric(
        side * SQUARE, np.ascontiguousarray(uv), camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    return found[2][0].ravel() if found[0] else None


def marker_size_trials(sample: SampledRecording) -> Iterator[tuple[str | None, float, SampledRecording]]:
    """Trials with other marker sizes.

    They are of all targets (None) or of one body.
    Returns (body, ratio, Seen)
    """
    ratios = {body: share for body, (share, pairs) in _marker_scale_ratios(sample).items() if pairs >= PAIRS}
    firsts = sorted({round(share, 3) for share in ratios.values() if abs(share - 1) > PRINTED / 2})
    for first in firsts:
        for share in first * np.array([1.0, 0.99, 1.01]):
            yield None, float(share), scale_marker_sides(sample, float(share))
    for body, share in ratios.items() if len(ratios) > 1 and firsts else ():
        yield body, share, scale_marker_sides(sample, share, body)


def _named(target: Target) -> dict[str, float]:
    """{what was stated as the side, true over stated} of measures that are taken for a marker's side."""
    n = next((bits for word, bits in CONTENT.items() if word in target.dictionary), 5)
    out = {
        "the black border is not counted (the inner, coded part was measured)": (n + 2) / n,
        "the white margin (quiet zone) is counted": (n + 2) / (n + 4),
        "half a side is stated": 2.0,
        "twice the side is stated": 0.5,
    }
    return out


def scale_marker_sides(sample: SampledRecording, factor: float, body: str | None = None) -> SampledRecording:
    """Scale the marker sides of a frame sample by a factor, of all targets or of one body's."""
    return sample.with_targets(
        tuple(t if body not in (None, t.body) else _resized(t, factor) for t in sample.design.targets)
    )


def _resized(target: Target, factor: float) -> Target:
    if target.listed or target.marker is None:
        return replace(target, listed=tuple(replace(m, side=m.side * factor) for m in target.listed))
    return replace(target, marker=target.marker * factor)


def marker_size_ratio_text(size_ratio: float, target: Target | None) -> str:
    """Text of a ratio of true to stated marker size."""
    off = (
        f"the markers are printed {abs(size_ratio - 1):.1%} {'larger' if size_ratio > 1 else 'smaller'} than rig.toml "
        "states (scale of print)"
    )
    if target is None:
        return off
    edge, side = target.edge or 0.0, target.marker or 0.0
    for what, ratio in _named(target).items() if not edge or side < 0.99 * edge else ():
        if abs(size_ratio / ratio - 1) < max(NAMED, 0.15 * abs(ratio - 1)) and abs(ratio - 1) > 2 * PRINTED:
            return f"marker side: {what}: the markers are {size_ratio:.3f} times what rig.toml states"
    if edge and abs(side / edge - 1) < 0.01 and size_ratio < 0.97:
        return (
            f"marker side: the cubes' edge is stated as the markers' side: the markers are {size_ratio:.3f} times that"
        )
    for unit, ratio in (("inches", 0.0254), ("centimetres", 0.01), ("millimetres", 0.001)):
        if abs(size_ratio / ratio - 1) < 0.05:
            return f"marker sides are in {unit}"
    return off


def best_marker_size_ratio(
    sample: SampledRecording, ratio: float, body: str | None, misfit: Callable[[SampledRecording], float]
) -> float:
    """Best size ratio near one.

    It has the least misfit (px), at the vertex of a parabola through three trials.
    """
    by = 0.004
    squares = [misfit(scale_marker_sides(sample, ratio * (1 + k * by), body)) ** 2 for k in (-1, 0, 1)]
    bend = squares[0] - 2 * squares[1] + squares[2]
    return ratio * (1 + by * float(np.clip((squares[0] - squares[2]) / (2 * bend), -4, 4))) if bend > 0 else ratio


def exchanged_or_moved_target_trials(sample: SampledRecording, names: list[str] | None = None) -> Iterator[Candidate]:
    """Trials with targets exchanged or moved.

    They are moved to the other body.
    Of all targets, bodies and poses too. names : those meant, all by default
    """
    targets = sample.design.targets
    meant = [i for i, t in enumerate(targets) if names is None or t.name in names]
    for i, k in combinations(meant, 2):
        a, b = targets[i], targets[k]
        if a.faces and b.faces and len(a.faces) == len(b.faces):
            swapped = list(targets)
            swapped[i], swapped[k] = (
                replace(a, faces=b.faces, dictionary=b.dictionary),
                replace(b, faces=a.faces, dictionary=a.dictionary),
            )
            yield (
                f"rig.toml: cubes {a.name} and {b.name} are exchanged",
                "Exchange the cubes, or their faces in rig.toml",
                sample.with_targets(tuple(swapped)),
            )
        elif a.listed and b.listed and len(a.listed) == len(b.listed):
            swapped = list(targets)
            swapped[i] = replace(a, listed=tuple(replace(m, id=n.id) for m, n in zip(a.listed, b.listed)))
            swapped[k] = replace(b, listed=tuple(replace(m, id=n.id) for m, n in zip(b.listed, a.listed)))
            yield (
                f"rig.toml: targets {a.name} and {b.name} are exchanged",
                "Exchange them, or their ids in rig.toml",
                sample.with_targets(tuple(swapped)),
            )
    other = {"base": "platform", "platform": "base"}
    for i in meant:
        t = targets[i]
        yield (
            f"rig.toml: target {t.name} stands on the {other[t.body]}, not on the {t.body}",
            "Correct its body",
            sample.with_targets((*targets[:i], replace(t, body=other[t.body]), *targets[i + 1 :])),
        )
    if names is not None:
        return
    yield (
        "rig.toml: body of all targets is exchanged (base for platform)",
        "Exchange body",
        sample.with_targets(tuple(replace(t, body=other[t.body]) for t in targets)),
    )
    for what, change in _POSES:
        if all(t.pose is not None for t in targets):
            yield (
                f"rig.toml: the targets' poses: {what}",
                "State cube in body: m, rotation vector in rad",
                sample.with_targets(tuple(replace(t, pose=change(t.pose)) for t in targets)),
            )


def single_target_trials(sample: SampledRecording, name: str) -> Iterator[Candidate]:
    """Trials with a single target changed.

    Turned, faces renamed, another pose convention, another size.
    """
    targets = sample.design.targets
    i = [t.name for t in targets].index(name)
    t = targets[i]

    def put(other: Target) -> SampledRecording:
        return sample.with_targets((*targets[:i], other, *targets[i + 1 :]))

    if t.pose is not None:
        for R in _cube_turns():
            axis, angle = R.as_rotvec(), np.degrees(R.magnitude())
            about = np.round(axis / np.linalg.norm(axis), 2)
            plain = next(
                (f"{'-' if about[k] < 0 else ''}{'xyz'[k]}" for k in range(3) if abs(about[k]) > 0.99),
                str(about.tolist()),
            )
            yield (
                f"rig.toml: cube {name} is turned by {angle:.0f} degrees about its {plain}",
                "Turn the cube, or its pose or faces in rig.toml",
                put(replace(t, pose=t.pose * RigidTransform.from_rotation(R))),
            )
        for what, change in _POSES:
            yield (
                f"rig.toml: pose of target {name}: {what}",
                "State cube in body: m, rotation vector in rad",
                put(replace(t, pose=change(t.pose))),
            )
    for by in (1, -1):
        if t.faces:
            yield (
                f"rig.toml: ids of cube {name} are off by one",
                "State the ids that are printed",
                put(replace(t, faces=tuple((face, max(number + by, 0)) for face, number in t.faces))),
            )


def turned_face_trials(sample: SampledRecording, name: str) -> Iterator[Candidate]:
    """Trials with one face of a cube turned."""
    target = next(t for t in sample.design.targets if t.name == name)
    for face, number in target.faces:
        mine = sample.corners.marker == number
        if not mine.any():
            continue
        for quarters in (2, 1, 3):
            yield (
                f"rig.toml: face {face} of cube {name} (marker {number}) is turned by {90 * quarters} degrees",
                "Turn the sheet on that face, or remove its marker from rig.toml",
                sample.with_corners(
                    corner=np.where(mine, (sample.corners.corner + quarters) % 4, sample.corners.corner)
                ),
            )


def exchanged_face_trials(sample: SampledRecording, name: str) -> Iterator[Candidate]:
    """Trials with two faces of one cube exchanged."""
    targets = sample.design.targets
    i = [t.name for t in targets].index(name)
    t = targets[i]
    for a, b in combinations(range(len(t.faces)), 2):
        swapped = list(t.faces)
        swapped[a], swapped[b] = (t.faces[a][0], t.faces[b][1]), (t.faces[b][0], t.faces[a][1])
        yield (
            f"rig.toml: faces {t.faces[a][0]} and {t.faces[b][0]} of cube {name} are exchanged",
            "Exchange them",
            sample.with_targets((*targets[:i], replace(t, faces=tuple(swapped)), *targets[i + 1 :])),
        )


def is_only_face_exchange_within_one_cube(stated: SampledRecording, corrected: SampledRecording) -> bool:
    """Whether a correction only exchanges faces within one cube.

    Each command corrects that by itself.
    """
    if corrected.corners is not stated.corners or corrected.design.cameras is not stated.design.cameras:
        return False
    changed = [(a, b) for a, b in zip(stated.design.targets, corrected.design.targets) if a is not b]
    alike = ("name", "body", "dictionary", "edge", "marker", "pose", "listed")
    return len(changed) == 1 and all(
        getattr(a, name) is getattr(b, name) and sorted(a.ids) == sorted(b.ids) for a, b in changed for name in alike
    )


def cube_edge_trials(sample: SampledRecording) -> Iterator[Candidate]:
    """Trials with the edges of all cubes larger or smaller than stated."""
    for by in EDGES:
        if all(not t.edge or t.edge + by > (t.marker or 0.0) for t in sample.design.targets):
            yield (
                f"rig.toml: the edge of all cubes is stated about {abs(by) * 1e3:.0f} mm too "
                f"{'small' if by > 0 else 'large'}",
                "Measure a cube from face to face, in metres",
                sample.with_targets(
                    tuple(replace(t, edge=t.edge + by) if t.edge else t for t in sample.design.targets)
                ),
            )


def targets_with_misfitting_corners(trial: Trial) -> list[str]:
    """Names of targets with corners that do not fit.

    Most corners of a marker do not; the worst is first.
    """
    if trial.measured is None or trial.miss is None:
        return []
    o, markers = trial.measured.observations, marker_map(trial.seen.design)
    owners = np.array(markers.target)
    off: dict[str, float] = {}
    for row in np.unique(o.marker):
        miss = trial.miss[o.marker == row] > 2.0
        if miss.mean() > 0.5 and len(miss) >= LEAST_CORNERS:
            off[str(owners[row])] = off.get(str(owners[row]), 0.0) + float(miss.sum())
    if 2 * len(off) > len(set(markers.target)):
        return []
    return sorted(off, key=lambda name: off[name], reverse=True)[:2]


_POSES: tuple[tuple[str, Callable[[RigidTransform], RigidTransform]], ...] = (
    ("inverted (body in cube)", lambda T: T.inv()),
    ("rotations are inverted", lambda T: RigidTransform.from_components(T.translation, T.rotation.inv())),
    (
        "rotations are in degrees",
        lambda T: RigidTransform.from_components(
            T.translation, Rotation.from_rotvec(np.radians(T.rotation.as_rotvec()))
        ),
    ),
    ("positions are in centimetres", lambda T: RigidTransform.from_components(T.translation * 0.01, T.rotation)),
    ("positions are in inches", lambda T: RigidTransform.from_components(T.translation * 0.0254, T.rotation)),
    ("x and y are exchanged", lambda T: RigidTransform.from_components(T.translation[[1, 0, 2]], T.rotation)),
    ("the sign of x is reversed", lambda T: RigidTransform.from_components(T.translation * [-1, 1, 1], T.rotation)),
    ("the sign of y is reversed", lambda T: RigidTransform.from_components(T.translation * [1, -1, 1], T.rotation)),
    ("the sign of z is reversed", lambda T: RigidTransform.from_components(T.translation * [1, 1, -1], T.rotation)),
)
