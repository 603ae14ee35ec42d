"""All that needs no image looked at: files against each other, figures against what rigs have."""

import tomllib
from collections.abc import Iterator

from rig.checks import clock_mistakes, environment_values, image_folder, command_units, clock_shift, rig_toml_values
from rig.checks.user_mistake import Mistake, in_order
from rig.formats.input_files import read_text
from rig.recording.recording_folder import Recording


def early(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes that a Recording's files show by themselves, in order."""
    return in_order(_all(recording))


def _all(recording: Recording) -> Iterator[Mistake]:
    r, design = recording, recording.design
    yield from rig_toml_values.written(tomllib.loads(read_text(r.folder / "rig.toml")))
    yield from rig_toml_values.figures(design)
    yield from environment_values.surroundings(design)
    times = {"frames.csv": r.exposures.times()[1]}
    if r.commands is not None:
        times["commands.csv"] = r.commands.t
        odd = list(command_units.commands(r.commands, design))
        yield from odd
        if not odd:
            unit = "rad" if design.mechanism.kind == "arm" else "m"
            yield from clock_mistakes.pace(
                r.commands.t, r.commands.values, times["frames.csv"], unit, design.actuator.max_speed if unit == "m" else None
            )
    if r.sensors is not None:
        times["sensors.csv"] = r.sensors.t
        yield from environment_values.sensors(r.sensors, design)
    apart = list(clock_mistakes.between(times))
    yield from apart
    if r.commands is not None and not apart:
        yield from clock_shift.offset(times["frames.csv"], r.commands.t, r.commands.values)
    yield from clock_mistakes.repeated(times["frames.csv"])
    yield from image_folder.unused(r)
    yield from image_folder.images(r)
    yield from image_folder.pixels(r)
