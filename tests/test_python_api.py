"""The Python API: each verb on a small simulated rig, with the results that its command writes; and commands that are
no more than arguments, one call, print and write.
"""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import calib
import rig
import synthetic
import vision
from rig.cli.command_names_groups_summaries_and_exit_statuses import COMMANDS, SHARED_FILES
from rig.cli.command_parser_execution_and_exit_status import command_module_name
from rig.errors import RigError
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording.corner_and_pose_csv_tables import write_poses
from tests import source_trees
from tests.cli import run

CLI = Path(rig.__file__).parent / "cli"
CALLS = {
    **{
        verb: f"calib.api.{verb}:{verb}"
        for verb in ("plan", "calibrate", "correct", "diagnose", "certify", "investigate")
    },
    "check": "calib.api.recording_check_combination_and_view:check",
    "why": "calib.api.why:why",
    **{verb: f"calib.api.verify_and_watch:{verb}" for verb in ("verify", "watch")},
    "simulate": "synthetic.api:simulate",
    "measure": "vision.api:measure",
    "calibrate online": "calib.api.parameter_learning_pose_by_pose_from_recording:learn",
    "correct serve": "calib.api.correction_server_and_move_to_pose:CorrectionServer",
    "limbs test": "calib.api.measuring_limb_acceptance_and_poses_from_readings:accept_limbs",
    "limbs closures": "calib.api.loop_closure_check_of_redundant_legs:close_loops",
    "workspace": "calib.api.workspace_change_by_calibration:analyse_workspace",
    "export": "calib.api.export_calibration_or_recording:export",
    "arm kinematics": "calib.api.arm_kinematics:load_kinematics",
    "arm posture": "rig.posture.best_posture:best_posture",
    "arm wrench": "rig.posture.external_wrench_from_torque_table:measure_wrench",
    "simulate blind": "synthetic.blind_campaign:Campaign",
    "run": "calib.api.execute_plan_at_machine:plan_run",
    "view": "calib.api.recording_check_combination_and_view:view",
    "go": "calib.api.correction_server_and_move_to_pose:plan_pose_move",
    **dict.fromkeys(("home", "jog", "status", "stop"), "rig.driving.driver_opening_and_settling:open_driver"),
    "lens": "vision.lenses.lens_calibration_from_photographs:calibrate_photographs",
    "doctor": "rig.compute.installation_inventory:installation_inventory",
    "effects": "rig.effects.texts.effect_file_from_formula:new_effect_from_suggestion_or_example",
    "effects document": "rig.api:effect_catalogue",
    "doctor kernels": "calib.online.run_options_cameras_sensors_and_observer:compile_kernels_for_run",
    "doctor completion": "rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion:completion_script",
    "print": "synthetic.printable_target_sheets:write_sheets",
    "print check": "vision.printed_marker_size_from_photograph:measure_printed_marker_scale",
    **dict.fromkeys(("new design", "new"), "rig.planning.layout.shipped_arms_and_layouts:new_rig_toml"),
    "import": "rig.api:import_recording",
    "emulate": "rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp:"
    "emulator_of_rig_toml_controller",
    "view index": "rig.report.pages.page_templates_and_index_page:write_index_page",
}  # module:function that does a command's work
STATEMENTS = 35  # of a command's `run` at the most: arguments, one call, print and write
COMPUTING = (
    "calib.certif",
    "calib.models",
    "calib.correct",
    "calib.diagnos",
    "calib.samples",
    "calib.identify",
    "calib.online",
    "vision.bundle",
    "vision.recording",
    "vision.reading",
    "rig.effects.catalogue",
    "rig.effects.framework",
    "rig.model.motion",
    "rig.model.mechanisms",
    "rig.posture",
    "synthetic.recording",
    "numpy.linalg",
    "scipy",
)  # of what a command imports nothing, but for names of types and of what it prints
NOT_COMPUTING = (
    "calib.certificate",
    "diagnosis_sentences_and_table_rows",
    "detectable_size_entries_and_table_rows",
    "Options",
    "DIRECTIONS",
    "AXES",
    "MOVES",
    "_file",
    ": TorqueBounds",
    ": axis_units",
    ": has_links",
    ": require_arm",
    ": Strength",
    ": effect_description",
    ": effect_table",
    "Objective",
)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A folder with a rig, its recordings by the API and a calibration by the API."""
    folder = tmp_path_factory.mktemp("api")
    (folder / "rig.toml").write_text(hexapod_layout_rig_toml(0.3, cameras=2, width=640, height=512, cubes=2))
    first = synthetic.simulate(folder / "rig.toml", synthetic.SimulateOptions(plan="sobol:16", seed=1))
    first.write(folder / "first")
    first.write_truth(folder / "truth.json")
    options = synthetic.SimulateOptions(plan="sobol:20", seed=2, machine=folder / "truth.json")
    synthetic.simulate(folder / "rig.toml", options).write(folder / "second")
    result = calib.calibrate(rig.load(folder / "first"), calib.CalibrateOptions(quick=True))
    calib.save(folder / "calibration.json", result.calibration)
    return folder


def states(result):
    """A result's line and what a notebook shows of it, both of which must be there."""
    assert str(result) and "\n" not in str(result) and result._repr_html_().startswith("<div>")
    assert type(result).__dataclass_params__.frozen
    return str(result)


