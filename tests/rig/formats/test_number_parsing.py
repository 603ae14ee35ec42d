"""Numbers are plain decimals wherever text is read, and nothing else that Python takes for one."""

from argparse import ArgumentTypeError

import numpy as np
import pytest

from rig.cli import certify
from rig.cli.command_line import main
from rig.cli.go import parse_pose
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import FileError, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.importers.foreign_table_column_search_and_completion import NUMBER
from rig.formats.numbers_and_units import SI, NotFinite, parse_length_and_angle_units, parse_number, parse_whole_number
from rig.model import calibration_board_layout_and_description_parsing
from rig.recording.frame_selection_and_content_hashes import parse_frame_ranges

NONE = (
    "1_0",
    "1_000.5",
    "\uff11",
    "\u0661",
    "1\u00b2",
    " 1",
    "1 ",
    "1\n",
    "\u00a01",
    "0x10",
    "1e5_0",
    "",
    "+",
    ".",
    "e5",
    "1e",
    "--1",
    "1.2.3",
    "1,5",
    "9" * 101,
    "true",
    "1j",
)
UNBOUNDED = ("nan", "NaN", "-nan", "inf", "-Infinity", "1e999", "-1e400")


@pytest.mark.parametrize(
    ("text", "value"),
    [("1", 1.0), ("-1.5e-3", -1.5e-3), ("+.5", 0.5), ("5.", 5.0), ("0e0", 0.0), ("1E5", 1e5), ("007", 7.0)],
)
def test_plain_decimals_are_numbers(text, value):
    assert parse_number(text) == value


@pytest.mark.parametrize("text", [*NONE, *UNBOUNDED])
def test_anything_else_is_none_wherever_it_stands(text, tmp_path, capsys):
    with pytest.raises(NotFinite if text in UNBOUNDED else ValueError):
        parse_number(text)
    with pytest.raises(ValueError):
        parse_whole_number(text)
    assert not NUMBER["point"].fullmatch(text) or text in UNBOUNDED or len(text) > 100
    with pytest.raises(RigError):
        parse_effect(f"backlash:strut2:gap={text or ' '}")
    with pytest.raises(RigError):
        calibration_board_layout_and_description_parsing.parse_board(f"charuco:8x6:{text}:0.022:DICT_5X5_100")
    for option in ("--speed", "--seed"):
        with pytest.raises(SystemExit):
            main(["emulate", "rig.toml", f"{option}={text}"])
    assert f"argument {option}: invalid" in capsys.readouterr().err
    if text.strip(" \t") == text and "," not in text and "\n" not in text:
        (tmp_path / "t.csv").write_text(f"a,b\n0,1\n{text},1\n", encoding="utf-8")
        with pytest.raises(
            FileError, match="is not finite" if text in UNBOUNDED else "is not a number|is empty|more than any number"
        ) as caught:
            csv_and_parquet_tables_and_time_origin.read_csv_table(tmp_path / "t.csv", ("a", "b")).numbers("a")
        assert caught.value.line == 3


def test_spaces_around_a_cell_are_left_out_and_frames_are_counted_in_ascii(tmp_path):
    (tmp_path / "t.csv").write_text("a\n 1 \n2\t\n")
    assert csv_and_parquet_tables_and_time_origin.read_csv_table(tmp_path / "t.csv", ("a",)).numbers("a").tolist() == [
        1.0,
        2.0,
    ]
    assert parse_frame_ranges(" 3, 7 - 9") == ((3, 3), (7, 9))
    with pytest.raises(RigError):
        parse_frame_ranges("\u0663")


def test_poses_on_the_command_line():
    with pytest.raises(RigError, match="six figures"):
        parse_pose("1_0,2,3,4,5,6", SI)
    found = parse_pose("10,-20,450,0,0,90", parse_length_and_angle_units("mm, deg"))
    assert np.allclose(found.translation, [0.01, -0.02, 0.45]) and np.allclose(
        found.rotation.as_euler("xyz")[2], np.pi / 2
    )
    with pytest.raises(RigError, match="90 rad is implausible"):
        parse_pose("0.1,0,0.45,0,0,90", SI)
    with pytest.raises(RigError, match="x,y,z \\(mm\\) and rx,ry,rz \\(deg\\)"):
        parse_pose("1,2", parse_length_and_angle_units("mm, deg"))


@pytest.mark.parametrize(
    ("read", "good", "bad"),
    [
        (certify.parse_share_between_half_and_one, "0.9999", ("0.4", "1", "1_0")),
        (certify.parse_relative_uncertainty, "0", ("0.1", "-1e-9", "1_0")),
        (certify.parse_rated_load_kg, "12.5", ("1e6", "-1", "1_0", "nan")),
    ],
)
def test_what_a_certificate_is_asked_for_is_a_number_within_its_bounds(read, good, bad):
    assert read(good) == float(good)
    for text in bad:
        with pytest.raises(ArgumentTypeError, match="must be a"):
            read(text)
