"""The commands that move struts, against an emulated controller at a pseudo-terminal."""

import contextlib
import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction
from calib.files.calibration_file import save
from rig.driving.controller_lock_and_stop_of_its_holder import ControllerLock
from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import mechanisms
from rig.model.pose import pose_to_vector
from synthetic import random_true_machine_and_truth_file
from tests.cli import run
from tests.conftest import ROOT
from tests.emulated_run import EmulatedRig, runner
from tests.rig.lock_holder import stop_lock_holder


@pytest.fixture(scope="module")
def emulated(tmp_path_factory):
    made = EmulatedRig(tmp_path_factory.mktemp("driving"))
    yield made
    made.close()


@pytest.fixture
def rig(emulated):
    return str(emulated.folder / "rig.toml")


@pytest.fixture
def calibration(emulated, rig):
    """A calibration of a machine that is not quite as stated."""
    nominal = design_from_rig_toml.load_design(rig).mechanism
    fitted = random_true_machine_and_truth_file.random_true_machine(
        design_from_rig_toml.load_design(rig), np.random.default_rng(4)
    ).true.mechanism
    path = emulated.folder / "calibration.json"
    save(
        path,
        Calibration(
            Correction(nominal, fitted, (None,) * 6),
            np.eye(42) * 1e-12,
            np.zeros(6),
            (0,),
            (),
            None,
            {"inputs_sha256": {}},
        ),
    )
    return str(path), fitted


def printed(*words, ok=True):
    """What a command prints, or where it must fail what it complains of."""
    done = run(*words, ok=ok)
    return done.stdout if ok else done.stderr


def test_struts_are_homed_moved_a_little_and_sent_to_a_pose(emulated, rig, calibration):
    path, fitted = calibration
    assert "position not known: home" in printed("status", rig)
    assert "is not known" in printed("jog", rig, "--by", "1", ok=False)
    assert "pose by the nominal model 0.000" in printed("home", rig).replace("-0.000", "0.000")
    lengths = [
        float(x) for x in re.search(r"lengths (.*) mm", printed("jog", rig, "--strut", "3", "--by", "1.5"))[1].split()
    ]
    assert lengths[2] - lengths[0] == pytest.approx(1.5, abs=2e-3)
    assert len(emulated.commanded_goals()) == 1
    wanted = "0.01,0.02,0.44,0.01,0.03,0.05"
    planned = printed("go", path, "--rig", rig, "--pose", wanted, "--dry-run")
    assert len(emulated.commanded_goals()) == 1, "a dry run moves nothing"
    foretold = json.loads(printed("go", path, "--rig", rig, "--pose", wanted, "--dry-run", "--json"))
    assert not foretold["moved"] and "lengths" not in foretold and len(emulated.commanded_goals()) == 1
    assert printed("go", path, "--rig", rig, "--pose", wanted, "--dry-run", "--quiet") == ""
    done = printed("go", path, "--rig", rig, "--pose", wanted)
    assert planned.splitlines()[0] in done
    match = re.search(r"within (\S+) um .*the struts read (\S+) um .*uncertain by (\S+) um", done)
    assert float(match[1]) == pytest.approx(np.hypot(float(match[2]), float(match[3])), rel=0.05)
    assert float(match[3]) > 1.0, "parameters of 1 um each leave more than the struts' read-back does"
    np.testing.assert_allclose(emulated.commanded_goals()[-1], foretold["commanded"], atol=1e-6)
    result = json.loads(printed("go", path, "--rig", rig, "--pose", wanted, "--json"))
    np.testing.assert_allclose(result["lengths"], result["commanded"], atol=1e-6)
    assert result["within"][0] >= 2 * result["uncertainty"][0] > 2e-6
    assert result["moved"] and np.linalg.norm(result["left"][:3]) < 1e-5
    T = mechanisms.kinematics_of(fitted).forward(np.array(emulated.commanded_goals()[-1]), fitted)
    np.testing.assert_allclose(
        pose_to_vector(T), [float(x) for x in wanted.split(",")], atol=3e-6
    )  # micrometres are what the controller takes
    assert "idle" in printed("stop", rig)