def test_simulate_makes_what_the_command_writes(world):
    words = ("--plan", "sobol:16", "--seed", 1, "--out", world / "by-command", "--truth", world / "by-command.json")
    run("simulate", world / "rig.toml", *words)
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv", "corners.csv"):
        assert (world / "by-command" / name).read_bytes() == (world / "first" / name).read_bytes(), name
    assert (world / "by-command.json").read_text() == (world / "truth.json").read_text()
    made = synthetic.simulate(world / "rig.toml", synthetic.SimulateOptions(plan="sobol:3"))
    assert states(made).startswith("3 frames over")
    made.write(world / "once")
    made.write(world / "twice")
    assert (world / "once" / "corners.csv").read_bytes() == (world / "twice" / "corners.csv").read_bytes()


def test_load_and_save_keep_a_recording(world):
    recording = rig.load(world / "first", mask="0-3")
    rig.save(recording, world / "saved")
    loaded = rig.load(world / "saved")
    np.testing.assert_array_equal(loaded.exposures.times()[0], recording.exposures.times()[0])
    np.testing.assert_array_equal(loaded.corners.uv, recording.corners.uv)
    np.testing.assert_array_equal(loaded.commands.values, recording.commands.values)
    with pytest.raises(RigError, match="the recording itself"):
        rig.save(recording, world / "first")


def test_plan_of_parts_and_of_parameters_is_what_the_command_writes(world):
    design = rig.load_design(world / "rig.toml")
    parts = rig.plan(design, "axes:3")
    assert states(parts).startswith(f"{len(parts.values)} configurations of axes:3")
    for options, words in (
        (calib.PlanOptions(parts="axes:3"), ("--parts", "axes:3")),
        (calib.PlanOptions(count=7), ("--for", "parameters", "--count", 7)),
    ):
        done = run("plan", world / "rig.toml", *words, "--out", world / "plan.csv", "--json")
        made = calib.plan(design, options)
        made.write(world / "own.csv")
        assert (world / "own.csv").read_bytes() == (world / "plan.csv").read_bytes()
        assert made.tree()["said"] == json.loads(done.stdout)["said"]
        assert states(made) == made.verdict.line
    np.testing.assert_array_equal(calib.plan(design, calib.PlanOptions(parts="axes:3")).values, parts.values)


def test_check_finds_what_the_command_prints(world):
    found = calib.check(world / "first")
    assert json.loads(run("check", world / "first", "--json").stdout) == found.tree()
    assert "good" in states(found) and rig.check(world / "first").usable
    assert not rig.check(world / "nowhere").usable


def test_measure_makes_what_the_command_writes(world):
    result = vision.measure(rig.load(world / "first"))
    done = run("measure", world / "first", "--out", world / "measured", "--json")
    (world / "own").mkdir()
    result.write(world / "own")
    for name in ("rig.toml", "poses.csv", "rpy.csv", "corners.csv", "frames.csv", "commands.csv"):
        assert (world / "own" / name).read_bytes() == (world / "measured" / name).read_bytes(), name
    assert json.loads(done.stdout)["verdict"]["why"] in states(result)
    with pytest.raises(ValueError, match="hold takes"):
        vision.MeasureOptions(hold=("nothing",))


def test_calibrate_makes_what_the_command_writes(world):
    result = calib.calibrate(rig.load(world / "first"), calib.CalibrateOptions(quick=True))
    run("calibrate", world / "first", "--quick", "--out", world / "command.json")
    own, written = (json.loads((world / name).read_text()) for name in ("calibration.json", "command.json"))
    for tree in (own, written):  # the command states its arguments, and both when they were made
        for key in ("arguments", "created"):
            tree["provenance"].pop(key, None)
    assert own == written
    assert states(result) == result.verdict.line
    result.write_summands(world / "own.ksf.csv")
    assert (world / "own.ksf.csv").read_bytes() == (world / "command.ksf.csv").read_bytes()
    with pytest.raises(RigError, match="omit --joint"):
        calib.CalibrateOptions(find=True, joint=True)


@pytest.mark.slow
def test_several_recordings_are_calibrated_together(world):
    lines = []
    both = [rig.load(world / "first"), rig.load(world / "second")]
    result = calib.calibrate(both, calib.CalibrateOptions(quick=True), notice=lines.append)
    assert lines[0].startswith("2 recordings of one rig") and len(result.sampled.samples) > len(
        both[1].exposures.times()[0]
    )


def test_correct_gives_what_the_command_writes(world):
    calibration, home = calib.load(world / "calibration.json"), rig.load_design(world / "rig.toml").mechanism.home
    result = calib.correct(calibration, home)
    write_poses(world / "wanted.csv", result.wanted.poses)
    run("correct", world / "calibration.json", "--poses", world / "wanted.csv", "--out", world / "commands.csv")
    result.write(world / "own-commands.csv")
    assert (world / "own-commands.csv").read_bytes() == (world / "commands.csv").read_bytes()
    assert result.values.shape == (1, 6) and result.covariance.shape == (1, 6, 6)
    assert states(result).startswith("1 of 1 poses")


