"""Example of an effect for a sketch: of usual size, on one hexapod and one path that show what it does."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np

from rig.arrays import Floats
from rig.effects.framework.effect import Effect
from rig.effects.framework.effect_validity import check_effect
from rig.effects.framework.machine_motion import Motion
from rig.effects.framework.parameter import Drawing, Parameter
from rig.errors import RigError
from rig.formats.rig_toml import design_file
from rig.formats.structured_files import toml_entries
from rig.model import motion_simulation
from rig.model.design import Camera, Design
from rig.planning.layout import hexapod_and_two_strut_layout
from rig.recording.recording_folder import PAYLOAD, Commands, Sensors

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
WARM, LOADED = 20.0, 6.0  # K and kg, by which temperatures and the payload rise


@dataclass(frozen=True, slots=True)
class Sketch:
    """What an effect does. words : where it sits and how large it is; figures : one or two, as
    rig.report.pages.svg_elements makes them.
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


def effect_example(
    kind: type[Effect],
    place: str,
    factor: float = 1.0,
    design: Design | None = None,
    displaced: Callable[[Effect, Camera], float] = lambda effect, camera: 1.0,
) -> ExampleRun:
    """Example run (ExampleRun) with an effect of a kind at a place, `factor` times its largest usual size.

    design : the Design with the cameras and targets that it may sit at, by default none; displaced : see Drawing.

        Raises
    RigError for an effect that cannot be shown on this rig
    """
    base = sketch_hexapod()
    seen = base if design is None else replace(base, cameras=design.cameras, targets=design.targets)
    span = _span(kind, place)
    t = np.linspace(0.0, span, COUNT)
    commands, sensors = _commands(base, span), _sensors(span, tuple(camera.name for camera in seen.cameras))
    motion = motion_simulation.motion_of_commands(base, commands, t, (), sensors)
    motion = replace(motion, T=motion_simulation.run_machine(base, commands, t, (), sensors).T_base_platform)
    drawn = kind.drawn(place, Drawing(seen, t, motion, displaced), np.random.default_rng(SEED))
    values = {p.name: _size(p, span, getattr(drawn, p.name), factor) for p in kind.parameters_at(place)}
    effect = check_effect(replace(drawn, **values))
    reason = effect.needs(motion)
    if reason:
        raise RigError(f"{effect.name} {reason}")
    return ExampleRun(effect, seen, t, commands, sensors, motion)


@cache
def sketch_hexapod() -> Design:
    """Design of the hexapod used in all sketches, with an off-centre payload."""
    design = design_file.design_of_entries(
        toml_entries(hexapod_and_two_strut_layout.hexapod_layout_rig_toml(RADIUS, cameras=1, cubes=1), Path("layout"))
    )
    platform = replace(design.platform, payload_centre_of_mass=np.array(PAYLOAD_AT))
    return replace(design, platform=platform, actuator=replace(design.actuator, screw_lead=LEAD))


def place_and_values_text(effect: Effect) -> str:
    """Text of an effect's place and of its values that differ from the defaults."""
    default = {field.name: field.default for field in fields(effect)}
    shown = [
        (p, getattr(effect, p.name)) for p in effect.parameters_at(effect.place) if p.role not in ("moment", "phase")
    ]
    return ", ".join(
        [
            effect.place,
            *(
                p.said(value)
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
    if p.role == "choice" or np.isinf(drawn):
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
    return Sensors(t, {**{name: 20 + WARM * t / span for name in warm}, PAYLOAD: np.array([0.0, 0.0, LOADED, LOADED])})
