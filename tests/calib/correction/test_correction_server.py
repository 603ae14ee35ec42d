"""The server of corrected commands: answers of `rig correct` to the last bit, on the loopback alone, whatever comes."""

import json
import re
import signal
import socket
import subprocess
import sys
import textwrap
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.api import correction_server_and_move_to_pose
from calib.api.correct import CorrectOptions, correct
from calib.api.correction_server_and_move_to_pose import CLIENTS, CorrectionServer, correction_server_answer
from calib.files import calibration_file
from rig.cli.command_line import main
from rig.errors import RigError
from rig.model.mechanisms import hexapod
from rig.model.pose import pose, pose_to_vector
from rig.recording.corner_and_pose_csv_tables import Poses
from rig.recording.wanted_poses_and_roll_pitch_yaw import WantedPoses
from tests.calib.controllers_in_c import CALIBRATIONS, WARM, sensors_of, wanted
from tests.cli import RIG

KINDS = ("simplices", "all", "pose maps")


class Named(dict):
    """Calibrations by name, which a failure does not print."""

    def __repr__(self):
        return "calibrations"


@pytest.fixture(scope="module")
def calibrations(design):
    return Named({name: CALIBRATIONS[name](design) for name in KINDS})


class Client:
    """A client as its manual shows one."""

    def __init__(self, address):
        self.socket = socket.create_connection(address, timeout=20)
        self.lines = self.socket.makefile("rwb")

    def send(self, line):
        self.lines.write(line)
        self.lines.flush()

    def ask(self, line):
        """The answer to bytes, or to an object of JSON."""
        self.send(line if isinstance(line, bytes) else json.dumps(line).encode() + b"\n")
        return json.loads(self.lines.readline())

    def close(self):
        self.lines.close()
        self.socket.close()


@pytest.fixture(scope="module")
def served(calibrations):
    """{name: address}, a server for each."""
    ended, servers, threads = threading.Event(), {}, []
    for name, calibration in calibrations.items():
        servers[name] = CorrectionServer(calibration)
        threads.append(threading.Thread(target=servers[name].serve, args=(lambda: not ended.is_set(),)))
        threads[-1].start()
    yield {name: server.address for name, server in servers.items()}
    ended.set()
    for thread, server in zip(threads, servers.values()):
        thread.join(10)
        server.close()
        assert not thread.is_alive()


@pytest.fixture
def client(served):
    with closing(Client(served["simplices"])) as made:
        yield made


def same(found, done):
    """Whether an answer holds exactly what `correct` gives: of all that is no refusal."""
    at = done.index.tolist()
    assert [i for i, one in enumerate(found["commands"]) if one is not None] == at
    assert [found["commands"][i] for i in at] == done.values.tolist()
    assert [found["poses"][i] for i in at] == pose_to_vector(done.commanded.T_base_platform).tolist()
    covariance = done.covariance
    assert [found["covariance"][i] for i in at] == ([None] * len(at) if covariance is None else covariance.tolist())
    assert [(r["pose"], r["reason"]) for r in found["out_of_reach"]] == sorted(done.out_of_reach)
    return True


coordinates = st.tuples(*[st.floats(-0.05, 0.05)] * 2, st.floats(0.40, 0.50), *[st.floats(-0.3, 0.3)] * 3)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
@given(vectors=st.lists(coordinates, min_size=1, max_size=6), first=st.integers(0, 3), warm=st.booleans())
@settings(max_examples=40, deadline=None)
def test_random_poses_are_answered_as_rig_correct_does(design, calibrations, served, name, vectors, first, warm):
    calibration, rows = calibrations[name], np.array(vectors)
    start = hexapod.home_values(design.mechanism) + 1e-3 * first
    request = {"id": [first, name], "poses": rows.tolist(), "start": start.tolist()}
    sensors = sensors_of(calibration) if warm else None
    if warm:
        request["sensors"] = WARM
    with closing(Client(served[name])) as client:
        found = client.ask(request)
    assert found["id"] == [first, name] and "error" not in found, found
    try:
        T = pose(rows[:, :3], rows[:, 3:])
        options = CorrectOptions(sensors, start, skip_unreachable=True)
        done = correct(calibration, WantedPoses(Poses(np.arange(len(rows)), T, None)), options)
    except RigError as error:
        assert found["commands"] == [None] * len(rows) and len(found["out_of_reach"]) == len(rows)
        assert all(one["reason"] in str(error) for one in found["out_of_reach"])
        return
    assert same(found, done)