def test_what_may_not_be_done_is_refused_before_anything_moves(emulated, rig, calibration, tmp_path):
    printed("home", rig)
    before = len(emulated.commanded_goals())
    for words, why in (
        (("jog", rig, "--by", "500"), "beyond what the struts reach"),
        (("jog", rig, "--strut", "7", "--by", "1"), "--strut takes 1 .. 6"),
        (("jog", rig, "--to", "1,2"), "6 values separated by commas"),
        (("jog", rig, "--by", "1", "--speed", "2"), "share above 0"),
        (("go", calibration[0], "--rig", rig, "--pose", "0,0,0.9,0,0,0"), "cannot be reached"),
        (("go", calibration[0], "--rig", rig, "--pose", "0,0,0.45"), "six figures"),
        (("go", calibration[0], "--rig", rig, "--pose", "-0.5,0,0.45,0,0,0"), "cannot be reached"),
        (
            ("go", calibration[0], "--rig", rig, "--pose", "10,0,450,0,0,5"),
            r"450 m is implausible: poses are in m, rad; --units mm,deg states others",
        ),
        (("run", rig, "--plan", "moving:5", "--out", str(tmp_path / "r")), "while the struts move"),
        (("run", rig, "--plan", "sobol:2", "--out", str(tmp_path / "r"), "--resume"), "no run to resume"),
        (("run", rig, "--plan", "sobol:2", "--out", str(tmp_path / "r"), "--stop-on", "rain"), "--stop-on takes jump"),
        (
            ("run", rig, "--plan", "sobol:2", "--out", str(tmp_path / "r"), "--stop-on", "drift"),
            "--calibration and a --tolerance",
        ),
        (("run", rig, "--plan", "sobol:2", "--out", str(emulated.folder)), "already exists"),
        (
            (
                "run",
                rig,
                "--plan",
                "sobol:2",
                "--out",
                str(tmp_path / "r"),
                "--settle",
                "limbs:1e-6",
                "--exposure",
                "keep",
            ),
            r"\[sensors\] table",
        ),
    ):
        assert re.search(why, printed(*words, ok=False)), words
    assert len(emulated.commanded_goals()) == before


def test_a_controller_that_was_stated_wrongly_says_what_to_look_at(emulated, rig, tmp_path):
    text = Path(rig).read_text()
    assert 'protocol = "grblhal"' in text
    (tmp_path / "rig.toml").write_text(text.replace('protocol = "grblhal"', 'protocol = "gcs"\ntimeout = 0.05'))
    assert "protocol and baudrate in [controller] its own" in printed("status", str(tmp_path / "rig.toml"), ok=False)
    message = printed("status", rig, "--port", "/dev/nowhere", ok=False)
    assert re.fullmatch(
        r"rig status: cannot open /dev/nowhere: No such file or directory; serial ports here: .* \(`rig "
        r"doctor` lists them\)\n",
        message,
    )


def test_a_dry_run_needs_no_machine_and_a_run_leaves_a_recording(emulated, rig, tmp_path):
    out = str(tmp_path / "rec")
    text = printed("run", rig, "--plan", "sobol:3", "--out", out, "--dry-run", "--port", "/dev/nowhere")
    assert "7 steps, 3 frames of 1 camera," in text and "nothing was moved" in text and not (tmp_path / "rec").exists()
    printed("run", rig, "--plan", "sobol:3", "--out", out, "--settle", "time:0", "--exposure", "keep", "--no-measure")
    assert "already exists; --resume continues" in printed("run", rig, "--plan", "sobol:3", "--out", out, ok=False)
    assert "another plan" in printed("run", rig, "--plan", "sobol:4", "--out", out, "--resume", ok=False)
    rows = [json.loads(line) for line in (tmp_path / "rec" / "journal.jsonl").read_text().splitlines()]
    assert [row["kind"] for row in rows].count("exposed") == 3


FLOOD = """
import socket, sys, time
there = []
while True:
    try:
        for k in range(20):
            one = socket.create_connection(("127.0.0.1", int(sys.argv[1])), timeout=5)
            one.sendall(b"GET / HTTP/1.1\\r\\n" + (b"", b"Host: x\\r\\n\\r\\n")[k % 2])
            there.append(one)
        print(len(there), flush=True)
    except OSError:
        break
    del there[:-500]
"""


