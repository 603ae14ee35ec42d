"""The command line itself: help, versions, words mistyped, what is quiet, what is for programs, completion, and the
commands that look around.
"""

import ast
import json
import os
import pty
import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from rig.cli import command_parser_execution_and_exit_status as cli
from rig.cli.command_line import main
from rig.cli.command_names_groups_summaries_and_exit_statuses import COMMANDS, EARLIER_NAMES, GROUPS
from rig.cli.command_parser_execution_and_exit_status import command_line_parser
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import (
    join_options_with_negative_numbers,
    nearest_known_word_if_mistyped,
    parse_length_and_angle,
)
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress, progress_line
from rig.compute import installation_inventory
from rig.effects.catalogue.effect_list import ALL
from rig.errors import RigError
from rig.model.design import PROTOCOLS
from tests.cli import RIG
from tests.conftest import BENCH


@pytest.mark.parametrize(
    "words, says",
    [
        (["mesure"], "did you mean measure?"),
        (["simulat", "rig.toml"], "did you mean simulate?"),
        (["measure", "REC", "--ot", "DIR"], "--ot: did you mean --out?"),
        (["design", "--radius", "300nm"], "argument --radius: expected a length above 0 with its unit"),
        (["design", "--radius", "0.3", "--cameras", "two"], "argument --cameras: invalid whole number value: 'two'"),
        (["measure", "REC", "--out", "DIR", "--skip-unredable"], "--skip-unreadable?"),
        (["xyzzy"], "there is no command 'xyzzy'. `rig --help`"),
    ],
)
def test_a_mistyped_word_is_told_from_what_was_meant(words, says, capsys):
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2 and says in capsys.readouterr().err


@pytest.mark.parametrize(
    "words, joined",
    [
        (["go", "c.json", "--pose", "-0.1,0,0.4,0,0,0"], ["go", "c.json", "--pose=-0.1,0,0.4,0,0,0"]),
        (["jog", "r", "--to", "-.5,2"], ["jog", "r", "--to=-.5,2"]),
        (["jog", "r", "--by", "-0.5"], ["jog", "r", "--by", "-0.5"]),
        (["x", "-1,2"], ["x", "-1,2"]),
        (["x", "--a=1", "-1,2"], ["x", "--a=1", "-1,2"]),
    ],
)
def test_figures_that_begin_with_a_minus_are_no_option(words, joined):
    assert join_options_with_negative_numbers(words) == joined


def test_a_word_that_is_right_or_like_nothing_has_no_other_meant():
    assert (
        nearest_known_word_if_mistyped("measure", COMMANDS) is None
        and nearest_known_word_if_mistyped("qqqq", COMMANDS) is None
        and nearest_known_word_if_mistyped("--skip", ["--skip-unreadable"]) is None
    )


