"""The journal: what was appended is there, a torn end is recognised at every byte, damage is named, and one process
writes.
"""

import os

import pytest

from rig.driving.run_journal import (
    Arrival,
    Began,
    Departure,
    Ended,
    Exposed,
    Journal,
    Readings,
    Remark,
    Resumed,
    journal_line,
    read_journal_rows_and_valid_length,
)
from rig.errors import FileError, RigError

ROWS = [
    Began(0.0, 1.7e9, 2, "ab", (0.4,) * 6),
    Departure(1.0, 0, (0.4,) * 6, (0.41,) * 6),
    Arrival(2.5, 0, (0.41,) * 6, True, ((1.2, 0.1), (2.2, 0.9))),
    Exposed(3.0, 0, 0, (1e-3, 2e-3), ("cam0", "cam1"), ("a.png", "b.png")),
    Readings(3.0, ("ambient_temperature_C",), (20.5,)),
    Remark(3.1, 'covered: "3", größer'),
    Resumed(9.0, (0.41,) * 6, "at its goal"),
    Ended(9.5, ""),
]


def write(path, rows):
    with Journal(path) as journal:
        for row in rows:
            journal.append(row)


def test_rows_come_back_as_they_were(tmp_path):
    write(tmp_path / "j", ROWS[:4])
    write(tmp_path / "j", ROWS[4:])
    assert read_journal_rows_and_valid_length(tmp_path / "j") == (ROWS, os.path.getsize(tmp_path / "j"))


def test_a_file_cut_off_anywhere_keeps_every_whole_row(tmp_path):
    path = tmp_path / "j"
    write(path, ROWS)
    data = path.read_bytes()
    ends = [k + 1 for k, byte in enumerate(data) if byte == ord("\n")]
    for size in sorted(
        {
            *range(0, len(data) + 1, 13),
            *(end + k for end in [0, *ends] for k in (-1, 0, 1) if 0 <= end + k <= len(data)),
        }
    ):
        path.write_bytes(data[:size])
        whole = sum(end <= size for end in ends)
        with Journal(path) as journal:
            assert journal.rows == ROWS[:whole]
            assert journal.torn == size - ([0, *ends][whole])
            journal.append(Ended(10.0, "cut"))
        assert read_journal_rows_and_valid_length(path)[0] == [*ROWS[:whole], Ended(10.0, "cut")]


def test_a_torn_line_of_rubbish_is_taken_away_and_damage_before_rows_is_named(tmp_path):
    path = tmp_path / "j"
    write(path, ROWS)
    data = path.read_bytes()
    path.write_bytes(data[:-20] + b"\x00" * 19 + b"\n")  # a block that was allocated and not yet written
    with Journal(path) as journal:
        assert journal.rows == ROWS[:-1] and journal.torn
    path.write_bytes(data.replace(b'"step": 0', b'"step": 1', 1))
    with pytest.raises(FileError, match="j:2: is damaged"):
        Journal(path)
    path.write_bytes(journal_line(0, ROWS[0]) + journal_line(2, ROWS[1]) + journal_line(2, ROWS[2]))
    with pytest.raises(FileError, match="j:2: is damaged"):
        read_journal_rows_and_valid_length(path)


def test_one_process_at_a_time(tmp_path):
    with Journal(tmp_path / "j"), pytest.raises(RigError, match="another run"):
        Journal(tmp_path / "j")
    Journal(tmp_path / "j").close()


def test_a_full_disk_is_said():
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    journal = object.__new__(Journal)
    journal.path, journal.rows, journal._file = "full", [], os.open("/dev/full", os.O_WRONLY)
    with pytest.raises(RigError, match="No space left"):
        journal.append(ROWS[0])
    journal.close()
