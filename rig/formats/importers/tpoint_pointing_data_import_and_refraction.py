"""Import of TPOINT's pointing data, and refraction.

Observed and telescope places of stars are read, and written as a recording of directions.

A file has a caption, option records that begin with a colon, one record of run parameters (latitude in degrees, minutes
and seconds, date, weather), a record for each star, and END; remarks begin with an exclamation mark. Read are three
kinds of star records: with `: ALTAZ` azimuth and elevation in degrees, as observed and of the telescope; otherwise hour
angle and declination in degrees, or apparent right ascension and declination of the star, of the telescope, and the
sidereal time.
Sources: Wallace, TPOINT, a telescope pointing analysis system (the records); Stone, Publ. Astron. Soc. Pacific 108,
1051, 1996 (refraction); Filippenko, Publ. Astron. Soc. Pacific 94, 715, 1982 (the air's refractive index)
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Floats
from rig.errors import FileError
from rig.formats.local_and_remote_input_files import read_text
from rig.formats.output_files import write_text
from rig.recording.corner_and_pose_csv_tables import write_table

LARGEST = 1 << 24  # bytes of a file
HARMLESS = ("NODA", "ALLSKY", "ROTL", "ROTR", "ROTNL", "ROTNR")  # options that do not change what is read here
PLAIN, SEXAGESIMAL = 4, 14  # numbers of a record in degrees, and in hours, minutes and seconds
STEP, REST = 10.0, 4.0  # s from one star to the next, and for which the mount is still; no times are in the file
MARGIN = np.radians(5)  # of the limits beyond the stars that were seen
LOWEST = np.radians(10)  # of refraction's series
ROUNDS = 6


@dataclass(frozen=True, slots=True)
class Weather:
    """temperature : degrees Celsius; pressure : hPa; height : m; humidity : 0 to 1; wavelength : um."""

    temperature: float
    pressure: float
    height: float
    humidity: float
    wavelength: float


@dataclass(frozen=True, slots=True, eq=False)
class PointingData:
    """caption; mount : "altazimuth" or "equatorial"; latitude : rad; star, telescope : (n, 2) rad, as observed and as
    the encoders have it, azimuth and elevation or hour angle and declination; assumed : in sentences
    """

    caption: str
    mount: str
    latitude: float
    star: Floats
    telescope: Floats
    assumed: tuple[str, ...]

    @property
    def base(self) -> Rotation:
        """The mount's base in a frame with x north, y east and z down: q1 and q2 are then the telescope's angles."""
        if self.mount == "altazimuth":
            return Rotation.identity()
        c, s = np.cos(self.latitude), np.sin(self.latitude)
        return Rotation.from_matrix(np.array([[-s, 0, -c], [0, -1, 0], [-c, 0, s]]))

    def directions(self) -> Floats:
        """Unit vectors (n, 3) to the stars as observed, x north, y east, z down."""
        first, second = self.star.T
        level = np.stack([np.cos(second) * np.cos(first), np.cos(second) * np.sin(first), -np.sin(second)], axis=1)
        found: Floats = self.base.apply(level)
        return found


def read_pointing_data(path: str | Path) -> PointingData:
    """Read a TPOINT file as PointingData.

    Raises FileError with the line for a record that is none of those read here, an option that is not known, and
    right ascensions without the weather that refraction takes
    """
    path = Path(path)
    lines = [
        (number, text)
        for number, line in enumerate(read_text(path, LARGEST).splitlines(), 1)
        if (text := line.split("!")[0].strip())
    ]
    end = next((k for k, (_, text) in enumerate(lines) if text.upper() == "END"), len(lines))
    lines = lines[:end]
    if len(lines) < 3:
        raise FileError(path, "is no TPOINT file: it takes a caption, run parameters and a record for each star")
    options = [(number, text[1:].strip().upper()) for number, text in lines[1:] if text.startswith(":")]
    rest = [(number, text.split()) for number, text in lines[1:] if not text.startswith(":")]
    for number, option in options:
        if option not in (*HARMLESS, "ALTAZ", "EQUAT"):
            raise FileError(path, f"option {option!r} is not known, and may change what the records mean", number)
    if len(rest) < 2:
        raise FileError(path, "has no records of stars after its run parameters", lines[-1][0])
    altazimuth = any(option == "ALTAZ" for _, option in options)
    (number, run), *records = rest
    latitude = _angle(path, number, run[:3], np.pi / 180, "latitude")
    weather = _weather(path, number, run)
    if altazimuth:
        star, telescope, assumed = _plain(path, records)
        return PointingData(lines[0][1], "altazimuth", latitude, star, telescope, assumed)
    count = len(records[0][1])
    if PLAIN <= count < SEXAGESIMAL:
        star, telescope, assumed = _plain(path, records)
        return PointingData(lines[0][1], "equatorial", latitude, star, telescope, assumed)
    if weather is None:
        raise FileError(
            path,
            "right ascensions are of places as without air, whose bending takes the weather: state temperature (C), "
            "pressure (hPa), height (m), humidity (0 to 1) and wavelength (um) after latitude and date",
            number,
        )
    star, telescope = _sexagesimal(path, records)
    height = np.pi / 2 - zenith_distances(star, latitude)
    if height.min() < LOWEST:
        low = f"a star stands {np.degrees(height.min()):.1f} degrees high, where the bending by the air is uncertain"
        raise FileError(path, low, records[int(height.argmin())][0])
    star = refracted_hour_angle_and_declination(star, latitude, weather)
    assumed = (
        "right ascensions and declinations of stars are apparent ones, of the date and as without air; how it bends "
        f"light was added for {weather.temperature:g} C and {weather.pressure:g} hPa",
    )
    return PointingData(lines[0][1], "equatorial", latitude, star, telescope, assumed)


def _number(path: Path, line: int, text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise FileError(path, f"{what}: {text!r} is no number", line)
    return value


def _angle(path: Path, line: int, texts: list[str], unit: float, what: str) -> float:
    """rad of degrees or hours, minutes and seconds; unit : rad of one. The sign is that of the first text."""
    if len(texts) < 2:
        raise FileError(path, f"{what} takes degrees or hours, minutes and seconds, not {' '.join(texts)!r}", line)
    first, *smaller = [_number(path, line, text, what) for text in texts]
    if any(not 0 <= value < 60 for value in smaller):
        raise FileError(path, f"{what}: minutes and seconds lie from 0 to 60, not {' '.join(texts)!r}", line)
    size = abs(first) + sum(value / 60 ** (k + 1) for k, value in enumerate(smaller))
    return float(np.copysign(size * unit, -1.0 if texts[0].startswith("-") else 1.0))


def _weather(path: Path, line: int, run: list[str]) -> Weather | None:
    """Weather of the run parameters, after latitude (3) and date (3); None where it is not stated in full."""
    if len(run) < 11:
        return None
    return Weather(*(_number(path, line, text, "weather") for text in run[6:11]))


def _plain(path: Path, records: list[tuple[int, list[str]]]) -> tuple[Floats, Floats, tuple[str, ...]]:
    """(star (n, 2), telescope (n, 2)) rad, of records in degrees, and what was assumed."""
    rows = []
    for line, words in records:
        if not PLAIN <= len(words) < SEXAGESIMAL:  # so many would be hours, minutes and seconds
            _refuse(path, line, words)
        row = [_number(path, line, text, "angle") for text in words[:PLAIN]]
        for value, most in zip(row, (720.0, 90.0, 720.0, 180.0)):
            if abs(value) > most:
                raise FileError(path, f"angle {value:g} is no angle in degrees of a sky", line)
        rows.append(np.radians(row))
    more = max(len(words) for _, words in records) - PLAIN
    assumed = (f"{more} further numbers of the records were not read",) if more else ()
    table = np.array(rows)
    return table[:, :2], table[:, 2:], assumed


def _sexagesimal(path: Path, records: list[tuple[int, list[str]]]) -> tuple[Floats, Floats]:
    """(star (n, 2), telescope (n, 2)) rad, hour angle and declination, of right ascensions and sidereal times."""
    rows = []
    for line, words in records:
        if len(words) != SEXAGESIMAL:
            _refuse(path, line, words)
        hour, degree = np.pi / 12, np.pi / 180
        place = [
            _angle(path, line, words[k : k + 3], unit, what)
            for k, unit, what in (
                (0, hour, "right ascension"),
                (3, degree, "declination"),
                (6, hour, "right ascension of the telescope"),
                (9, degree, "declination of the telescope"),
            )
        ]
        sidereal = _angle(path, line, words[12:], hour, "sidereal time")
        hours = [(sidereal - place[k] + np.pi) % (2 * np.pi) - np.pi for k in (0, 2)]
        hours[1] = hours[0] + (hours[1] - hours[0] + np.pi) % (2 * np.pi) - np.pi
        rows.append([hours[0], place[1], hours[1], place[3]])
    table = np.array(rows)
    return table[:, :2], table[:, 2:]


def _refuse(path: Path, line: int, words: list[str]) -> NoReturn:
    raise FileError(
        path,
        f"a star's record has {PLAIN} numbers in degrees (and perhaps a few more), or {SEXAGESIMAL}: right "
        "ascension and declination of the star and of the telescope, and sidereal time in hours and minutes, and all "
        f"records of a file are alike; this one has {len(words)}",
        line,
    )


def zenith_distances(hour_angles_and_declinations: Floats, latitude: float) -> Floats:
    """Zenith distances (n,) rad of hour angles and declinations (n, 2) rad."""
    hour, declination = hour_angles_and_declinations.T
    up = np.sin(declination) * np.sin(latitude) + np.cos(declination) * np.cos(latitude) * np.cos(hour)
    return np.asarray(np.arccos(np.clip(up, -1, 1)))


def refracted_hour_angle_and_declination(
    hour_angles_and_declinations: Floats, latitude: float, weather: Weather
) -> Floats:
    """Refracted hour angles and declinations (n, 2) rad of stars, as observed through the air.

    Of those without it.

    By the first two terms of refraction in the tangent of the zenith distance, which hold to an arc second above some
    15 degrees
    """
    hour, declination = hour_angles_and_declinations.T
    c, s, zenith = np.cos(latitude), np.sin(latitude), zenith_distances(hour_angles_and_declinations, latitude)
    first, third = refraction_terms(latitude, weather)
    seen = zenith.copy()
    for _ in range(ROUNDS):
        seen = zenith - first * np.tan(seen) - third * np.tan(seen) ** 3
    top = np.array([0.0, s, c])  # the zenith, by west, pole and meridian
    d = np.stack([np.cos(declination) * np.sin(hour), np.sin(declination), np.cos(declination) * np.cos(hour)], axis=1)
    across = d - np.cos(zenith)[:, None] * top
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    d = np.cos(seen)[:, None] * top + np.sin(seen)[:, None] * across
    return np.stack([np.arctan2(d[:, 0], d[:, 2]), np.arcsin(np.clip(d[:, 1], -1, 1))], axis=1)


def refraction_terms(latitude: float, weather: Weather) -> tuple[float, float]:
    """Refraction terms of starlight for a latitude and weather.

    latitude : rad
    Returns (rad of the tangent of the observed zenith distance, rad of its cube)
    """
    t, p, wave = weather.temperature, weather.pressure * 0.750062, weather.wavelength**-2
    vapour = weather.humidity * 4.579 * 10 ** (7.5 * t / (237.3 + t))  # mm of mercury, by Magnus
    index = 64.328 + 29498.1 / (146 - wave) + 255.4 / (41 - wave)
    index *= p * (1 + (1.049 - 0.0157 * t) * 1e-6 * p) / (720.883 * (1 + 0.003661 * t))
    index -= vapour * (0.0624 - 0.000680 * wave) / (1 + 0.003661 * t)
    gamma, beta = index * 1e-6, 0.001254 * (273.15 + t) / 273.15
    heavy = 1 + 0.005302 * np.sin(latitude) ** 2 - 5.83e-6 * np.sin(2 * latitude) ** 2 - 3.15e-7 * weather.height
    return float(heavy * gamma * (1 - beta)), float(-heavy * gamma * (beta - gamma / 2))


def write_pointing_recording(data: PointingData, sigma: float, folder: Path) -> None:
    """Write pointing data as a recording into a folder.

    It is a recording of directions; the folder is empty.
    sigma : rad, noise of a direction along each of two axes
    """
    q, n = data.telescope, len(data.star)
    limits = np.stack([q.min(axis=0) - MARGIN, q.max(axis=0) + MARGIN], axis=1).round(4).tolist()
    joints = "[[0.0, 0.0, 0.0, -1.5707963267948966], [1.5707963267948966, 0.0, 0.0, 1.5707963267948966]]"
    axes = "azimuth, then elevation" if data.mount == "altazimuth" else "hour angle, then declination"
    turn = data.base.as_rotvec().tolist()
    placed = f"\nbase = {{ position = [0.0, 0.0, 0.0], rotvec = {turn} }}" if any(turn) else ""
    name = "".join(letter if letter.isprintable() and letter not in '"\\' else " " for letter in data.caption)
    lines = (
        'schema = "rig/1"',
        f'name = "{name}"',
        "",
        "[environment]",
        "gravity = [0.0, 0.0, 9.80665] # x north, y east, z down",
        "",
        "[mechanism]",
        f'kind = "arm" # {axes}; the telescope points along z',
        f"joints = {joints}",
        f"limits = {limits}{placed}",
        "",
        "[instrument]",
        'kind = "direction"',
        'base = "rig"',
        'tool = "rig"',
        f"rotation_sigma = {sigma!r} # rad",
    )
    write_text(folder / "rig.toml", "\n".join(lines) + "\n")
    write_table(folder / "frames.csv", ("frame", "t", "camera", "image"), [f"{k},{STEP * k + 5:g},," for k in range(n)])
    write_table(
        folder / "commands.csv",
        ("t", "q1", "q2"),
        [
            f"{STEP * k + 5 + side * REST / 2:g},{a:.12f},{b:.12f}"
            for k, (a, b) in enumerate(q.tolist())
            for side in (-1, 1)
        ],
    )
    write_table(
        folder / "poses.csv",
        ("frame", "x", "y", "z"),
        [f"{k},{x:.15f},{y:.15f},{z:.15f}" for k, (x, y, z) in enumerate(data.directions().tolist())],
    )
