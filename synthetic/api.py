"""Python entry points of synthetic.

A recording of a simulated rig, and a diagnosed recording simulated again.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rig.array_and_json_types import Json
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_base_class import Effect
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import (
    Kinds,
    effect_with_existing_place,
    parse_effect,
    require_nonzero_effect,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import quantity_text
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Design, Sensor
from rig.planning.recording_plan import build_plan
from rig.recording.recording_folder import load_sensors
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html
from synthetic import random_true_machine_and_truth_file, recording_simulation
from synthetic.image_simulation import simulations_with_and_without_effects_found
from synthetic.recording_simulation import Simulation

if TYPE_CHECKING:
    from synthetic.image_simulation import Images

LARGEST_SETTING = 1e6  # of a simulated sensor
LARGEST = {"noise": (1000, "px"), "secret": (1000, ""), "seed": ((1 << 63) - 1, "")}


@dataclass(frozen=True, slots=True)
class ImageOptions:
    """How pictures are drawn. sensor : (name, value) of what is otherwise than the rig's sensor, see
    rig.model.design.Sensor; background : "plain" or "cluttered"; compression : of the PNG files, 0..9
    """

    sensor: tuple[tuple[str, float], ...] = ()
    background: str = "plain"
    compression: int = 1

    def of_sensor(self, sensor: Sensor) -> Sensor:
        """A rig's Sensor with what is otherwise. Raises RigError for settings that no sensor has"""
        changes: Json = dict(self.sensor)
        changed = replace(sensor, **changes)
        for field in fields(changed):
            if not 0 <= getattr(changed, field.name) <= LARGEST_SETTING:
                raise RigError(
                    f"--{field.name.replace('_', '-')} must be at least 0 and at most {LARGEST_SETTING:g}, "
                    f"got {getattr(changed, field.name):g}"
                )
        if changed.bits not in (8, 12):
            raise RigError(f"--bits takes 8 or 12, not {changed.bits}")
        if changed.exposure > 0 and changed.exposures < 2:
            raise RigError("an exposure over time requires --exposures of at least 2")
        return changed


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """plan : as of rig.planning.recording_plan.build_plan; effects : left-out physics, texts
    NAME:PLACE:PARAMETER=VALUE,..;
    kinds : effects that there are; noise : px, of corners; seed : of the secret machine, the temperatures and the noise
    secret : size of the geometry's and cameras' errors; machine : truth file with the machine, its cameras and effects,
    in place of drawn ones; sensors : table of temperatures and payload, in place of drawn ones
    images : whether pictures are drawn, not corners written; drawing : how
    """

    plan: str = "standard"
    effects: tuple[str, ...] = ()
    kinds: Kinds | None = None
    noise: float = 0.04
    seed: int = 0
    secret: float = 1.0
    machine: Path | None = None
    sensors: Path | None = None
    images: bool = False
    drawing: ImageOptions = ImageOptions()

    def __post_init__(self) -> None:
        for name, (most, unit) in LARGEST.items():
            value = getattr(self, name)
            if not 0 <= value <= most:  # true for what is not a number, too
                raise RigError(f"--{name} must be at least 0 and at most {most:g} {unit}".rstrip() + f", not {value:g}")

    def pictures(self, sensor: Sensor) -> Images | None:
        """How pictures are drawn by a rig's sensor, None where none are. Raises RigError for settings that cannot be"""
        found = self.drawing.of_sensor(sensor)
        if not self.images:
            return None
        from synthetic.image_simulation import Images

        return Images(found, self.drawing.background, self.drawing.compression)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SimulationResult(OneLineRepr):
    """A simulated recording before it is written. simulation : what the machine did; text : the owner's rig.toml;
    options; pictures : how they are drawn, None where corners are written; rng : the generator from which the noise is
    drawn, the same whenever it is written
    """

    simulation: Simulation
    text: str
    options: SimulateOptions
    pictures: Images | None
    rng: np.random.Generator

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The left-out physics at work."""
        return tuple(self.simulation.world.effects)

    def __str__(self) -> str:
        plan = self.simulation.plan
        names = ", ".join(f"{effect.name} at {effect.place}" for effect in self.effects) or "none"
        message = f"{len(plan.t)} frames over {plan.commands.t[-1] / 60:.1f} min, effects: {names}"
        conflict = recording_simulation.rms_length_conflict_of_actuated_struts(self.simulation)
        if conflict is None:
            return message
        return f"{message}; struts press against each other: each gives way by {quantity_text(conflict, 'm')} RMS"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), ["simulated; this result retains its truth"])

    def write(self, folder: Path | str, progress: Callable[[int, int], None] | None = None) -> None:
        """Write the recording into a folder. progress : called with (done, of) pictures, or None"""
        recording_simulation.write_recording(
            self.simulation, Path(folder), self.text, deepcopy(self.rng), self.options.noise, self.pictures, progress
        )

    def write_truth(self, path: Path | str) -> None:
        """Write the truth: the machine, its effects and poses, and how noisy the corners are."""
        seed, world, T = self.options.seed, self.simulation.world, self.simulation.run.T_base_platform
        if self.pictures is not None:
            corners = recording_simulation.true_corner_rows(self.simulation)
            random_true_machine_and_truth_file.write_truth(Path(path), world, T, seed=seed, corners=corners)
        else:
            random_true_machine_and_truth_file.write_truth(Path(path), world, T, seed=seed, noise_px=self.options.noise)


def simulate(rig_toml: Path | str, options: SimulateOptions = SimulateOptions()) -> SimulationResult:
    """SimulationResult of a rig under a plan, as `rig simulate` makes it.

    Raises RigError for a rig whose poses nothing sees, and for a plan or effects that it cannot have

    >>> import synthetic
    >>> options = synthetic.SimulateOptions(plan="sobol:3", effects=("backlash:strut 3:gap=8e-5",))
    >>> print(synthetic.simulate("tests/data/bench/check/rig.toml", options))
    3 frames over 0.3 min, effects: backlash at strut 3
    """
    path, kinds = Path(rig_toml), options.kinds or BY_NAME
    design = design_from_rig_toml.load_design(path)
    effects = tuple(
        require_nonzero_effect(effect_with_existing_place(parse_effect(text, kinds), design))
        for text in options.effects
    )
    pictures = options.pictures(design.sensor)
    _require_observer(design, path, options.images)
    if options.images:
        from synthetic.ideal_image_renderer import import_pyrender_without_viewer
        from synthetic.image_simulation import require_renderable

        require_renderable(effects)
        import_pyrender_without_viewer()
    rng = np.random.default_rng(options.seed)
    if options.machine is not None:
        world = random_true_machine_and_truth_file.load_world_from_truth_file(options.machine, design, kinds)
        world = replace(world, effects=world.effects + effects)
    else:
        world = random_true_machine_and_truth_file.random_true_machine(design, rng, options.secret, effects)
    plan = build_plan(design, options.plan, options.seed)
    sensors = None if options.sensors is None else load_sensors(options.sensors, plan.origin)
    done = recording_simulation.simulate_world(world, plan, rng, sensors)
    return SimulationResult(done, path.read_text(encoding="utf-8-sig"), options, pictures, rng)


def simulate_with_and_without_findings(
    diagnosis: Path | str, options: SimulateOptions = SimulateOptions()
) -> dict[str, SimulationResult]:
    """Simulate a diagnosed recording with and without its findings.

    Of a folder that `rig diagnose` wrote: the recording drawn anew with the effects found, and with none. options : of
    them noise, seed, kinds, images and drawing count

    Returns SimulationResults
    Raises FileError for a folder that holds no diagnosed recording, RigError where nothing was commanded
    """
    folder = Path(diagnosis)
    done = simulations_with_and_without_effects_found(folder, options.kinds or BY_NAME)
    pictures = options.pictures(next(iter(done.values())).world.true.sensor)
    text = (folder / "rig.toml").read_text(encoding="utf-8-sig")
    return {
        kind: SimulationResult(part, text, options, pictures, np.random.default_rng(options.seed))
        for kind, part in done.items()
    }


def _require_observer(design: Design, path: Path, images: bool) -> None:
    """Raise RigError where nothing sees poses, and where pictures are to be drawn and there are no cameras."""
    seen = bool(design.cameras and design.targets)
    if design.instrument is None and not seen:
        raise RigError(
            f"{path} has {len(design.cameras)} cameras, {len(design.targets)} targets and no "
            "[instrument]; simulating requires "
            "cameras and targets, or an instrument that sees poses"
        )
    if images and not seen:
        raise RigError(
            f"--images takes cameras and targets; {path} has {len(design.cameras)} and {len(design.targets)}"
        )
