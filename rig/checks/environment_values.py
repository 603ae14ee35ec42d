"""Environment values that nature does not have: sensor channels, gravity and masses in wrong units or signs."""

from collections.abc import Iterator

import numpy as np

from rig.array_types import Floats
from rig.checks.mistake import Mistake
from rig.model.design import Design
from rig.recording.recording_folder import Sensors

KELVIN = (200.0, 400.0)
FAHRENHEIT = (48.0, 120.0)  # a room that warm in degrees Celsius is none
COLDEST = -60.0
GRAVITY = (9.75, 9.85)  # m/s^2 on the Earth's surface
HEAVY = 30.0  # times the platform's mass
TON = 2000.0  # kg; no load of a platform on struts whose mass nobody states
COLDER = 0.4  # K by which exchanged channels differ from where they ought to be


def sensor_mistakes(log: Sensors, design: Design) -> Iterator[Mistake]:
    """Mistakes in sensor channels of sensors.csv: another unit, or exchanged names."""
    warm = {name: values for name, values in log.channels.items() if name.endswith("_temperature_C")}
    for name, values in warm.items():
        middle = float(np.median(values))
        if KELVIN[0] < middle < KELVIN[1]:
            yield Mistake(
                f"sensors.csv: {name} is in Kelvin: {middle:.4g} in the middle",
                "Subtract 273.15; temperatures are in degrees Celsius",
                False,
                0.9,
            )
        elif middle < COLDEST or middle >= KELVIN[1]:
            yield Mistake(
                f"sensors.csv: {name} = {middle:.4g} is no temperature in degrees Celsius",
                "Look at the channel's unit and wiring",
                False,
                0.6,
            )
    room = log.channels.get("ambient_temperature_C")
    if room is not None and FAHRENHEIT[0] < np.median(room) < FAHRENHEIT[1]:
        yield Mistake(
            f"sensors.csv: ambient_temperature_C is in Fahrenheit: a room of {np.median(room):.4g} C is implausible, "
            f"{np.median(room):.4g} F is {(np.median(room) - 32) / 1.8:.3g} C",
            "Convert: (F - 32) / 1.8",
            False,
            0.8,
        )
    elif room is not None:
        for name, values in warm.items():
            if (
                values is not room
                and abs((np.median(values) - 32) / 1.8 - np.median(room)) < 8
                and np.median(values) > np.median(room) + 20
            ):
                yield Mistake(
                    f"sensors.csv: {name} is in Fahrenheit: {np.median(values):.4g}, where the room has "
                    f"{np.median(room):.4g} C",
                    "Convert: (F - 32) / 1.8",
                    False,
                    0.75,
                )
        yield from _exchanged(room, warm)
    load = log.channels.get("payload_mass_kg")
    if load is not None:
        yield from _load(load, room, design)


def _exchanged(room: Floats, warm: dict[str, Floats]) -> Iterator[Mistake]:
    """The room warmer than all but one strut, that one colder: struts warm up, rooms do not."""
    struts = {name: float(np.median(v - room)) for name, v in warm.items() if name.startswith("strut")}
    if len(struts) < 3:
        return
    cold = [name for name, above in struts.items() if above < -COLDER]
    spread = sorted(struts.values())
    if len(cold) == 1 and spread[0] < spread[1] - COLDER and np.ptp(spread[1:]) < 3 * (spread[1] - spread[0]) + 2:
        yield Mistake(
            f"sensors.csv: ambient_temperature_C and {cold[0]} are exchanged: the one named {cold[0]} is "
            "colder than all others, the room "
            "warmer than it",
            "Exchange the two columns' names",
            False,
            0.5,
        )


def _load(load: Floats, room: Floats | None, design: Design) -> Iterator[Mistake]:
    if (
        len(load) > 5
        and (np.diff(load) != 0).mean() > 0.5
        and 5 < np.median(load) < 60
        and np.ptp(load) < 15
        and (room is None or (np.diff(room) != 0).mean() < 0.5)
    ):
        yield Mistake(
            "sensors.csv: payload_mass_kg and ambient_temperature_C are exchanged: the load drifts like a temperature"
            + ("" if room is None else ", the temperature stands and jumps like a load"),
            "Exchange the two columns' names",
            False,
            0.8,
        )
        return
    most = float(load.max())
    if load.min() < 0:
        yield Mistake(
            f"sensors.csv: payload_mass_kg is negative ({load.min():g} kg)",
            "Tare the scale or mend the sign",
            False,
            0.7,
        )
    elif most > (HEAVY * design.platform.mass if design.platform.mass else TON):
        yield Mistake(
            f"sensors.csv: payload_mass_kg is in grams: {most:g} kg on a platform"
            + (f" of {design.platform.mass:g} kg" if design.platform.mass else ""),
            "Divide payload_mass_kg by 1000",
            False,
            0.8,
        )


def environment_mistakes(design: Design) -> Iterator[Mistake]:
    """Mistakes in a design's environment: gravity of a wrong size or sign, a platform's mass in grams."""
    g = np.asarray(design.gravity)
    size = float(np.linalg.norm(g))
    if not GRAVITY[0] <= size <= GRAVITY[1]:
        said = next(
            (
                text
                for unit, text in (
                    (1.0, "in units of g"),
                    (9806.65, "in mm/s^2"),
                    (980.665, "in cm/s^2"),
                    (32.174, "in ft/s^2"),
                )
                if abs(size / unit - 1) < 0.02
            ),
            "not the Earth's 9.81 m/s^2",
        )
        yield Mistake(
            f"rig.toml: gravity is {said}: {size:g}", "State environment.gravity in m/s^2 in the base frame", False, 0.7
        )
    home = design.mechanism.home_pose
    if home is not None and size > 0:
        up = home.translation
        if (g @ up) / (size * np.linalg.norm(up)) > 0.5:
            yield Mistake(
                "rig.toml: gravity has the wrong sign: it points from the base to the platform, as in a "
                "hanging machine",
                "Turn the sign of environment.gravity, unless the machine hangs",
                False,
                0.55,
            )
    mass = design.platform.mass
    if mass is not None and mass > TON:
        yield Mistake(f"rig.toml: platform.mass is in grams: {mass:g} kg is implausible", "State it in kg", False, 0.6)
