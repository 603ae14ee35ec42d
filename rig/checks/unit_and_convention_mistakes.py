"""Unit and convention mistakes of a recording.

In sensor channels, environment values, commands and poses.
"""

import re
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake
from rig.errors import NotConverged
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod as kinematics
from rig.model.mechanisms import redundant_strut_best_six_legs_and_loop_closures
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links, has_struts, is_redundant
from rig.recording.recording_folder import Commands, Sensors

KELVIN = (200.0, 400.0)
FAHRENHEIT = (48.0, 120.0)  # a room that warm in degrees Celsius is none
COLDEST = -60.0
GRAVITY = (9.75, 9.85)  # m/s^2 on the Earth's surface
HEAVY = 30.0  # times the platform's mass
TON = 2000.0  # kg; no load of a platform on struts whose mass nobody states
TEMPERATURE = re.compile(r"(?i)(^|[_.-])temp(erature?)?[0-9]*([_.-]|$)")  # in a channel's name
WANTED = re.compile(r"(?i)(^|[_.-])(set_?point|setp|set|sp|target|goal|demand|desired|nominal|limit)([_.-]|$)")
COLDER = 0.4  # K by which exchanged channels differ from where they ought to be


def sensor_channel_unit_and_name_mistakes(log: Sensors, design: Design) -> Iterator[Mistake]:
    """Mistakes of units and names of sensor channels in sensors.csv.

    Another unit, or exchanged names.
    """
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
                f"sensors.csv: {name} = {middle:.4g} is not a temperature in degrees Celsius",
                "Look at the channel's unit and wiring",
                False,
                0.6,
            )
    for name in log.channels:
        if TEMPERATURE.search(name) and not WANTED.search(name) and not name.endswith("_temperature_C"):
            places = mechanisms.axis_place_texts(design.mechanism) if design.mechanism.axes else ()
            own = "".join(f" or {place.replace(' ', '')}_temperature_C, of its axis," for place in places[:1])
            yield Mistake(
                f"sensors.csv: {name} is by its name a temperature that no effect follows",
                f"Name it ambient_temperature_C, of the whole machine or its room,{own} in degrees Celsius",
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
            + ("" if room is None else ", the temperature is constant and jumps like a load"),
            "Exchange the two columns' names",
            False,
            0.8,
        )
        return
    most = float(load.max())
    if load.min() < 0:
        yield Mistake(
            f"sensors.csv: payload_mass_kg is negative ({load.min():g} kg)",
            "Tare the scale or correct the sign",
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


def gravity_and_platform_mass_mistakes(design: Design) -> Iterator[Mistake]:
    """Mistakes of gravity and of the platform's mass in a design.

    Gravity of a wrong size or sign, a mass in grams.
    """
    g = np.asarray(design.gravity)
    size = float(np.linalg.norm(g))
    if not GRAVITY[0] <= size <= GRAVITY[1]:
        message = next(
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
            f"rig.toml: gravity is {message}: {size:g}, read as m/s^2",
            "State environment.gravity in m/s^2 in the base frame",
            False,
            0.7,
        )
    home = design.mechanism.home_pose
    if home is not None and size > 0:
        up = home.translation
        if (g @ up) / (size * np.linalg.norm(up)) > 0.5:
            yield Mistake(
                "rig.toml: gravity has the wrong sign: it points from the base to the platform, as in a "
                "hanging machine",
                "Reverse the sign of environment.gravity, unless the machine hangs",
                False,
                0.55,
            )
    mass = design.platform.mass
    if mass is not None and mass > TON:
        yield Mistake(f"rig.toml: platform.mass is in grams: {mass:g} kg is implausible", "State it in kg", False, 0.6)


UNITS = {"millimetres": 1e3, "centimetres": 1e2, "micrometres": 1e6, "inches": 1 / 0.0254}  # per metre
FEW = 1 / 3  # of the axes, beyond whose ranges alone no unit and no origin of all commands leads
PLANNED = 1e-6  # m, to which struts beyond six agree with a stated geometry only where that gave their lengths
LOOKED_AT = 12  # configurations of which that is asked
MUCH = 0.1  # share of commands beyond the range by more than a tenth of it, that is no slip of a limit


def command_unit_mistakes(commands: Commands, design: Design) -> Iterator[Mistake]:
    """Mistakes of the unit of commands.

    Or of their origin, from values (n, axes) outside the design's ranges.
    """
    m = design.mechanism
    if has_links(m):
        yield from _angles(commands.values[:, ~m.slides], m.limits[~m.slides])
        yield from _slides(commands.values[:, m.slides], m.limits[m.slides])
    elif has_struts(m):
        yield from _lengths(commands.values, m.strut_range, mechanisms.kinematics_of(m).home_values(m))
        if is_redundant(m) and m.followers:
            yield from _planned_followers(commands.values, m)


def _planned_followers(q: Floats, hexapod: Hexapod) -> Iterator[Mistake]:
    """Struts that are measured and whose lengths (n, struts) agree with the stated geometry as only planned ones do."""
    lengths = q[np.linspace(0, len(q) - 1, min(len(q), LOOKED_AT)).astype(int)]
    try:
        apart = np.abs(
            redundant_strut_best_six_legs_and_loop_closures.incompatible_strut_length_component(
                kinematics.forward(lengths, hexapod), lengths, hexapod
            )
        ).max()
    except NotConverged:
        return  # what is no pose at all has other reasons
    if apart < PLANNED:
        names = " and ".join(f"l{i + 1}" for i in hexapod.followers)
        yield Mistake(
            f"commands.csv: {names} agree with rig.toml to {apart * 1e6:.2g} um: they are planned, not "
            "read off these struts",
            "Write what these struts measured in these columns; leave them only for a machine simulated without errors",
            False,
            0.9,
        )


def _outside(values: Floats, ranges: Floats) -> Floats:
    """(n, axes) whether values lie outside their ranges (axes, 2) by more than a tenth of these."""
    low, high = ranges.T
    slack = 0.1 * (high - low)
    return (values < low - slack) | (values > high + slack)


def _beyond(values: Floats, ranges: Floats) -> float:
    """Share of the values (n, axes) that lie so."""
    return float(_outside(values, ranges).mean())


def _lengths(q: Floats, ranges: Floats, home: Floats) -> Iterator[Mistake]:
    outside, axes = _beyond(q, ranges), _outside(q, ranges).any(axis=0)
    if outside == 0:
        return
    advice = "commands.csv holds joint centre to joint centre, in metres"
    message = (
        f"{q.min():.6g} to {q.max():.6g}, where rig.toml's strut_range is {ranges.min():.6g} to {ranges.max():.6g} m"
    )
    if axes.mean() <= FEW:
        which = ", ".join(str(k + 1) for k in np.flatnonzero(axes))
        yield Mistake(
            f"commands.csv: lengths of strut {which} alone lie outside strut_range ({outside:.1%} of all): {message}",
            "Check its zero, its strut_range or those rows",
            bool(outside > MUCH),
            0.3,
        )
        return
    for unit, per_metre in UNITS.items():
        if _beyond(q / per_metre, ranges) <= outside / 4:
            yield Mistake(
                f"commands.csv: lengths are in {unit}: {message}",
                f"Divide them by {per_metre:.6g}; {advice}",
                True,
                0.95,
            )
            return
    for text, mended, how in (
        ("relative to home", q + home, "Add each strut's length at home"),
        ("relative to the shortest length", q + ranges[:, 0], "Add each strut's shortest length"),
        ("of the wrong sign", -q, "Reverse their sign"),
        ("relative to home and of the wrong sign", home - q, "Subtract them from each strut's length at home"),
        ("relative to the longest length", ranges[:, 1] - q, "Subtract them from each strut's longest length"),
    ):
        if _beyond(mended, ranges) <= outside / 4:
            yield Mistake(f"commands.csv: lengths are {text}: {message}", f"{how}; {advice}", True, 0.9)
            return
    for unit, per_metre in UNITS.items():
        if (
            _beyond(q / per_metre + home, ranges) <= outside / 4
            and np.ptp(q) > 0.02 * per_metre * np.ptp(ranges, axis=1).min()
        ):
            yield Mistake(
                f"commands.csv: lengths are in {unit} and relative to home: {message}",
                f"Divide them by {per_metre:.6g} and add the home lengths; {advice}",
                True,
                0.9,
            )
            return
    if np.median(np.abs(q)) > 10 * ranges.max():
        yield Mistake(
            f"commands.csv: lengths are in steps or counts: {message}",
            f"Divide them by the steps per metre; {advice}",
            True,
            0.7,
        )
    elif outside > MUCH:
        yield Mistake(
            f"commands.csv: {outside:.0%} of the lengths lie outside strut_range: {message}",
            f"Check the unit, the zero and strut_range; {advice}",
            True,
            0.5,
        )
    else:
        yield Mistake(
            f"commands.csv: some lengths ({outside:.1%}) lie outside strut_range: {message}",
            "Check strut_range or those rows",
            False,
            0.3,
        )


def _slides(q: Floats, limits: Floats) -> Iterator[Mistake]:
    """What an arm's slides (n, k) are commanded beyond their limits (k, 2) m."""
    if not q.size or (outside := _beyond(q, limits)) == 0:
        return
    message = f"{q.min():.6g} to {q.max():.6g}, where rig.toml's limits are {limits.min():.6g} to {limits.max():.6g} m"
    for unit, per_metre in UNITS.items():
        if _beyond(q / per_metre, limits) <= outside / 4:
            yield Mistake(
                f"commands.csv: slides are in {unit}: {message}",
                f"Divide them by {per_metre:.6g}; slides are in metres",
                True,
                0.95,
            )
            return
    yield Mistake(
        f"commands.csv: {outside:.1%} of the slides' positions lie outside the limits: {message}",
        "Check their unit, zeros and limits",
        outside > MUCH,
        0.5 if outside > MUCH else 0.3,
    )


def _angles(q: Floats, limits: Floats) -> Iterator[Mistake]:
    if not q.size:
        return
    outside = _beyond(q, limits)
    message = (
        f"{q.min():.6g} to {q.max():.6g}, where rig.toml's limits are {limits.min():.6g} to {limits.max():.6g} rad"
    )
    if outside > 0 and _beyond(np.radians(q), limits) <= outside / 4 and np.abs(q).max() > 2.5 * np.pi:
        yield Mistake(f"commands.csv: joint angles are in degrees: {message}", "State them in radians", True, 0.95)
    elif outside > MUCH:
        yield Mistake(
            f"commands.csv: {outside:.0%} of the joint angles lie outside the limits: {message}",
            "Check their unit, zeros and limits",
            True,
            0.5,
        )
    elif outside > 0:
        yield Mistake(
            f"commands.csv: some joint angles ({outside:.1%}) lie outside the limits: {message}",
            "Check limits or those rows",
            False,
            0.3,
        )


def poses_in_other_conventions(columns: Floats) -> Iterator[tuple[str, RigidTransform]]:
    """Poses that columns (n, 6) give when they are read in other conventions.

    Returns (convention, RigidTransform (n,))
    """
    p, r = columns[:, :3], columns[:, 3:]
    vectors = Rotation.from_rotvec(r)
    yield "poses are inverted (base in platform)", RigidTransform.from_components(p, vectors).inv()
    yield "rotations are inverted", RigidTransform.from_components(p, vectors.inv())
    yield "rotation vectors are in degrees", RigidTransform.from_components(p, Rotation.from_rotvec(np.radians(r)))
    for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254)):
        yield f"positions are in {unit}", RigidTransform.from_components(p * factor, vectors)
    for degrees, unit in ((False, ""), (True, " in degrees")):
        for seq in ("xyz", "zyx", "XYZ", "ZYX", "zxz", "ZYZ"):
            named = f"{seq.lower()} {'about fixed axes' if seq.islower() else 'about moving axes'}"
            yield (
                f"rotations are Euler angles ({named}{unit}), not rotation vectors",
                RigidTransform.from_components(p, Rotation.from_euler(seq, r, degrees=degrees)),
            )
        yield (
            f"rotations are Euler angles (rz ry rx as columns{unit}), not rotation vectors",
            RigidTransform.from_components(p, Rotation.from_euler("ZYX", r, degrees=degrees)),
        )
    if (np.linalg.norm(r, axis=1) <= 1 + 1e-6).all():
        w = np.sqrt(np.maximum(1 - (r**2).sum(axis=1), 0))
        yield (
            "rotations are the vector part of quaternions, not rotation vectors",
            RigidTransform.from_components(p, Rotation.from_quat(np.column_stack([r, w]))),
        )
    for order, names in (((1, 0, 2), "x and y"), ((0, 2, 1), "y and z"), ((2, 1, 0), "x and z")):
        yield f"{names} of positions are exchanged", RigidTransform.from_components(p[:, order], vectors)
    for axis in range(3):
        turned = p.copy()
        turned[:, axis] *= -1
        yield f"the sign of {'xyz'[axis]} is reversed", RigidTransform.from_components(turned, vectors)