def test_diagnose_finds_what_the_command_writes(world):
    result = calib.diagnose(rig.load(world / "first"), calib.DiagnoseOptions(only=("backlash",)))
    run("diagnose", world / "first", "--only", "backlash", "--out", world / "diagnosis")
    tree = json.loads((world / "diagnosis" / "diagnosis.json").read_text())
    (world / "found").mkdir()
    result.write(world / "found")
    own = json.loads((world / "found" / "diagnosis.json").read_text())
    assert tree.pop("said") == ["--only backlash"] and own.pop("said") == []
    for one in (own, tree):  # the command looks at the calibrations beside the recording as well
        one.pop("calibrations", None), one.pop("verdict", None)
    assert own == tree
    assert states(result) == result.verdict.line
    assert states(result.next_experiment()).startswith(("nothing is ambiguous", "next: ", "no plan"))


def test_verify_and_certify_state_what_the_commands_print(world):
    calibration, second = calib.load(world / "calibration.json"), rig.load(world / "second")
    verified = calib.verify(calibration, second)
    printed = json.loads(run("verify", world / "calibration.json", world / "second", "--json").stdout)
    assert json.loads(json.dumps(verified.tree())) == printed
    assert states(verified) == verified.verdict.line
    options = calib.CertifyOptions(coverage=0.8, confidence=0.8)
    certified = calib.certify(calibration, second, options)
    words = ("--coverage", 0.8, "--confidence", 0.8, "--out", world / "certificate.json")
    run("certify", world / "calibration.json", world / "second", *words)
    own, tree = certified.tree(), json.loads((world / "certificate.json").read_text())
    assert own["promise"] == tree["promise"] and states(certified) == certified.verdict.line
    assert own["inputs_sha256"].keys() == tree["inputs_sha256"].keys()
    certified.write(world / "certificate.html")
    assert "Certificate of" in (world / "certificate.html").read_text(encoding="utf-8")
    with pytest.raises(RigError, match="took part in fitting"):
        calib.certify(calibration, rig.load(world / "first"))


def test_investigate_waits_for_somebody_by_hand(world):
    from rig.cli import main

    options = calib.InvestigateOptions(by_hand=True, plan="sobol:12")
    result = calib.investigate(world / "rig.toml", world / "asked", main, options)
    assert result.waiting.startswith("to do: carry out") and result.tree()["waiting"] == result.waiting
    with pytest.raises(RigError, match="already exists"):
        calib.investigate(world / "rig.toml", world / "asked", main, options)
    with pytest.raises(RigError, match="12 to 400"):
        calib.InvestigateOptions(verify=3)


def test_options_are_typed_and_frozen():
    for package in (rig, synthetic, vision, calib):
        for name in package.__all__:
            kind = getattr(package, name)
            if name.endswith("Options"):
                assert kind.__dataclass_params__.frozen and "__slots__" in vars(kind), name


def functions(command):
    """(its function that runs, [that and those of its file that it calls, directly or not], the tree of its file)"""
    whole = source_trees.tree(CLI / f"{command_module_name(command)}.py")
    known = {node.name: node for node in whole.body if isinstance(node, ast.FunctionDef)}
    run = known[f"run_{command.split()[-1]}" if command in SHARED_FILES else "run"]
    used, left = [], [run]
    while left:
        used.append(left.pop())
        names = {node.id for node in ast.walk(used[-1]) if isinstance(node, ast.Name)}
        left += [known[name] for name in sorted(names & set(known)) if known[name] not in [*used, *left]]
    return run, used, whole


def call_of(command):
    """(module, function) of the one call of a command."""
    home, _, function = CALLS[command].partition(":")
    return home, function


def test_every_command_has_its_call():
    assert set(CALLS) == set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_is_arguments_one_call_print_and_write(command):
    run, used, whole = functions(command)
    statements = [node for node in ast.walk(run) if isinstance(node, ast.stmt)]
    assert len(statements) <= STATEMENTS, f"{command}: {len(statements)} statements"
    home, function = call_of(command)
    called = [
        node.func.id
        for function_used in used
        for node in ast.walk(function_used)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    ]
    assert called.count(function) == 1, f"{function} is called {called.count(function)} times"
    imports = [node for node in ast.walk(whole) if isinstance(node, ast.ImportFrom)]
    assert any(node.module == home and function in [name.name for name in node.names] for node in imports)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_imports_nothing_that_computes(command):
    _, _, whole = functions(command)
    for_types = {
        inner
        for node in whole.body
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    homes = {call_of(other)[0] for other in COMMANDS if command_module_name(other) == command_module_name(command)}
    computing = [
        f"{node.module}: {name.name}"
        for node in ast.walk(whole)
        if isinstance(node, ast.ImportFrom) and node not in for_types and (node.module or "").startswith(COMPUTING)
        for name in node.names
        if node.module not in homes
    ]
    assert [text for text in computing if not any(word in text for word in NOT_COMPUTING)] == []
