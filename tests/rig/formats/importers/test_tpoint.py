"""Files of TPOINT: written by other formulas, imported, and calibrated to the terms that they were made with."""

import numpy as np
import pytest

from calib.api.calibrate import CalibrateOptions, calibrate
from calib.models.arm.mount_pointing_terms import ARCSEC
from rig.errors import FileError
from rig.formats.importers.tpoint_pointing_data_import_and_refraction import (
    Weather,
    read_pointing_data,
    refraction_terms,
)
from rig.recording import recording_folder
from tests.cli import run
from tests.truth import pointing as truth

LATITUDE = np.radians(-(31 + 16 / 60 + 37 / 3600))
RUN = "-31 16 37 2026 11 21"
WEATHER = RUN + " 10.0 890.0 1149 0.0 0.5893 0.0065"
ALTAZIMUTH = {"IA": 60, "IE": -80, "CA": 40, "NPAE": -50, "AN": 70, "AW": -30, "TF": 45}  # arcsec
EQUATORIAL = {"IH": 30, "ID": -40, "CH": 25, "NP": -20, "MA": 35, "ME": -15}


def rad(terms):
    return {name: value * ARCSEC for name, value in terms.items()}


def parts(value, digits=4):
    """Text of degrees or hours, minutes and seconds."""
    left = round(abs(value) * 3600, digits)
    sign = "-" if value < 0 else "+"
    return f"{sign}{int(left // 3600):02d} {int(left // 60) % 60:02d} {left % 60:.{digits}f}"


def altazimuth_file(path, seed, count=60):
    rng = np.random.default_rng(seed)
    q = np.stack([rng.uniform(0, 2 * np.pi, count), np.radians(rng.uniform(15, 80, count))], axis=1)
    star = np.degrees(np.stack(truth.altazimuth(*q.T, rad(ALTAZIMUTH)), axis=1))
    star += np.degrees(ARCSEC) * rng.normal(size=star.shape) / np.stack([np.cos(q[:, 1]), np.ones(count)], axis=1)
    rows = [" ".join(f"{x:.7f}" for x in (*s, *np.degrees(c))) + " 12.5 aux" for s, c in zip(star, q)]
    path.write_text("\n".join(["! remark", "Some telescope", ": ALTAZ", ": NODA", RUN, *rows, "END", "after"]) + "\n")


EARTH, INDEX = 6.378e6, 2.771e-4  # m; of dry air at 15 C and 1013.25 hPa for the D lines of sodium, less one


def bent(heights, weather):
    """(n,) rad by which air of one temperature, thinner with its height, lifts stars that are seen at heights (n,) rad.

    By Snell's law along the ray, layer for layer
    """
    kelvin = 273.15 + weather.temperature
    thinning = 8.31446 * kelvin / (0.0289644 * 9.80665)  # m, in which air loses all but 1/e of its density
    h = thinning * -np.log(np.linspace(1, 1e-7, 20001))
    n = 1 + INDEX * weather.pressure / 1013.25 * 288.15 / kelvin * np.exp(-h / thinning)
    sine = np.cos(heights)[:, None] * n[0] * EARTH / (n * (EARTH + h))
    tangent = sine / np.sqrt(1 - sine**2)
    return -((tangent[:, 1:] + tangent[:, :-1]) / 2 * np.diff(np.log(n))).sum(axis=1)


def equatorial_file(path, seed, count=60):
    """Right ascensions of stars without the air, which lifts them to where they are seen."""
    rng, weather = np.random.default_rng(seed), Weather(10.0, 890.0, 1149, 0.0, 0.5893)
    rows = []
    while len(rows) < count:
        h, d = rng.uniform(-1.2, 1.2), rng.uniform(-1.3, 0.4)
        hour, declination = truth.equatorial(np.array([h]), np.array([d]), rad(EQUATORIAL))
        x, y, z = truth.to_horizon(hour, declination, LATITUDE)[0]
        height = np.arcsin(-z)
        if height < np.radians(35):
            continue
        lower = height - bent(np.array([height]), weather)[0]
        level = np.cos(lower) / np.cos(height)
        up, north, east = np.sin(lower), x * level, y * level
        s, c = np.sin(LATITUDE), np.cos(LATITUDE)
        dec = np.arcsin(up * s + north * c)
        ha = np.arctan2(-east, up * c - north * s)
        lst = rng.integers(0, 24 * 60) / 60
        noise = ARCSEC * rng.normal(size=2)
        ra = (lst - (ha + noise[0] / np.cos(dec)) * 12 / np.pi) % 24
        raw = (lst - h * 12 / np.pi) % 24
        star = f"{parts(ra, 5)[1:]} {parts(np.degrees(dec + noise[1]))}"
        rows.append(f"{star} {parts(raw, 5)[1:]} {parts(np.degrees(d))} {int(lst)} {lst % 1 * 60:.4f}")
    path.write_text("\n".join(["Some telescope", ":NODA", ":EQUAT", WEATHER, *rows, "END"]) + "\n")


