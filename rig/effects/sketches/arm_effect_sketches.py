"""Sketches of the effects of an arm's links.

One posture of a shipped arm displaced, and what gives the effect away.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.sketches.motion_effect_sketches import (
    HIGH,
    OUT,
    SPAN,
    UNITS,
    Sketch,
    enlargement_factor,
    enlargement_text,
    place_and_changed_values_text,
    value_in_largest_suitable_unit,
)
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Design, Platform
from rig.model.mechanisms.arm_kinematics_limits_and_loads import link_points
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.model.pose import exp
from rig.planning.layout.shipped_arms_and_layouts import load_shipped_arm_design
from rig.recording.recording_folder import Commands
from rig.report.pages.html_and_svg_elements import TEXT, WIDTH, svg_figure, svg_text
from rig.report.pages.svg_plots import Series, plot_panel_svg

LINK = 1  # index of the joint whose link is looked at, number 2
MIDDLE, SWING = np.array([0.0, -1.0, 1.2, -1.6, -1.57, 0.0]), 0.8  # rad, joint values about which the arm swings
LOAD, CENTRE = 10.0, (0.0, 0.0, 0.1)  # kg and m, what the hand holds
COUNT = 201  # exposures
SIZE = 0.4 * WIDTH  # of the arm in its figure
SMALL_UNITS = {**UNITS, 1e-2: "cm"}


def draw_arm_effect_sketch(kind: type[Effect], factor: float = 1.0) -> Sketch:
    """Draw the sketch of an effect of an arm's links.

    factor : of its largest usual size
    """
    place = str(Place.axis("joint", LINK))
    size = {p.name: p.usual[0] / factor for p in kind.parameters_at(place) if p.role == "inverse"}
    effect = effect_with_valid_place_and_parameters(replace(kind(place), **size))
    motion = _example_motion()
    return Sketch(place_and_changed_values_text(effect), (_displaced(effect, motion), _over_covariate(effect, motion)))


@cache
def _arm_design() -> Design:
    return replace(load_shipped_arm_design("ur10"), platform=Platform(LOAD, np.array(CENTRE), None))


@cache
def _example_motion() -> Motion:
    design, t = _arm_design(), np.linspace(0.0, SPAN, COUNT)
    swings = np.sin(2 * np.pi * np.arange(1, len(MIDDLE) + 1) * t[:, None] / SPAN)
    commands = Commands(t, MIDDLE + SWING * swings)
    run = motion_simulation.simulate_machine_run(design, commands, t)
    return motion_simulation.motion_of_commands(design, commands, t, (), None, run.T_base_platform)


def _over_covariate(effect: Effect, motion: Motion) -> str:
    """How far the hand is displaced, over what gives the effect away."""
    moved, shown = np.linalg.norm(effect.sway(motion)[:, :3], axis=1), effect.covariate(motion)
    scale, unit = value_in_largest_suitable_unit(float(moved.max()), SMALL_UNITS)
    series = [Series(shown.values, moved / scale, "", "dots", 1)]
    return plot_panel_svg("What gives it away", (shown.label, f"error of the hand, {unit}"), series, high=HIGH)


def _displaced(effect: Effect, motion: Motion) -> str:
    """The arm as commanded and as it stands, at the exposure at which these differ most, enlarged."""
    sway, arm = effect.sway(motion), require_arm(motion.mechanism)
    far = np.linalg.norm(sway[:, :3], axis=1)
    at = int(np.argmax(far))
    much = enlargement_factor(float(far[at]), OUT)
    straight = link_points(motion.lengths[at], arm)
    T = motion.poses()[at]
    bent = straight.copy()
    bent[LINK + 1 :] = (T * exp(much * sway[at]) * T.inv()).apply(straight[LINK + 1 :])
    flat = [_seen(points) for points in (straight, bent)]
    low, high = (pick(np.concatenate(flat), axis=0) for pick in (np.min, np.max))
    scale = SIZE / max(high - low)
    top, left = 2 * TEXT + 22.0, (WIDTH - scale * (high - low)[0]) / 2
    parts = [
        svg_text(4, 14, "The arm", style="name"),
        svg_text(4, 34, f"grey: commanded; {enlargement_text('orange: done', much)}"),
    ]
    for style, points in zip(("line grey", "line c1"), flat):
        line = "L".join(f"{x:.1f} {y:.1f}" for x, y in ((points - low) * scale + [left, top]).tolist())
        parts.append(f'<path class="{style}" d="M{line}"/>')
    words = f"the arm displaced, {place_and_changed_values_text(effect)}"
    return svg_figure(int(top + scale * (high - low)[1] + 12), words, parts)


def _seen(points: Floats) -> Floats:
    """Points (n, 3) m as they are looked at from the side, (n, 2) m to the right and down."""
    return np.stack([points[:, 0] + 0.3 * points[:, 1], -points[:, 2]], axis=1)
