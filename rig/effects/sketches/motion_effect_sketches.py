"""Sketches of effects on motion.

An example of usual size run on one hexapod, and its figures.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Drawing, Parameter
from rig.errors import RigError
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.base_and_link_tilt_sensors import BaseTilt
from rig.model.design import Camera, Design
from rig.model.pose import exp, pose_difference
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording.recording_folder import PAYLOAD, Commands, Sensors, sensors_with_gravity
from rig.report.pages.html_and_svg_elements import TEXT, WIDTH, svg_figure, svg_text
from rig.report.pages.svg_plots import Series, plot_panel_svg

RADIUS, LEAD, PAYLOAD_AT = (
    0.3,
    0.01,
    (0.12, -0.42, 0.1),
)  # m, of the rig, its screws and on its platform: so far out that struts come to pull
AXIS = 2  # the strut that is looked at, number 3
FAR = 0.02  # m of travel to either side of home
LADDER = (0, 1 / 3, -1 / 3, 2 / 3, -2 / 3, 1, -1, 0)  # of FAR, where that strut rests: reversals that grow
REST = 0.5  # of each leg
SPAN = 40.0  # s of a way that nothing about the effect times
PERIODS = {
    "log": 8.0,
    "frequency": 8.0,
    "size": 100.0,
    "linear": 100.0,
}  # of an effect's own time that the way lasts otherwise, by its role
COUNT = 401  # exposures
SEED = 4  # of what has several numbers, which are drawn
ELEVATION = BaseTilt("elevation_deg", np.array([0.0, 1.0, 0.0]))  # by which the base tilts where cameras are looked at
WARM, LOADED, TILTED = 20.0, 6.0, 60.0  # K, kg and degrees, by which temperatures, the payload and the base rise


@dataclass(frozen=True, slots=True)
class Sketch:
    """What an effect does. words : where it sits and how large it is; figures : one or two, as
    rig.report.pages.page_templates_and_index_page makes them.
    """

    words: str
    figures: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ExampleRun:
    """An Effect, and what it is looked at on. t : (n,) s, the exposures; commands : of a hexapod; sensors : all that is
    known to be logged
    motion : of the commands without it, with its poses"""

    effect: Effect
    design: Design
    t: Floats
    commands: Commands
    sensors: Sensors
    motion: Motion


def example_run_with_effect(
    kind: type[Effect],
    place: str,
    factor: float = 1.0,
    design: Design | None = None,
    displaced: Callable[[Effect, Camera], float] = lambda effect, camera: 1.0,
) -> ExampleRun:
    """Example run (ExampleRun) with an effect of a kind at a place.

    `factor` times its largest usual size.
    design : the Design with the cameras and targets that it may sit at, by default none; displaced : see Drawing.

        Raises
    RigError for an effect that cannot be shown on this rig
    """
    base = hexapod_design_for_sketches()
    seen = base if design is None else replace(base, cameras=design.cameras, targets=design.targets)
    span = _span(kind, place)
    t = np.linspace(0.0, span, COUNT)
    commands, sensors = _commands(base, span), _sensors(span, tuple(camera.name for camera in seen.cameras))
    if kind.stage == "view":
        sensors = sensors_with_gravity(base.gravity, (ELEVATION,), sensors)
    motion = motion_simulation.motion_of_commands(base, commands, t, (), sensors)
    motion = replace(motion, T=motion_simulation.simulate_machine_run(base, commands, t, (), sensors).T_base_platform)
    drawn = kind.drawn(place, Drawing(seen, t, motion, displaced), np.random.default_rng(SEED))
    values = {p.name: _size(p, span, getattr(drawn, p.name), factor) for p in kind.parameters_at(place)}
    effect = effect_with_valid_place_and_parameters(replace(drawn, **values))
    reason = effect.needs(motion)
    if reason:
        raise RigError(f"{effect.name} {reason}")
    return ExampleRun(effect, seen, t, commands, sensors, motion)


@cache
def hexapod_design_for_sketches() -> Design:
    """Design of the hexapod used in sketches.

    With an off-centre payload.
    """
    design = design_from_rig_toml.design_of_entries(
        toml_entries(
            hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(RADIUS, cameras=1, cubes=1), Path("layout")
        )
    )
    platform = replace(design.platform, payload_centre_of_mass=np.array(PAYLOAD_AT))
    return replace(design, platform=platform, actuator=replace(design.actuator, screw_lead=LEAD))


def place_and_changed_values_text(effect: Effect) -> str:
    """Text of an effect's place and of its values that differ from the defaults."""
    default = {field.name: field.default for field in fields(effect)}
    shown = [
        (p, getattr(effect, p.name)) for p in effect.parameters_at(effect.place) if p.role not in ("moment", "phase")
    ]
    return ", ".join(
        [
            effect.place,
            *(
                p.value_text(value)
                for p, value in shown
                if isinstance(value, float) and np.isfinite(value) and value != default[p.name]
            ),
        ]
    )


