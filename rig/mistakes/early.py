"""All that needs no image looked at: files against each other, figures against what rigs have."""

import tomllib
from collections.abc import Iterator

from rig.mistakes import clocks, environment, folder, lengths, standing, stated
from rig.mistakes.mistake import Mistake, in_order
from rig.outside import read_text
from rig.recording import Recording


def early(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes that a Recording's files show by themselves, in order."""
    return in_order(_all(recording))


def _all(recording: Recording) -> Iterator[Mistake]:
    r, design = recording, recording.design
    yield from stated.written(tomllib.loads(read_text(r.folder / "rig.toml")))
    yield from stated.figures(design)
    yield from environment.surroundings(design)
    times = {"frames.csv": r.exposures.times()[1]}
    if r.commands is not None:
        times["commands.csv"] = r.commands.t
        odd = list(lengths.commands(r.commands, design))
        yield from odd
        if not odd:
            unit = "rad" if design.mechanism.kind == "arm" else "m"
            yield from clocks.pace(r.commands.t, r.commands.values, times["frames.csv"], unit, design.actuator.max_speed if unit == "m" else None)
    if r.sensors is not None:
        times["sensors.csv"] = r.sensors.t
        yield from environment.sensors(r.sensors, design)
    apart = list(clocks.between(times))
    yield from apart
    if r.commands is not None and not apart:
        yield from standing.offset(times["frames.csv"], r.commands.t, r.commands.values)
    yield from clocks.repeated(times["frames.csv"])
    yield from folder.unused(r)
    yield from folder.images(r)
    yield from folder.pixels(r)
