"""Clocks that count from anywhere: what is read does not depend on it, what is written is by the owner's clock
again.
"""

from decimal import Decimal

import numpy as np
import pytest

from rig.errors import FileError
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin
from rig.recording import recording_folder as recording
from tests.shifted_clock import ORIGINS, counted_from


@pytest.mark.parametrize("origin", [*ORIGINS, "-86400.5", "1700000000.123456789"])
def test_what_is_read_does_not_depend_on_the_origin(recording_folder, tmp_path, origin):
    plain, moved = (
        recording.load_recording(recording_folder),
        recording.load_recording(counted_from(recording_folder, tmp_path / "moved", origin)),
    )
    for a, b in (
        (plain.commands.t, moved.commands.t),
        (plain.exposures.t, moved.exposures.t),
        (plain.sensors.t, moved.sensors.t),
        (plain.commanded()[2], moved.commanded()[2]),
    ):
        np.testing.assert_array_equal(a, b)
    assert moved.commands.t[0] == 0 and Decimal(moved.origin.text(0.0)) == Decimal(origin)


def test_a_measured_recording_keeps_the_owners_clock(recording_folder, tmp_path):
    folder = counted_from(recording_folder, tmp_path / "moved", "1700000000.123456789")
    found = recording.load_recording(folder)
    (tmp_path / "out").mkdir()
    recording.copy_frames_commands_and_sensors(folder, tmp_path / "out", found.exposures, found.origin)
    before, after = (
        [line.split(",")[:3] for line in (part / "frames.csv").read_text().splitlines()]
        for part in (folder, tmp_path / "out")
    )
    assert [[a, Decimal(b), c] for a, b, c in before[1:]] == [[a, Decimal(b), c] for a, b, c in after[1:]]


def test_nanoseconds_of_a_clock_that_counts_from_1970_are_kept():
    origin, texts = TimeOrigin(Decimal("1700000000.000000001")), [f"170000{k:04d}.{k:09d}" for k in range(1, 2000, 7)]
    t = origin.seconds(texts)
    assert [Decimal(origin.text(s)).quantize(Decimal("1e-9")) for s in t] == [Decimal(text) for text in texts]


@pytest.mark.parametrize(("scale", "unit"), [(10**3, "milliseconds"), (10**6, "microseconds"), (10**9, "nanoseconds")])
def test_another_unit_is_named(recording_folder, scale, unit):
    path = recording_folder / "sensors.csv"
    lines = path.read_text().splitlines()
    path.write_text(
        "\n".join(
            [lines[0], *(f"{1700000000 * scale + k},{line.split(',', 1)[1]}" for k, line in enumerate(lines[1:]))]
        )
        + "\n"
    )
    with pytest.raises(FileError, match=unit) as error:
        recording.load_recording(recording_folder)
    assert (error.value.line, error.value.column) == (2, 1)


@pytest.mark.parametrize(("keep", "word"), [(slice(1, 3), "ends"), (slice(-2, None), "begins")])
def test_a_log_that_does_not_cover_the_exposures_is_refused(recording_folder, keep, word):
    path = recording_folder / "sensors.csv"
    lines = path.read_text().splitlines()
    times = [float(line.split(",")[0]) for line in lines[1:]]
    dense = [f"{times[0] + 0.5 * k},{lines[1].split(',', 1)[1]}" for k in range(int(2 * (times[-1] - times[0])) + 1)]
    path.write_text("\n".join([lines[0], *dense]) + "\n")
    assert recording.load_recording(recording_folder).sensors is not None
    path.write_text("\n".join([lines[0], *dense[keep]]) + "\n")
    with pytest.raises(FileError, match=f"the log {word} at"):
        recording.load_recording(recording_folder)