def _size(p: Parameter, span: float, drawn: float | tuple[float, ...], factor: float) -> float | tuple[float, ...]:
    """A parameter's value in a sketch: as large as rigs show; what only shapes the model in the middle of it; what was
    drawn for several.
    """
    if isinstance(drawn, tuple):
        return tuple(factor * v for v in drawn) if p.role == "linear" else drawn
    low, high = p.usual
    middle = {
        "log": np.sqrt(abs(low * high)),
        "even": (low + high) / 2,
        "frequency": np.sqrt(abs(low * high)),
        "phase": 0.0,
        "moment": span / 2,
    }
    if p.role in middle:
        return drawn if np.isinf(drawn) else float(middle[p.role])
    if p.role in ("choice", "form") or np.isinf(drawn):
        return drawn
    return low / factor if p.role == "inverse" else high * factor


def _span(kind: type[Effect], place: str) -> float:
    """s that the way lasts: so many of the longest time that the effect itself knows."""
    own = [
        _own_time(p) * PERIODS[p.role]
        for p in kind.parameters_at(place)
        if p.size == 1 and p.unit in ("s", "Hz") and p.role in PERIODS
    ]
    return max(own, default=SPAN)


def _own_time(p: Parameter) -> float:
    size = _size(p, 0.0, 1.0, 1.0)
    assert isinstance(size, float)
    return 1 / size if p.unit == "Hz" else size


def _commands(design: Design, span: float) -> Commands:
    """The way: one strut rests at the rungs of a ladder, the others swing, each at a pace of its own, so that the
    platform tilts and turns.
    """
    t = np.linspace(0.0, span, COUNT)
    leg = span / len(LADDER[1:])
    knots = np.concatenate([[k * leg, (k + 1 - REST) * leg] for k in range(len(LADDER) - 1)] + [[span]])
    rungs = FAR * np.concatenate([[a, b] for a, b in zip(LADDER[:-1], LADDER[1:])] + [[LADDER[-1]]])
    swings = [FAR / 2 * np.sin(2 * np.pi * (i + 1) / 2 * t / span) for i in range(6)]
    swings[AXIS] = np.interp(t, knots, rungs)
    return Commands(
        t,
        motion_simulation.motion_of_commands(design, Commands(np.zeros(1), np.zeros((1, 6))), np.zeros(1)).home
        + np.stack(swings, axis=1),
    )


def _sensors(span: float, cameras: tuple[str, ...]) -> Sensors:
    """All channels that effects know: everything warms, and the payload is put on in the middle."""
    warm = (
        "ambient_temperature_C",
        *(f"strut{i + 1}_temperature_C" for i in range(6)),
        *(f"camera_{name}_temperature_C" for name in cameras),
    )
    t = np.array([0.0, 0.3, 0.7, 1.0]) * span
    rising = {name: 20 + WARM * t / span for name in warm} | {ELEVATION.channel: TILTED * t / span}
    return Sensors(t, {**rising, PAYLOAD: np.array([0.0, 0.0, LOADED, LOADED])})


SHARE = 0.5  # of what is told, that errors are drawn as large as at the most
HIGH = 120.0  # of a panel's drawing
TURNED, RAISED = np.radians(25), np.radians(12)  # from where the platform is looked at
SIZE = 0.52 * WIDTH  # of the machine in its figure
OUT = 0.12  # m by which the platform is drawn displaced
FLOOR = 1e-12  # m; less is no error
UNITS = {1e-9: "nm", 1e-6: "µm", 1e-3: "mm"}
TIMES = {1e-3: "ms", 1.0: "s", 60.0: "min", 3600.0: "h"}


def draw_motion_effect_sketch(kind: type[Effect], factor: float = 1.0) -> Sketch:
    """Draw the sketch of an effect of a kind.

    factor : of its largest usual size
    """
    place = str(Place.axis("strut", AXIS)) if "axis" in kind.places else kind.places[0]
    run = example_run_with_effect(kind, place, factor)
    error = _strut_errors(run)
    first = _displaced(run) if kind.stage == "structure" or kind.on_pose else _through_time(run, error)
    return Sketch(place_and_changed_values_text(run.effect), (first, _over_covariate(run, error)))


def _strut_errors(run: ExampleRun) -> Floats:
    """(n,) m by which the strut shown is beyond its command, at the exposures of an ExampleRun."""
    T = run.motion.T
    assert T is not None
    found = motion_simulation.effective_commands(run.design, run.commands, run.t, T, [run.effect], run.sensors)
    return found[:, AXIS] - run.motion.lengths[:, AXIS]