def test_version(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert not end.value.code and capsys.readouterr().out == f"rig {metadata.version('rig')}\n"


def test_help_lists_thirty_commands_in_seven_groups(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    output = capsys.readouterr().out
    assert len(GROUPS) == 7 and len({name.split()[0] for name in COMMANDS}) <= 30
    assert all(f"\n{group}:\n" in output for group in GROUPS) and "3         rig verify" in output
    assert all(re.search(rf"^ +{name.split()[-1]} ", output, re.MULTILINE) for name in COMMANDS)


@pytest.mark.parametrize("earlier, name", EARLIER_NAMES.items())
def test_an_earlier_name_of_a_command_answers_with_the_present_one(earlier, name, capsys, monkeypatch):
    helps = []
    for words in ([earlier], name.split()):
        with pytest.raises(SystemExit) as end:
            main([*words, "--help"])
        helps.append(capsys.readouterr())
        assert not end.value.code
    assert helps[0] == helps[1] and helps[0].out.startswith(f"usage: rig {name} ")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with pytest.raises(SystemExit):
        main([earlier, "--help"])
    assert capsys.readouterr().err == f"rig {earlier} is now `rig {name}`\n"


def test_a_family_without_its_second_word_says_which_there_are(capsys):
    with pytest.raises(SystemExit) as end:
        main(["arm"])
    assert end.value.code == 2
    assert capsys.readouterr().err == "rig arm: error: name what to do: kinematics, posture, wrench\n"


@pytest.mark.parametrize(
    "words, found",
    [
        (("50um", "0.2mrad"), (5e-5, 2e-4)),
        (("0.2mrad", "50um"), (5e-5, 2e-4)),
        (("5e-5", "2e-4"), (5e-5, 2e-4)),
        (("50um", "20um"), "a length and an angle"),
        (("50um", "7"), "is not a tolerance"),
        (("0", "2e-4"), "a length and an angle"),
    ],
)
def test_a_tolerance_is_a_length_and_an_angle_in_any_order(words, found):
    if isinstance(found, str):
        with pytest.raises(RigError, match=found):
            parse_length_and_angle(words)
    else:
        assert parse_length_and_angle(words) == pytest.approx(found)


def test_every_command_has_a_file_and_help():
    chosen = next(action for action in command_line_parser(COMMANDS)._actions if action.dest == "command").choices
    assert set(chosen) == set(COMMANDS) and all(len(sub.format_help()) > 100 for sub in chosen.values())


def test_no_option_takes_a_name_that_the_command_line_sets():
    """What rig/cli/command_parser_execution_and_exit_status.py keeps among the arguments would stand in the place of
    what was asked for."""
    tree = ast.parse(Path(cli.__file__).read_text())
    own = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and isinstance(node.value, ast.Name)
        and node.value.id == "arguments"
    } | {"command", "run"}
    chosen = next(action for action in command_line_parser(COMMANDS)._actions if action.dest == "command").choices
    assert {"argv", "outputs"} < own and [
        (name, action.dest) for name, sub in chosen.items() for action in sub._actions if action.dest in own
    ] == []


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_options(shell, capsys):
    assert main(["doctor", "completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(word in script for name in COMMANDS for word in name.split()) and "skip-unreadable" in script
    program = shutil.which(shell)
    if program:
        assert subprocess.run([program, "-n"], input=script, text=True, capture_output=True).returncode == 0


def test_bash_completes(capsys):
    main(["doctor", "completion", "bash"])
    script = capsys.readouterr().out
    completion_request = "COMP_WORDS=(rig calibrate --anyw); COMP_CWORD=2; _shtab_rig; "
    done = subprocess.run(
        ["bash", "-c", f'{script}\n{completion_request}echo "${{COMPREPLY[@]}}"'], capture_output=True, text=True
    )
    assert done.stdout.split() == ["--anyway"]


def test_the_catalogue_is_a_table_of_all_effects(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    assert main(["effects"]) == 0
    text = capsys.readouterr().out
    assert all(f"\n{effect.name[:17]}" in text for effect in ALL) and max(map(len, text.splitlines())) <= 140
    assert main(["effects", "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in output] == [effect.name for effect in ALL]
    assert all(
        one["exposed_by"] and one["action"] and one["places"] and one["stage"] and "{" not in one["exposed_by"]
        for one in output
    )
    assert {p["unit"] for one in output if one["name"] == "backlash" for p in one["parameters"]} == {"m"}


def test_the_catalogue_is_a_document_of_all_effects(capfd, tmp_path):
    assert main(["catalogue"]) == 0
    text = capfd.readouterr().out
    assert all(f"\n### {effect.name}\n" in text for effect in ALL) and "axiss" not in text and "{" not in text
    assert (
        "![" not in text
        and main(["catalogue", "--out", str(tmp_path / "effects")]) == 1
        and "effects.md" in capfd.readouterr().err
    )
    assert main(["catalogue", "--effects", str(tmp_path / "typo.py")]) == 1 and "typo.py" in capfd.readouterr().err


def test_one_effect_is_told_whole_and_a_mistyped_one_refused(capsys):
    assert main(["effects", "backlash"]) == 0
    text = " ".join(capsys.readouterr().out.split())  # however wide the terminal is
    assert "gap, in m: 5 to 200 µm, bounds 0 to 1 mm; at a joint, in rad: 20 µrad to 5 mrad" in text
    assert "Exposed by:" in text and "--effect backlash:PLACE:gap=" in text
    assert main(["effects", "thermal_expansion"]) == 0
    assert "heat the axes" in capsys.readouterr().out
    assert main(["effects", "backlsh"]) == 1
    assert "did you mean backlash?" in capsys.readouterr().err


def test_doctor_tells_what_is_missing(capsys, monkeypatch):
    monkeypatch.setattr(
        installation_inventory,
        "check_opengl_drawing",
        lambda: installation_inventory.InventoryItem("OpenGL", "absent", "none"),
    )
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "numpy" in text and "cameras" in text and "GB free" in text and "cores" in text
    monkeypatch.setattr(
        installation_inventory.metadata,
        "requires",
        lambda name: ["numpy>=99", "no-such-thing>=1", "nor-this>=2; extra == 'genicam'"],
    )
    assert main(["doctor", "--json"]) == 1
    states = {one["about"]: (one["state"], one["todo"]) for one in json.loads(capsys.readouterr().out)["found"]}
    assert states["numpy"] == ("missing", "rig needs 99 or newer: pip install -U numpy")
    assert states["no-such-thing"] == ("missing", "pip install no-such-thing") and states["nor-this"] == (
        "absent",
        "pip install 'rig[genicam]'",
    )


@pytest.mark.slow
def test_doctor_compiles_what_a_measurement_takes(tmp_path):
    cache = tmp_path / "kernels"
    cache.mkdir(mode=0o700)
    for words in (["kernels", BENCH / "fit" / "rig.toml"], ["kernels", tmp_path / "no.toml"]):
        done = subprocess.run(
            [*RIG, "doctor", *map(str, words)],
            capture_output=True,
            text=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        )
        assert done.returncode == (words[1].name == "no.toml") and not done.stdout, done.stderr
    assert {path.name.partition(".")[2].partition("-")[0] for path in cache.rglob("*.nbi")} >= {
        "fit_squares",
        "refine_pose_in_place",
        "add_pose_to_estimate_in_place",
    }


def test_doctor_names_cameras_without_opening_them(tmp_path):
    (tmp_path / "video0").mkdir()
    (tmp_path / "video0" / "name").write_text("HD cam\n")
    assert (
        installation_inventory.list_video_devices(tmp_path).text == "/dev/video0 (HD cam)"
        and installation_inventory.list_video_devices(tmp_path / "none").state == "absent"
    )


def test_graphics_that_break_are_absent(monkeypatch):
    monkeypatch.setattr(installation_inventory, "CONTEXT", "import os; os.abort()")
    assert installation_inventory.check_opengl_drawing().state == "absent"


def test_new_writes_a_rig_by_options_and_refuses_to_guess(tmp_path, capsys):
    assert main(["new", str(tmp_path / "a"), "--defaults", "--radius", "300mm", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert main(["design", "--radius", "0.3"]) == 0
    assert (tmp_path / "a" / "rig.toml").read_text() == capsys.readouterr().out
    assert "there is no page yet" in (tmp_path / "a" / "index.html").read_text()
    assert main(["new", str(tmp_path / "mm"), "--defaults", "--radius", "300mm", "--units", "mm, deg", "--quiet"]) == 0
    assert main(["design", "--radius", "300mm", "--units", "deg,mm"]) == 0
    text = (tmp_path / "mm" / "rig.toml").read_text()
    assert text == capsys.readouterr().out and 'units = "mm, deg"\n' in text and "edge = 93.0   # mm" in text
    for words, says in (
        (["--radius", "300"], "length above 0 with its unit"),
        (["--mechanism", "hexpod"], "did you mean hexapod?"),
        (["--cameras", "0", "--radius", "1m"], "1 to 20 cameras"),
        (["--size", "big", "--radius", "1m"], "expected for example"),
    ):
        assert main(["new", str(tmp_path / "b"), "--defaults", *words]) == 1
        assert says in capsys.readouterr().err and not (tmp_path / "b").exists()
    assert main(["new", str(tmp_path / "no" / "where"), "--defaults", "--radius", "1m"]) == 1
    assert "no folder" in capsys.readouterr().err
    (tmp_path / "a" / "rig.toml").write_text("x")
    assert (
        main(["new", str(tmp_path / "a"), "--defaults", "--radius", "1m"]) == 1
        and (tmp_path / "a" / "rig.toml").read_text() == "x"
    )


def test_new_asks_four_questions_at_a_terminal(tmp_path):
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*RIG, "new", str(tmp_path / "n")], stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    os.write(ours, b"hexapot\n\n250mm\n2\n640x480\n")
    out, err = process.communicate(timeout=60)
    os.close(ours)
    os.close(theirs)
    assert process.returncode == 0 and err.count("?") == 6 and "did you mean hexapod?" in err
    assert "written" in out and (tmp_path / "n" / "rig.toml").read_text().count("[[camera]]") == 2


def test_nobody_to_ask_is_an_error_that_names_the_option():
    done = subprocess.run([*RIG, "new", "/tmp"], stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert done.returncode == 1 and "give --mechanism or --defaults" in done.stderr


def test_lines_tell_the_time_left(monkeypatch, capsys):
    monkeypatch.setattr(Progress, "shown", "lines")
    progress = Progress(every=0.0)
    progress("locating", 0, 4)
    progress("locating", 1, 4)
    progress("locating", 4, 4)
    error_text = capsys.readouterr().err.splitlines()
    assert error_text[::2] == ["locating: 0 of 4, 0 %", "locating: 4 of 4, 100 %"] and error_text[1].startswith(
        "locating: 1 of 4, 25 %, about 0 s left"
    )
    assert progress_line("fitting", 10, 100, 30.0) == "fitting: 10 of 100, 10 %, about 4 min left"
    assert progress_line("fitting", 50, 100, 30.0) == "fitting: 50 of 100, 50 %, about 30 s left"


def test_lines_come_seldom_and_none_means_none(monkeypatch, capsys):
    monkeypatch.setattr(Progress, "shown", "lines")
    progress = Progress(every=60.0)
    progress("locating", 1, 4)
    monkeypatch.setattr(Progress, "shown", "none")
    Progress(silent=0.0)("locating", 1, 4)
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_plans_and_exports_are_told_to_programs(tmp_path, capsys):
    rig, plan = str(BENCH / "fit" / "rig.toml"), str(tmp_path / "plan.csv")
    assert main(["plan", rig, "--parts", "axes:2", "--out", plan, "--json"]) == 0
    out, words = capsys.readouterr()
    result = json.loads(out)
    rows = np.loadtxt(plan, delimiter=",", skiprows=1)
    assert (
        result["schema"] == "planned/1"
        and result["state"] == "good"
        and result["axes"] == [f"l{k}" for k in range(1, 7)]
        and result["why"] in words
    )
    np.testing.assert_allclose(result["values"], rows[:, 1:], atol=1e-6)
    assert main(["export", rig, "--format", "json", "--out", str(tmp_path / "g.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "schema": "exported/1",
        "format": "json",
        "out": str(tmp_path / "g.json"),
        "left_out": [],
    }
    assert (
        main(["export", rig, "--format", "json", "--json"]) == 1
        and "name a file or a folder with --out" in capsys.readouterr().err
    )
    assert main(["export", rig, "--format", "json", "--quiet"]) == 0 and json.loads(capsys.readouterr().out)
    assert main(["plan", rig, "--parts", "axes:2", "--out", plan, "--quiet"]) == 0 and capsys.readouterr().out == ""


def test_what_is_wrong_with_a_recording_is_told_to_programs(tmp_path, capsys):
    assert main(["check", str(BENCH / "fit"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"schema": "check/1", "usable": True, "found": [], "remarks": []}
    (tmp_path / "rec").mkdir()
    assert main(["check", str(tmp_path / "rec"), "--json"]) == 1
    output = json.loads(capsys.readouterr().out)
    assert not output["usable"] and "rig.toml" in output["found"][0]["what"]


@pytest.mark.slow
def test_quiet_commands_keep_the_result_that_was_asked_for(tmp_path, capsys):
    assert main(["check", str(BENCH / "fit"), "--quiet"]) == 0 and capsys.readouterr().out == ""
    assert (
        main(["check", str(BENCH / "fit"), "--quiet", "--json"]) == 0 and json.loads(capsys.readouterr().out)["usable"]
    )
    assert main(["design", "--radius", "0.3", "--quiet"]) == 0 and "[[camera]]" in capsys.readouterr().out
    assert (
        main(["design", "--radius", "0.3", "--quiet", "--out", str(tmp_path / "rig.toml")]) == 0
        and capsys.readouterr().out == ""
    )


def test_help_of_every_command_opens_no_library():
    code = (
        "import sys; from rig.cli.command_parser_execution_and_exit_status import command_line_parser\n"
        "from rig.cli.command_names_groups_summaries_and_exit_statuses import COMMANDS; command_line_parser(COMMANDS)\n"
        "print(sorted({'scipy', 'cv2', 'numba', 'matplotlib', 'pyrender', 'serial', 'shtab'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


def test_the_emulators_protocols_are_those_of_rig_toml():
    from rig.cli import emulate

    assert emulate.PROTOCOLS == PROTOCOLS