def test_a_run_goes_on_to_its_end_though_its_page_is_flooded(emulated, rig, tmp_path):
    printed("home", rig)
    log = tmp_path / "log"
    process = runner(
        [
            "run",
            rig,
            "--plan",
            "sobol:6",
            "--out",
            str(tmp_path / "rec"),
            "--settle",
            "time:0.3",
            "--exposure",
            "keep",
            "--no-measure",
            "--page",
        ],
        log,
    )
    while process.is_alive() and not (log.exists() and (port := re.search(r"127.0.0.1:(\d+)/", log.read_text()))):
        process.join(0.01)
    with subprocess.Popen([sys.executable, "-c", FLOOD, port[1]], stdout=subprocess.PIPE) as flood:
        most = 0
        while process.is_alive():
            with contextlib.suppress(OSError):  # it has ended meanwhile
                most = max(most, len(os.listdir(f"/proc/{process.pid}/fd")))
            process.join(0.02)
        flood.kill()
        output = len(flood.stdout.read().split())
    kinds = [json.loads(line)["kind"] for line in (tmp_path / "rec" / "journal.jsonl").read_text().splitlines()]
    assert process.exitcode == 0 and "6 frames in" in log.read_text() and kinds.count("exposed") == 6
    assert kinds.count("departure") == kinds.count("arrival") >= 7, log.read_text()
    assert output and most < 100, "of its files the page has a few, whoever asks"


@pytest.mark.slow
def test_stop_finds_who_drives_from_a_bare_environment(emulated, rig, tmp_path, monkeypatch):
    printed("home", rig)
    before, log = len(emulated.commanded_goals()), tmp_path / "log"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    process = runner(["jog", rig, "--by", "30", "--speed", "0.001"], log)
    while process.is_alive() and len(emulated.commanded_goals()) == before:
        process.join(0.001)
    code = (
        "import sys; sys.path.insert(0, sys.argv.pop(1)); from rig.cli.command_line import main; "
        "sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(ROOT), "stop", rig], env={}, capture_output=True, text=True, cwd="/"
    )
    assert done.returncode == 0 and f"process {process.pid}, which drove them, was stopped" in done.stdout, done.stderr
    process.join(10)
    assert process.exitcode == 128 + signal.SIGTERM


def test_one_process_drives(rig):
    port = design_from_rig_toml.load_design(rig).controller.port
    with ControllerLock(port):
        assert re.search(r"process \d+ is driving", printed("status", rig, ok=False))
        with pytest.raises(RigError, match="is driving"):
            ControllerLock(port)
    assert stop_lock_holder(port, 0.05) is None


def test_a_background_job_that_ignores_ctrl_c_is_stopped(emulated, rig, tmp_path):
    home, log = float(re.search(r"lengths (\S+)", printed("home", rig))[1]), tmp_path / "log"
    before, usual = (
        len(emulated.commanded_goals()),
        signal.signal(signal.SIGINT, signal.SIG_IGN),
    )  # as a shell starts what is to run in the background
    try:
        process = runner(["jog", rig, "--by", "30", "--speed", "0.001"], log)
    finally:
        signal.signal(signal.SIGINT, usual)
    while process.is_alive() and len(emulated.commanded_goals()) == before:
        process.join(0.001)
    assert f"process {process.pid}, which drove them, was stopped" in printed("stop", rig)
    process.join(10)
    assert process.exitcode == 128 + signal.SIGTERM and "ended by signal 15 (SIGTERM, as rig stop" in log.read_text()
    stood = printed("status", rig)
    assert home - 0.01 < float(re.search(r"lengths (\S+)", stood)[1]) < home + 29 and "idle" in stood
    assert printed("status", rig) == stood


def test_a_process_that_does_not_let_go_is_killed():
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_hold, args=(theirs,))
    process.start()
    assert ours.recv() and stop_lock_holder("hung", 0.05) == process.pid
    process.join()
    assert process.exitcode == -signal.SIGKILL and stop_lock_holder("hung", 0.05) is None


def _hold(pipe):
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with ControllerLock("hung"):
        pipe.send(True)
        signal.pause()
