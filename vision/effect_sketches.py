"""Sketches of effects, drawn by the effects' models: the displacement of marker corners in an image."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_types import Floats
from rig.effects import sketches
from rig.effects.framework.effect import MOTION_STAGES, Effect
from rig.effects.sketches.motion_effect_sketches import (
    HIGH,
    TIMES,
    Sketch,
    effect_example,
    enlargement_factor,
    enlargement_text,
    largest_suitable_unit,
    place_and_values_text,
    sketch_hexapod,
)
from rig.model.design import Camera, Design, Marker, Target
from rig.model.motion_simulation import MachineRun
from rig.model.pose import pose
from rig.recording.recording_folder import Sensors
from rig.report.pages.image_plane_and_3d_views import Arrows, Cells, Quads, image_plane_figure
from rig.report.pages.plots import Series, plot_panel_svg
from vision.predict import Sightings, State, predict_sightings
from vision.targets import marker_map

WIDTH, HEIGHT, FOCAL = 640, 420, 600.0  # px, of the camera that looks
ROWS, COLUMNS = 2, 3  # of targets, of four markers each, that fill its image
NEAR, FAR = 0.5, 0.8  # m from the camera to the nearest target and to the farthest
SIDE, APART = 0.055, 1.35  # m, of every marker; sides from one marker of a target to the next
DRAWN = 16.0  # px that the largest displacement is drawn long
SPEED = 0.1  # m/s at which all of it moves to the right
CHANGES = 1e-6  # of the displacement; less is no change in time
PLACES = {
    "cameras": "cameras",
    "markers": "markers",
    "camera": "camera cam0",
    "marker": "marker 9",
    "target": "target target2",
}


def effect_sketch(kind: type[Effect], factor: float = 1.0) -> Sketch:
    """Sketch of an effect of a kind, at `factor` times the largest size on real rigs.

    Raises RigError for an effect that neither the rig of the sketches nor its camera can have
    """
    if kind.stage in MOTION_STAGES:
        return sketches.draw_sketch(kind, factor)
    way = effect_example(kind, PLACES[kind.places[-1]], factor, _sketch_targets(), _corner_displacement)
    true, found = (_seen(effects, way.t, way.sensors) for effects in ([], [way.effect]))
    by = found[-1] - true[-1]
    much = enlargement_factor(float(np.linalg.norm(by, axis=-1).max()), DRAWN)
    off = np.abs(by).max(axis=(1, 2)) > CHANGES * np.abs(by).max()
    layers: list[Arrows | Cells | Quads] = [
        Quads(true[-1]),
        Arrows(true[-1].reshape(-1, 2), by.reshape(-1, 2), much, "px", 3),
        Quads((true[-1] + much * by)[off], 1),
    ]
    picture = image_plane_figure(
        "Markers in the image", f"grey: as stated; {enlargement_text('orange: as seen', much)}", (WIDTH, HEIGHT), layers
    )
    size = np.sqrt(np.mean(np.sum((found - true) ** 2, axis=-1), axis=(1, 2)))
    if np.ptp(size) <= CHANGES * size.max():
        return Sketch(place_and_values_text(way.effect), (picture,))
    scale, unit = largest_suitable_unit(way.t[-1], TIMES)
    through = plot_panel_svg(
        "Through time", (f"time, {unit}", "RMS, px"), [Series(way.t / scale, size, "", "line", 1)], high=HIGH
    )
    return Sketch(place_and_values_text(way.effect), (picture, through))


def _corner_displacement(effect: Effect, camera: Camera) -> float:
    """px RMS by which an effect moves corners all over the image of the sketches' camera, which is the only one there
    is.
    """
    assert camera.name == _sketch_targets().cameras[0].name
    true, found = (_seen(effects, np.zeros(1), None) for effects in ([], [effect]))
    return float(np.sqrt(np.mean(np.sum((found - true) ** 2, axis=-1))))


@cache
def _sketch_targets() -> Design:
    """A camera before targets of four markers each, which face it, nearer ones and farther ones side by side, all over
    its image.
    """
    matrix = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
    camera = Camera("cam0", WIDTH, HEIGHT, matrix, np.zeros(5), pose(np.zeros(3), np.zeros(3)))
    targets = []
    for k, away in enumerate(np.linspace(NEAR, FAR, ROWS * COLUMNS)):
        middle = (
            np.array(
                [(k % COLUMNS + 0.5) / COLUMNS * WIDTH - WIDTH / 2, (k // COLUMNS + 0.5) / ROWS * HEIGHT - HEIGHT / 2]
            )
            * away
            / FOCAL
        )
        at = [middle + APART * SIDE / 2 * np.array(corner) for corner in ((-1, -1), (1, -1), (-1, 1), (1, 1))]
        listed = tuple(
            Marker(4 * k + j, SIDE, pose(np.array([*xy, away]), np.array([np.pi, 0, 0])), SIDE / 8)
            for j, xy in enumerate(at)
        )
        targets.append(Target(f"target{k}", "platform", "DICT_5X5_100", listed=listed))
    return replace(sketch_hexapod(), cameras=(camera,), targets=tuple(targets))


def _seen(effects: list[Effect], t: Floats, sensors: Sensors | None) -> Floats:
    """(n, markers, 4, 2) px, all corners of the wall at exposures at t (n,) s."""
    design, count = _sketch_targets(), len(t)
    markers = marker_map(design)
    still = RigidTransform.from_matrix(np.broadcast_to(np.eye(4), (count, 4, 4)))
    moving = MachineRun(still, np.zeros((count, 6)), np.tile([SPEED, 0, 0, 0, 0, 0], (count, 1)), np.zeros((count, 6)))
    frame, marker = (index.ravel() for index in np.indices((count, len(markers.id))))
    sightings = Sightings(frame, np.zeros(len(frame), int), marker)
    return predict_sightings(sightings, State(design.cameras, still, {}), markers, t, effects, sensors, moving).reshape(
        count, -1, 4, 2
    )