def test_the_command_line_gives_the_same_numbers(design, calibrations, tmp_path, capsys):
    vectors = pose_to_vector(wanted(design, 60, fill=1.02)).tolist()
    rows = [f"{i}," + ",".join(map(repr, row)) for i, row in enumerate(vectors)]
    (tmp_path / "poses.csv").write_text("\n".join(["frame,x,y,z,rx,ry,rz", *rows, ""]))
    calibration_file.save(tmp_path / "c.json", calibrations["all"])
    words = ["correct", str(tmp_path / "c.json"), "--poses", str(tmp_path / "poses.csv"), "--out"]
    assert main([*words, str(tmp_path / "out.csv"), "--skip-unreachable", "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    found = correction_server_answer(
        calibration_file.load(tmp_path / "c.json"), json.dumps({"poses": vectors}).encode()
    )
    found = json.loads(json.dumps(found))
    assert [found["commands"][one["frame"]] for one in output["commands"]] == [
        one["values"] for one in output["commands"]
    ]
    assert found["out_of_reach"] == [{"pose": one["frame"], "reason": one["reason"]} for one in output["out_of_reach"]]
    assert 0 < len(found["out_of_reach"]) < 60 and set(found["not_logged"]) == set(WARM)


@pytest.mark.parametrize(
    "line, named",
    [
        (b"\n", "no JSON: Expecting value at column 1"),
        (b'{"poses": [[0, 0, 0.45, 0, 0, 0]}\n', "no JSON: Expecting ',' delimiter at column 33"),
        (b"\xff\xfe\n", "no JSON: 'utf-8' codec"),
        (b"[" * 200_000 + b"\n", "no JSON: maximum recursion depth"),
        (b"GET / HTTP/1.1\r\n", "no JSON"),
        (b"[1]\n", "a request is an object of JSON with id, poses, start, sensors, not list"),
        (b'{"pose": [[0, 0, 0.45, 0, 0, 0]]}\n', "the key 'pose' is not known; known are id, poses"),
        (b"{}\n", "poses must be a list of poses"),
        (b'{"poses": []}\n', "poses must be a list of poses"),
        (b'{"poses": [[0, 0, 0.45, 0, 0]]}\n', "poses[0] must be a list of 6 numbers, not 5 entries"),
        (b'{"poses": [[0, 0, 0.45, 0, 0, 0], 7]}\n', "poses[1] must be a list of 6 numbers, not int"),
        (b'{"poses": [[0, 0, "a", 0, 0, 0]]}\n', 'poses[0][2] must be a finite number, not "a"'),
        (b'{"poses": [[0, 0, true, 0, 0, 0]]}\n', "poses[0][2] must be a finite number, not true"),
        (b'{"poses": [[0, 0, NaN, 0, 0, 0]]}\n', "NaN is no number of JSON"),
        (b'{"poses": [[0, 0, 1e999, 0, 0, 0]]}\n', "poses[0][2] must be a finite number, not Infinity"),
        (b'{"poses": [[0, 0, 1' + b"0" * 400 + b", 0, 0, 0]]}\n", "poses[0][2] must be a finite number, not 1000"),
        (b'{"poses": [[0, 0, 450, 0, 0, 0]]}\n', "poses[0] is 450 m from the base: poses are in metres"),
        (b'{"poses": [[0, 0, 0.45, 0, 1e200, 0]]}\n', "poses[0] turns by"),
        (b'{"poses": [[0, 0, 0.45, 0, 0, 0]], "start": [1]}\n', "start must be a list of 6 numbers, not 1 entries"),
        (b'{"poses": [[0, 0, 0.45, 0, 0, 0]], "start": [9,9,9,9,9,9]}\n', "--start is invalid: the start: strut 1"),
        (b'{"poses": [[0, 0, 0.45, 0, 0, 0]], "sensors": 3}\n', "sensors must be an object of channels and values"),
        (b'{"poses": [[0, 0, 0.45, 0, 0, 0]], "sensors": {"a": null}}\n', "sensors['a'][0] must be a finite number"),
    ],
)
def test_a_bad_line_is_answered_and_the_connection_goes_on(client, line, named):
    found = client.ask(line)
    assert named in found["error"] and set(found) == {"id", "error"}
    assert client.ask({"id": 5, "poses": [[0, 0, 0.45, 0, 0, 0]]})["id"] == 5


def test_an_error_bears_the_requests_id(client):
    assert client.ask({"id": {"a": 1}, "poses": 4})["id"] == {"a": 1}


def test_too_long_a_line_is_an_error_and_no_more(client, monkeypatch):
    monkeypatch.setattr(correction_server_and_move_to_pose, "LONGEST", 1000)
    assert "at most 1000 bytes" in client.ask(b"x" * 5000 + b"\n")["error"]
    assert client.ask({"id": 1, "poses": [[0, 0, 0.45, 0, 0, 0]]})["commands"][0] is not None


def test_a_fault_of_the_program_is_an_answer_and_its_traceback_is_printed(calibrations, monkeypatch, capsys):
    monkeypatch.setattr(correction_server_and_move_to_pose, "correct", lambda *_: 1 / 0)
    found = correction_server_answer(calibrations["simplices"], b'{"id": 3, "poses": [[0, 0, 0.45, 0, 0, 0]]}')
    assert found == {"id": 3, "error": "a fault of this program, ZeroDivisionError: division by zero"}
    assert "Traceback" in capsys.readouterr().err


@given(
    line=st.binary(max_size=200)
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=7) | st.dictionaries(st.sampled_from(["id", "poses", "start", "x"]), inner)
        ),
    ).map(lambda tree: json.dumps(tree).encode())
)
@settings(max_examples=200, deadline=None)
def test_no_line_is_without_an_answer(calibrations, line):
    found = correction_server_answer(calibrations["simplices"], line)
    assert ("error" in found) != ("commands" in found) and "a fault of this program" not in found.get("error", "")


