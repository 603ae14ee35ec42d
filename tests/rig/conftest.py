"""Fixtures of the effects' and the driver's tests."""

import numpy as np
import pytest

from rig.model.base_and_link_tilt_sensors import GRAVITY
from rig.model.design import PROTOCOLS
from tests.conftest import ROOT

OWN_PROTOCOL = f"file:{ROOT / 'rig' / 'driving' / 'example_user_protocol_with_emulator.py'}"
EVERY_PROTOCOL = (*PROTOCOLS, OWN_PROTOCOL)


@pytest.fixture(scope="module")
def setting(design):
    """A design with a load, a short path with dwells, reversals and moves, and sensors."""
    from rig.recording.recording_folder import Commands, Sensors

    strokes = design.mechanism.strut_range
    middle, half = strokes.mean(axis=1), np.ptp(strokes, axis=1) / 2
    rng = np.random.default_rng(0)
    t = np.cumsum(np.r_[0.0, rng.uniform(0.5, 4, 60)])
    values = middle + 0.7 * half * rng.uniform(-1, 1, (61, 6))
    values[10:15] = values[10]
    sensors = Sensors(
        np.array([0.0, 1e4]),
        {
            "ambient_temperature_C": np.array([21.0, 25.0]),
            "payload_mass_kg": np.array([0.0, 0.0]),
            **{name: np.full(2, own) for name, own in zip(GRAVITY, design.gravity)},  # as an accelerometer has it
            **{f"strut{i}_temperature_C": np.array([20.0, 20.0 + 4 * i]) for i in range(1, 7)},
        },
    )
    return design, Commands(t, values), np.sort(rng.uniform(1, t[-1], 40)), sensors


@pytest.fixture(params=EVERY_PROTOCOL, ids=[name.rpartition("/")[2] for name in EVERY_PROTOCOL])
def protocol(request):
    """Each protocol that is shipped, and the one in a file of its own that the documents show."""
    return request.param


@pytest.fixture
def ready(driven_design, protocol):
    """(driver, emulator, clock, home lengths) of a rig that is homed."""
    from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
    from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock

    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, protocol, (), 1)
    driver.open()
    driver.home()
    return driver, emulator, clock, home_lengths(driven_design.mechanism)