def _through_time(run: ExampleRun, error: Floats) -> str:
    """Commanded and actual position of the strut, its error enlarged."""
    commanded = run.motion.stroke[:, AXIS]
    much = enlargement_factor(np.abs(error).max(), SHARE * FAR)
    scale, unit = value_in_largest_suitable_unit(run.t[-1], TIMES)
    series = [
        Series(run.t / scale, commanded * 1e3, "told", "line", -1),
        Series(run.t / scale, (commanded + much * error) * 1e3, enlargement_text("done", much), "line", 1),
    ]
    return plot_panel_svg(f"Strut {AXIS + 1}", (f"time, {unit}", "stroke, mm"), series, high=HIGH)


def _over_covariate(run: ExampleRun, error: Floats) -> str:
    """The error over what gives the effect away."""
    shown = run.effect.covariate(run.motion)
    across = np.asarray(shown.values)
    scale, unit = value_in_largest_suitable_unit(np.abs(error).max(), UNITS)
    values = across[:, AXIS] if across.ndim == 2 else across
    return plot_panel_svg(
        "What gives it away",
        (shown.label, f"error of strut {AXIS + 1}, {unit}"),
        [Series(values, error / scale, "", "dots", 1)],
        high=HIGH,
    )


def _displaced(run: ExampleRun) -> str:
    """The platform at its commanded and at its actual pose, at the exposure at which these differ most,
    enlarged.
    """
    T = run.motion.T
    assert T is not None
    found = motion_simulation.simulate_machine_run(
        run.design, run.commands, run.t, [run.effect], run.sensors
    ).T_base_platform
    shift = pose_difference(T, found)
    far = np.linalg.norm(shift[:, :3], axis=1)
    at = int(np.argmax(far))
    much = enlargement_factor(float(far[at]), OUT)
    pair = RigidTransform.concatenate([T[at], T[at] * exp(much * shift[at])])
    ends = run.motion.kind.strut_ends(pair, run.motion.mechanism)
    assert ends is not None
    base, tips = (_seen(np.broadcast_to(points, (2, 6, 3))) for points in ends)
    low, high = (pick(np.concatenate([base, tips]).reshape(-1, 2), axis=0) for pick in (np.min, np.max))
    scale = SIZE / max(high - low)
    top, left = 2 * TEXT + 22.0, (WIDTH - scale * (high - low)[0]) / 2
    base, tips = ((points - low) * scale + [left, top] for points in (base, tips))
    parts = [
        svg_text(4, 14, "The platform", style="name"),
        svg_text(4, 34, f"grey: commanded; {enlargement_text('orange: done', much)}"),
    ]
    for k, style in enumerate(("line grey", "line c1")):
        struts = "".join(
            f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(base[k].tolist(), tips[k].tolist())
        )
        parts.append(f'<path class="{style}" d="{struts}{_ring(tips[k])}"/>')
    parts.append(f'<path class="axis" d="{_ring(base[0])}"/>')
    return svg_figure(
        int(top + scale * (high - low)[1] + 12),
        f"the platform displaced, {place_and_changed_values_text(run.effect)}",
        parts,
    )


def _ring(points: Floats) -> str:
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points.tolist()) + "Z"


def _seen(points: Floats) -> Floats:
    """Points (..., 3) m of the base as they are looked at, (..., 2) m to the right and down."""
    x, y, z = np.moveaxis(points, -1, 0)
    across, away = x * np.cos(TURNED) - y * np.sin(TURNED), x * np.sin(TURNED) + y * np.cos(TURNED)
    return np.stack([across, -z * np.cos(RAISED) - away * np.sin(RAISED)], axis=-1)


def enlargement_factor(size: float, target: float) -> float:
    """Enlargement factor from a size to about a target size.

    1, 2, 5 times a power of ten, at least 1.
    """
    if size <= FLOOR:
        return 1.0
    power = 10.0 ** np.floor(np.log10(target / size))
    return max(1.0, float(next(k * power for k in (5, 2, 1) if k * power <= target / size)))


def enlargement_text(text: str, factor: float) -> str:
    """Text of words with the enlargement factor of the drawn error added."""
    times = f"{factor:,.0f}".replace(",", " ")
    return text if factor == 1 else f"{text}, error {times} times"


def value_in_largest_suitable_unit(size: float, units: dict[float, str]) -> tuple[float, str]:
    """Value of a size in the largest unit in which it is 2 or more, and this unit.

    Returns (value, unit)
    """
    return next(
        ((value, name) for value, name in sorted(units.items(), reverse=True) if size >= 2 * value), min(units.items())
    )