def test_several_clients_each_get_their_own_answers(design, calibrations, served):
    T = wanted(design, 30)
    rows, done, wrong = pose_to_vector(T), correct(calibrations["simplices"], T), []

    def ask(k):
        with closing(Client(served["simplices"])) as client:
            for i in range(k, 30, 6):
                found = client.ask({"id": i, "poses": [rows[i].tolist()]})
                if found["id"] != i or np.abs(found["commands"][0] - done.values[i]).max() > 1e-14:
                    wrong.append(i)

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert not wrong and not any(thread.is_alive() for thread in threads)


def test_the_documented_client_gets_its_commands(served, capsys):
    text = (Path(__file__).parents[3] / "docs" / "controllers.md").read_text()
    block = re.search(r"^    import json, socket\n.*?^    print.*?\n", text, re.MULTILINE | re.DOTALL).group()
    exec(textwrap.dedent(block).replace("5050", str(served["simplices"][1])), {})
    assert re.fullmatch(r"\[(0\.4\d+(, )?){6}\] \[\]\n", capsys.readouterr().out)


def test_one_client_too_many_is_let_go_with_an_error(served):
    many = [Client(served["pose maps"]) for _ in range(CLIENTS)]
    try:
        assert "error" in many[-1].ask(b"\n")
        last = Client(served["pose maps"])
        assert f"{CLIENTS} clients are connected" in json.loads(last.lines.readline())["error"]
        assert last.lines.readline() == b""
        last.close()
    finally:
        for one in many:
            one.close()
    with closing(Client(served["pose maps"])) as client:
        assert "error" in client.ask(b"\n")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "8.8.8.8", "localhost", "example.org", ""])
def test_it_listens_on_the_loopback_alone(calibrations, host):
    with pytest.raises(RigError, match="loopback"):
        CorrectionServer(calibrations["simplices"], host)


def test_a_port_that_is_taken_is_refused(calibrations, served):
    with pytest.raises(RigError, match=f"no server at 127.0.0.1 port {served['all'][1]}"):
        CorrectionServer(calibrations["simplices"], port=served["all"][1])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM to send another program")
@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGINT])
def test_the_command_answers_and_ends_on_a_signal(calibrations, tmp_path, ending):
    calibration_file.save(tmp_path / "c.json", calibrations["simplices"])
    words = [*RIG, "correct", "serve", str(tmp_path / "c.json")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        host, port = process.stdout.readline().removeprefix("serving ").split(" port ")
        with closing(Client((host, int(port)))) as client, closing(Client((host, int(port)))):
            assert client.ask({"poses": [[0, 0, 0.45, 0, 0, 0]]})["commands"][0] is not None
            process.send_signal(ending)
            assert process.wait(20) == 0 and client.lines.readline() == b""
        assert process.stdout.read() == "ended\n" and process.stderr.read() == ""
