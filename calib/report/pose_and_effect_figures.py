"""Figures of poses and of effects for pages.

Plots and 3-D scenes of poses, displacements of poses by one effect, and sketches of effects.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers, Json
from rig.effects import sketches
from rig.effects.framework.effect_base_class import MOTION_STAGES, Effect
from rig.effects.sketches.motion_effect_sketches import (
    HIGH,
    TIMES,
    Sketch,
    enlargement_factor,
    enlargement_text,
    example_run_with_effect,
    hexapod_design_for_sketches,
    place_and_changed_values_text,
    value_in_largest_suitable_unit,
)
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.design import Camera, Design, Marker, Target
from rig.model.machine_motion_simulation import MachineRun
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.model.pose import pose, pose_difference, pose_to_vector
from rig.recording.recording_folder import Commands, Sensors
from rig.report.pages import image_plane_and_3d_views
from rig.report.pages.html_and_svg_elements import figures_with_caption_html
from rig.report.pages.image_plane_and_3d_views import Arrows, Cells, DrawnEffect, Quads, Scene, image_plane_figure
from rig.report.pages.svg_plots import Series, figures_side_by_side_html, plot_panel_svg
from vision.marker_corner_prediction import MarkerMap, Sightings, State, marker_map, predict_sightings

FACTORS = (0.0, 0.5, 1.0, 2.0, 4.0)  # of the size that it has
NONE = 1e-9  # m and rad; less than this does not move the platform


def pose_displacements_by_effect_at_several_sizes(
    design: Design,
    commands: Commands,
    t: Floats,
    effects: Sequence[Effect],
    effect_index: int,
    sensors: Sensors | None = None,
) -> image_plane_and_3d_views.DrawnEffect | None:
    """Pose displacements (DrawnEffect) by one of several effects, at several sizes.

    At exposures t (n,) s; or None.
    """
    effect = effects[effect_index]
    if effect.stage not in MOTION_STAGES:
        return None
    others = [e for k, e in enumerate(effects) if k != effect_index and e.stage in MOTION_STAGES]
    at_rest = motion_simulation.simulate_machine_run(design, commands, t, others, sensors).T_base_platform
    sizes, shifts = ["none"], [np.zeros((len(t), 6))]
    for factor in FACTORS[1:]:
        one = effect_with_size_scaled(effect, factor)
        try:
            done = motion_simulation.simulate_machine_run(design, commands, t, [*others, one], sensors)
        except RigError:
            if factor <= 1:
                raise
            break
        sizes.append(_effect_size_text(one))
        shifts.append(pose_difference(at_rest, done.T_base_platform))
    shown = np.stack(shifts)
    if np.abs(shown).max() < NONE:
        return None
    return image_plane_and_3d_views.DrawnEffect(f"{effect.label()} at {effect.place}", tuple(sizes), shown)


def effect_with_size_scaled(effect: Effect, factor: float) -> Effect:
    """Effect scaled by a factor.

    Its size parameters multiplied, inverse ones divided.
    """
    values = {
        p.name: _times(getattr(effect, p.name), factor if p.role != "inverse" else 1 / factor)
        for p in effect.parameters
        if p.role in ("linear", "size", "inverse")
    }
    return replace(effect, **values)


def _effect_size_text(effect: Effect) -> str:
    """Its first parameter that tells its size, in words."""
    sized = [p for p in effect.parameters if p.role in ("linear", "size", "inverse")]
    return "" if not sized else sized[0].at(effect.place).value_text(getattr(effect, sized[0].name))


def _times(value: float | tuple[float, ...], factor: float) -> float | tuple[float, ...]:
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor


def pose_coverage_figures(pose_vectors: Floats) -> str:
    """Figures of how poses cover the workspace.

    Vectors (n, 6) are position (m) and rotation vector (rad).
    """
    mm = pose_vectors[:, :3] * 1e3
    places = [
        plot_panel_svg(f"seen {seen}", (f"{'xyz'[i]}, mm", f"{'xyz'[j]}, mm"), [Series(mm[:, i], mm[:, j])])
        for seen, i, j in (("from above", 0, 1), ("from the side", 0, 2))
    ]
    turns = [
        Series(np.arange(len(pose_vectors)), np.degrees(pose_vectors[:, 3 + k]), name, colour=k)
        for k, name in enumerate(("rx", "ry", "rz"))
    ]
    panels = figures_side_by_side_html(
        *places, plot_panel_svg("how it was turned", ("pose", "rotation vector, degrees"), turns)
    )
    return figures_with_caption_html(
        panels,
        (
            "Positions of the poses (mm), from above and from the side, and the rotation of each (degrees). Good: "
            "dots over the whole space that is used later. Bad: empty regions, or dots on a line."
        ),
    )


def correction_error_figures(before: Floats, after: Floats, frames: Integers, poses: str) -> str:
    """Figures of errors (n, 6) before and after correction.

    In m and rad, frame (n,) by frame; NaN is left out.
    poses : which they are, in words, for the caption
    """
    seen = [
        (part, label)
        for part, label in ((slice(0, 3), "position, mm"), (slice(3, 6), "rotation, mrad"))
        if np.isfinite(after[:, part]).all()
    ]
    panels = figures_side_by_side_html(
        *(
            plot_panel_svg(
                f"error of {label.partition(',')[0]}",
                ("frame", label),
                [
                    Series(frames, np.linalg.norm(before[:, part], axis=1) * 1e3, "nominal model", colour=1),
                    Series(frames, np.linalg.norm(after[:, part], axis=1) * 1e3, "corrected", colour=0),
                ],
                log=True,
            )
            for part, label in seen
        )
    )
    return figures_with_caption_html(
        panels,
        (
            f"Error of each pose as the nominal model and as the correction have it: {poses}. Position in mm, "
            "rotation in mrad, on a logarithmic scale. Good: corrected dots far lower, in an even band. Bad: both "
            "series overlap, or the corrected errors grow with the frames."
        ),
    )


FITTED = "all poses, including those fitted"


SIGHT = 0.12  # of a camera's distance: how long its lines are drawn
SHARE = 0.65  # of the cameras' distance, that the view shows across
REACH = 0.15  # m, of the cross at an arm's hand


def rig_scene(
    design: Design,
    frames: Integers,
    T: RigidTransform,
    values: Floats | None = None,
    errors: dict[str, Floats] | None = None,
    effects: tuple[DrawnEffect, ...] = (),
) -> Scene:
    """3-D scene of a rig at its poses.

    frames : (n,) numbers; T : T_base_platform (n,); values : (n, axes) commanded, or None
    errors : {name: (n, 6) tangent on the right}, NaN where not known
    """
    m, markers = design.mechanism, marker_map(design.without_stages()) if design.targets else None
    base = platform = np.zeros((0, 3))
    moved = [] if markers is None else [_face(markers, int(k)) for k in np.flatnonzero(markers.on_platform)]
    fixed, links = drawn_lines_of_base_targets_and_camera_sights(design, markers), None
    if m.strut_joints is not None:
        base, platform = m.strut_joints
    elif m.axes and values is not None:
        links = mechanisms.kinematics_of(m).link_points(values, m)
    for lines, joints in zip((fixed, moved), m.plates or ()):
        lines.append({"kind": "plate", "points": closed_outline_sorted_by_angle(joints)})
    if not len(platform):
        moved += _cross()
    return Scene(
        frames,
        pose_to_vector(T),
        fixed,
        moved,
        _middle(T, base, links),
        _size(design, T, links),
        base,
        platform,
        links,
        m.plates[1] if m.plates is not None else np.zeros((1, 3)),
        errors or {},
        effects,
    )


def mechanism_scene(
    mechanism: Arm | Chain, frames: Integers, values: Floats, effects: tuple[DrawnEffect, ...] = ()
) -> Scene:
    """3-D scene of a mechanism.

    Effects are drawn at their places; it has no cameras and targets.
    frames : (n,) numbers; values : (n, axes) rad or m
    """
    kinematics = mechanisms.kinematics_of(mechanism)
    links, T = kinematics.link_points(values, mechanism), kinematics.forward(values, mechanism)
    base = np.zeros((1, 3))
    size = float(
        np.ptp(np.concatenate([base, T.translation] if links is None else [links.reshape(-1, 3)]), axis=0).max()
    )
    return Scene(frames, pose_to_vector(T), (), _cross(), _middle(T, base, links), size, links=links, effects=effects)


def _cross() -> list[Json]:
    """The axes at a hand that carries nothing."""
    return [{"kind": "plate", "points": np.outer([-REACH / 2, REACH / 2], axis)} for axis in np.eye(3)]


def drawn_lines_of_base_targets_and_camera_sights(design: Design, markers: MarkerMap | None) -> list[Json]:
    """Drawn lines of a rig's base targets and of its cameras' lines of sight.

    Base targets and camera sights.
    """
    parts = []
    for camera in design.cameras:
        if camera.mount != "fixed":
            continue
        reach = SIGHT * float(np.linalg.norm(camera.pose.translation))
        half = np.array([camera.width / camera.matrix[0, 0], camera.height / camera.matrix[1, 1]]) / 2 * reach
        corners = camera.pose.apply(
            np.array([[x * half[0], y * half[1], reach] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        )
        eye = camera.pose.translation
        parts.append(
            {"kind": "camera", "name": camera.name, "points": [eye.tolist(), *corners.tolist(), corners[0].tolist()]}
        )
        parts += [{"kind": "camera", "points": [eye.tolist(), corner.tolist()]} for corner in corners[1:]]
    if markers is not None:
        parts += [_face(markers, int(k)) for k in np.flatnonzero(~markers.on_platform)]
    return parts


def closed_outline_sorted_by_angle(joints: Floats) -> list[list[float]]:
    """Closed outline [(x, y, z) ..] m of joints (n, 3) m, in order of angle around their middle."""
    around = np.argsort(np.arctan2(*(joints - joints.mean(axis=0))[:, 1::-1].T))
    return joints[np.r_[around, around[0]]].tolist()


def _face(markers: MarkerMap, k: int) -> Json:
    return {"kind": "face", "points": markers.corners[k].tolist()}


def _middle(T: RigidTransform, base: Floats, links: Floats | None) -> list[float]:
    ends = [T.translation, base] + ([] if links is None else [links.reshape(-1, 3)])
    every = np.concatenate([np.atleast_2d(part) for part in ends])
    return ((every.min(axis=0) + every.max(axis=0)) / 2).tolist()


def _size(design: Design, T: RigidTransform, links: Floats | None) -> float:
    """m, what there is to see."""
    if links is not None:
        return float(np.ptp(links.reshape(-1, 3), axis=0).max())
    cameras = [float(np.linalg.norm(camera.pose.translation)) for camera in design.cameras if camera.mount == "fixed"]
    return SHARE * max(cameras) if cameras else max(2 * float(np.abs(T.translation).max()), 0.1)


SKETCH_WIDTH, HEIGHT, FOCAL = 640, 420, 600.0  # px, of the camera that looks


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
    """Sketch of an effect of a kind.

    factor : of the largest size on real rigs
    Raises RigError for an effect that neither the rig of the sketches nor its camera can have
    """
    if kind.stage in MOTION_STAGES:
        return (sketches.draw_arm_effect_sketch if kind.of_links else sketches.draw_motion_effect_sketch)(kind, factor)
    run = example_run_with_effect(kind, PLACES[kind.places[-1]], factor, _sketch_targets(), _corner_displacement)
    true, found = (_seen(effects, run.t, run.sensors) for effects in ([], [run.effect]))
    by = found[-1] - true[-1]
    much = enlargement_factor(float(np.linalg.norm(by, axis=-1).max()), DRAWN)
    off = np.abs(by).max(axis=(1, 2)) > CHANGES * np.abs(by).max()
    layers: list[Arrows | Cells | Quads] = [
        Quads(true[-1]),
        Arrows(true[-1].reshape(-1, 2), by.reshape(-1, 2), much, "px", 3),
        Quads((true[-1] + much * by)[off], 1),
    ]
    picture = image_plane_figure(
        "Markers in the image",
        f"grey: as stated; {enlargement_text('orange: as seen', much)}",
        (SKETCH_WIDTH, HEIGHT),
        layers,
    )
    size = np.sqrt(np.mean(np.sum((found - true) ** 2, axis=-1), axis=(1, 2)))
    if np.ptp(size) <= CHANGES * size.max():
        return Sketch(place_and_changed_values_text(run.effect), (picture,))
    scale, unit = value_in_largest_suitable_unit(run.t[-1], TIMES)
    through = plot_panel_svg(
        "Through time", (f"time, {unit}", "RMS, px"), [Series(run.t / scale, size, "", "line", 1)], high=HIGH
    )
    return Sketch(place_and_changed_values_text(run.effect), (picture, through))


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
    matrix = np.array([[FOCAL, 0, SKETCH_WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
    camera = Camera("cam0", SKETCH_WIDTH, HEIGHT, matrix, np.zeros(5), pose(np.zeros(3), np.zeros(3)))
    targets = []
    for k, away in enumerate(np.linspace(NEAR, FAR, ROWS * COLUMNS)):
        middle = (
            np.array(
                [
                    (k % COLUMNS + 0.5) / COLUMNS * SKETCH_WIDTH - SKETCH_WIDTH / 2,
                    (k // COLUMNS + 0.5) / ROWS * HEIGHT - HEIGHT / 2,
                ]
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
    return replace(hexapod_design_for_sketches(), cameras=(camera,), targets=tuple(targets))


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
