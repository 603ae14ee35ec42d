"""All that needs no image looked at: files against each other, figures against what rigs have."""

import tomllib
from collections.abc import Iterator

from rig.checks import clock_mistakes, clock_shift, command_units, environment_values, image_folder, rig_toml_values
from rig.checks.user_mistake import Mistake, sort_mistakes
from rig.formats.input_files import read_text
from rig.recording.recording_folder import Recording


def file_mistakes(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes that a Recording's files show by themselves, in order."""
    return sort_mistakes(_all(recording))


def _all(recording: Recording) -> Iterator[Mistake]:
    r, design = recording, recording.design
    yield from rig_toml_values.overlong_rotation_vectors(tomllib.loads(read_text(r.folder / "rig.toml")))
    yield from rig_toml_values.implausible_values(design)
    yield from environment_values.environment_mistakes(design)
    times = {"frames.csv": r.exposures.times()[1]}
    if r.commands is not None:
        times["commands.csv"] = r.commands.t
        odd = list(command_units.command_unit_mistakes(r.commands, design))
        yield from odd
        if not odd:
            unit = "rad" if design.mechanism.kind == "arm" else "m"
            yield from clock_mistakes.speed_mistakes(
                r.commands.t,
                r.commands.values,
                times["frames.csv"],
                unit,
                design.actuator.max_speed if unit == "m" else None,
            )
    if r.sensors is not None:
        times["sensors.csv"] = r.sensors.t
        yield from environment_values.sensor_mistakes(r.sensors, design)
    apart = list(clock_mistakes.time_range_mistakes(times))
    yield from apart
    if r.commands is not None and not apart:
        yield from clock_shift.clock_offset_mistake(times["frames.csv"], r.commands.t, r.commands.values)
    yield from clock_mistakes.repeated_time_mistakes(times["frames.csv"])
    yield from image_folder.unused_cameras(r)
    yield from image_folder.duplicate_images(r)
    yield from image_folder.corners_outside_images(r)