@pytest.mark.parametrize("write, terms", [(altazimuth_file, ALTAZIMUTH), (equatorial_file, EQUATORIAL)])
def test_a_file_is_imported_and_its_terms_are_found(tmp_path, write, terms):
    write(tmp_path / "point.dat", 3)
    run("import", "--tpoint", str(tmp_path / "point.dat"), "--sigma", "1arcsec", "--out", str(tmp_path / "REC"))
    found = calibrate(recording_folder.load_recording(tmp_path / "REC"), CalibrateOptions(quick=True)).pointing_terms
    assert set(terms) == set(found.names)
    off = {name: value / ARCSEC - terms[name] for name, value in zip(found.names, found.values)}
    spread = dict(zip(found.names, found.sigma / ARCSEC))
    print({name: f"{off[name]:.2f} +- {spread[name]:.2f}" for name in off})
    assert all(abs(off[name]) < 4 * spread[name] + 0.3 for name in off)


def test_refraction_agrees_with_rays_through_layers():
    weather, heights = Weather(10.0, 1010.0, 0.0, 0.0, 0.5893), np.radians([80, 60, 45, 30, 20, 15])
    first, third = refraction_terms(np.radians(45), weather)
    tangent = 1 / np.tan(heights)
    found = first * tangent + third * tangent**3
    np.testing.assert_allclose(found, bent(heights, weather), rtol=4e-3)
    moist = refraction_terms(np.radians(45), Weather(20.0, 1010.0, 0.0, 1.0, 0.5893))[0]
    dry = refraction_terms(np.radians(45), Weather(20.0, 1010.0, 0.0, 0.0, 0.5893))[0]
    assert 0.05 * ARCSEC < dry - moist < 0.5 * ARCSEC


@pytest.mark.parametrize(
    "was, now, says",
    [
        (": ALTAZ", ": GIMBAL", "option 'GIMBAL' is not known"),
        (": ALTAZ", ": EQUAT", ""),
        ("-31 16 37", "-31 76 37", "minutes and seconds lie from 0 to 60"),
        ("-31 16 37", "x 16 37", "'x' is no number"),
        ("END", "1 2 3\nEND", "this one has 3"),
        ("END", "1 30 0 -40 0 0 1 30 0 -40 0 0 2 15\nEND", "all records of a file are alike; this one has 14"),
        ("END", "10 95 10 40\nEND", "no angle in degrees of a sky"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, was, now, says):
    altazimuth_file(tmp_path / "point.dat", 4, 5)
    text = (tmp_path / "point.dat").read_text()
    (tmp_path / "point.dat").write_text(text.replace(was, now, 1))
    if not says:
        assert read_pointing_data(tmp_path / "point.dat").mount == "equatorial"
        return
    with pytest.raises(FileError, match=says):
        read_pointing_data(tmp_path / "point.dat")


def test_right_ascensions_take_the_weather_and_stars_that_stand_high(tmp_path):
    equatorial_file(tmp_path / "point.dat", 5, 3)
    text = (tmp_path / "point.dat").read_text()
    (tmp_path / "point.dat").write_text(text.replace(WEATHER, RUN))
    with pytest.raises(FileError, match="takes the weather"):
        read_pointing_data(tmp_path / "point.dat")
    (tmp_path / "point.dat").write_text(text.replace("-31 16 37", "+70 16 37"))
    with pytest.raises(FileError, match="the air is uncertain"):
        read_pointing_data(tmp_path / "point.dat")


def test_the_command_takes_the_noise_and_nothing_else(tmp_path):
    altazimuth_file(tmp_path / "point.dat", 6, 5)
    words = ["import", "--tpoint", str(tmp_path / "point.dat"), "--out", str(tmp_path / "REC")]
    assert "takes --sigma" in run(*words, ok=False).stderr
    assert "takes --sigma" in run(*words, "--sigma", "3um", ok=False).stderr
    assert "alone" in run(*words, "--sigma", "3arcsec", "--rig", "rig.toml", ok=False).stderr
    assert not (tmp_path / "REC").exists()
