"""One process drives a device, whoever it is and whatever its environment; whoever else may stop it."""

import fcntl
import itertools
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from pathlib import Path

import pytest

from rig.cli.command_line import main
from rig.driving import controller_lock_and_stop_of_its_holder
from rig.driving import serial_and_epics_ports_and_checksummed_frames as ports
from rig.driving.controller_lock_and_stop_of_its_holder import ControllerLock, names_of_all_locks_of_controller
from rig.driving.driving_clock import SystemClock
from rig.driving.serial_and_epics_ports_and_checksummed_frames import SerialPort
from rig.errors import LinkLost, RigError
from rig.model.protocol_port_and_user_program_name_checks import port_problem
from tests.conftest import ROOT
from tests.emulated_run import EmulatedRig
from tests.rig.lock_holder import stop_lock_holder

TCP = "import rig.driving.controller_lock_and_stop_of_its_holder as lock\nlock.ABSTRACT = False\n"  # as off Linux
HOLD = (
    "import sys, signal\nfrom rig.errors import RigError\n"
    "from rig.driving.controller_lock_and_stop_of_its_holder import ControllerLock\n"
    "def end(*_): raise KeyboardInterrupt\nsignal.signal(signal.SIGTERM, end)\n"
    "try:\n    with ControllerLock(*sys.argv[1:]):\n        print('held', flush=True)\n        signal.pause()\n"
    "except RigError as error:\n    print(error, flush=True)\nexcept KeyboardInterrupt:\n    print('ended', "
    "flush=True)\n"
)
STOP = (
    "import sys\nfrom rig.driving.driving_clock import SystemClock\nfrom rig.errors import RigError\n"
    "from rig.driving.controller_lock_and_stop_of_its_holder import ask_lock_holder_to_end, await_or_kill_lock_holder\n"
    "try:\n    holder = ask_lock_holder_to_end(sys.argv[1])\n"
    "    await_or_kill_lock_holder(holder, sys.argv[1], SystemClock(), 5.0)\n"
    "    print(holder.pid, flush=True)\nexcept RigError as error:\n    print(error, flush=True)\n"
)
ENVIRONMENTS = (
    {"XDG_RUNTIME_DIR": "/tmp"},
    {},
    {"XDG_RUNTIME_DIR": "/nowhere", "HOME": "/nowhere", "TMPDIR": "/nowhere"},
)
NOBODY = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "--inh-caps=-all"]


@pytest.fixture
def device():
    """The path of a terminal that nobody drives."""
    ends = os.openpty()
    yield os.ttyname(ends[1])
    for end in ends:
        os.close(end)


@pytest.fixture(params=["abstract", "tcp"])
def before_all(request, monkeypatch):
    """What a process runs first, so that locks are those of Linux, or those of other systems."""
    monkeypatch.setattr(controller_lock_and_stop_of_its_holder, "ABSTRACT", request.param == "abstract")
    return "" if request.param == "abstract" else TCP


def python(code, *words, env=None, before=()):
    whole = {"PYTHONPATH": str(ROOT), **(env or {})}
    return subprocess.Popen(
        [*before, sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True, env=whole, cwd="/"
    )


def one_is_refused_and_stopped(device, link, *, users=((), (), ()), first_lines=""):
    first = python(first_lines + HOLD, device, env=ENVIRONMENTS[0], before=users[0])
    assert first.stdout.readline() == "held\n"
    second = python(first_lines + HOLD, str(link), env=ENVIRONMENTS[1], before=users[1])
    refused = second.communicate()[0]
    assert f"process {first.pid}" in refused and "is driving" in refused
    assert (
        python(first_lines + STOP, str(link), env=ENVIRONMENTS[2], before=users[2]).communicate()[0] == f"{first.pid}\n"
    )
    assert first.communicate()[0] == "ended\n"


def test_a_second_process_is_refused_whatever_its_environment_and_the_first_is_stopped_from_a_bare_one(
    device, tmp_path, before_all
):
    (tmp_path / "link").symlink_to(device)
    one_is_refused_and_stopped(device, tmp_path / "link", first_lines=before_all)


@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("setpriv"), reason="takes root, to become somebody else")
@pytest.mark.parametrize("users", [((), NOBODY, NOBODY), (NOBODY, (), ())])
def test_users_are_refused_and_stopped_by_each_other(device, users, before_all):
    if subprocess.run(
        [*NOBODY, sys.executable, "-c", "import rig.driving.controller_lock_and_stop_of_its_holder"],
        capture_output=True,
        cwd="/",
        env={"PYTHONPATH": str(ROOT)},
    ).returncode:
        pytest.skip("this Python is out of other users' reach")
    one_is_refused_and_stopped(device, device, users=users, first_lines=before_all)


def test_processes_that_begin_at_once_are_one(device, before_all):
    several = [python(before_all + HOLD, device) for _ in range(5)]
    try:
        output = [process.stdout.readline() for process in several]
        assert output.count("held\n") == 1 and sum("is driving" in line for line in output) == 4
    finally:
        for process in several:
            process.kill()
            process.communicate()
    assert stop_lock_holder(device, 0.0) is None


def test_one_device_has_one_name_whatever_path_or_address_leads_there(device, tmp_path):
    (tmp_path / "link").symlink_to(device)
    assert names_of_all_locks_of_controller(str(tmp_path / "link")) == names_of_all_locks_of_controller(device)
    assert set(names_of_all_locks_of_controller("socket://localhost:5007")) & set(
        names_of_all_locks_of_controller("socket://127.0.0.1:5007")
    )
    assert not set(names_of_all_locks_of_controller("socket://127.0.0.1:5007")) & set(
        names_of_all_locks_of_controller("socket://127.0.0.1:5008")
    )
    assert not set(names_of_all_locks_of_controller(device)) & set(names_of_all_locks_of_controller(device + "0"))


def test_who_only_looks_stops_nobody_and_a_forked_child_holds_nothing(device, before_all):
    with ControllerLock(device):
        for _ in range(50):
            with pytest.raises(RigError, match=f"process {os.getpid()} is driving"):
                ControllerLock(device)
        reading, writing = os.pipe()
        child = os.fork()
        if not child:
            os.write(writing, b"1")
            signal.pause()
        os.read(reading, 1)  # the child has begun, so it has let go
        os.close(reading)
        os.close(writing)
    try:
        ControllerLock(device).__exit__()
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def answer(listening):
    with listening.accept()[0] as caller:
        caller.sendall(b"SSH-2.0\n")


def test_a_port_of_another_program_is_no_lock(device, monkeypatch):
    monkeypatch.setattr(controller_lock_and_stop_of_its_holder, "ABSTRACT", False)
    with socket.create_server(
        controller_lock_and_stop_of_its_holder._address(names_of_all_locks_of_controller(device)[0])
    ) as other:
        thread = threading.Thread(target=answer, args=(other,))
        thread.start()
        with pytest.raises(RigError, match="in use by another program"):
            ControllerLock(device)
        thread.join()


def test_a_killed_process_leaves_nothing(device, before_all):
    first = python(before_all + HOLD, device)
    assert first.stdout.readline() == "held\n"
    first.kill()
    first.communicate()
    assert stop_lock_holder(device, 0.0) is None
    ControllerLock(device).__exit__()


def test_an_open_device_is_locked_for_others_and_free_again(device, monkeypatch):
    def exclusive():
        return struct.unpack("i", fcntl.ioctl(other, 0x80045440, bytes(4)))[0]  # TIOCGEXCL

    other = os.open(device, os.O_RDWR | os.O_NOCTTY)
    port = SerialPort(device, 115200, SystemClock())
    assert not exclusive(), "at a pseudo-terminal it would outlive a killed process"
    with pytest.raises(LinkLost, match="cannot open"):
        SerialPort(device, 115200, SystemClock())
    port.close()
    monkeypatch.setattr(ports, "PSEUDO_TERMINALS", ())
    port = SerialPort(device, 115200, SystemClock())
    assert exclusive()
    port.close()
    assert not exclusive()
    os.close(other)


@pytest.mark.parametrize(
    "url",
    [
        "spy:///dev/null?file={}",
        "SPY://loop://?file={}",
        "alt:///dev/null?class=PosixPollSerial",
        "hwgrep://.*",
        "cp2110://x",
        "file://{}",
        "://{}",
        "loop://\x1b[2J",
    ],
)
def test_a_port_of_another_scheme_is_refused_and_writes_nothing(url, tmp_path):
    folder = tmp_path / "kept"
    folder.write_text("kept")
    assert "is not a port" in port_problem(url.format(folder))
    with pytest.raises(LinkLost, match="is not a port"):
        SerialPort(url.format(folder), 115200, SystemClock())
    assert folder.read_text() == "kept"


@pytest.mark.parametrize(
    "url",
    [
        "/dev/ttyUSB0",
        "COM3",
        "/dev/serial/by-id/usb-1a86",
        "socket://grbl.local:23",
        "rfc2217://10.0.0.2:4000",
        "loop://",
    ],
)
def test_ports_are_what_they_were(url):
    assert port_problem(url) is None


RIG = "import sys; from rig.cli.command_line import run_script; run_script()"
ROUNDS = 100
BARE = {"PATH": "/usr/bin:/bin", "SHELL": "/bin/sh"}
STARTED_BY = {  # what starts a command: its environment
    "cron": BARE | {"HOME": "/nowhere", "LOGNAME": "cron"},
    "sudo": BARE | {"HOME": "/root", "SUDO_USER": "somebody", "SUDO_UID": "1000", "TERM": "xterm"},
    "terminal": BARE | {"XDG_RUNTIME_DIR": "/tmp", "TMPDIR": "/tmp", "LANG": "C.UTF-8"},
}


@pytest.fixture(scope="module")
def users():
    """{user: (what becomes that user, a Python that it reaches)}: this one, and nobody where root runs the tests."""
    found = {"own": ([], sys.executable)}
    system = shutil.which(f"python3.{sys.version_info.minor}", path="/usr/bin:/usr/local/bin")
    for interpreter in (sys.executable, system):
        if os.geteuid() == 0 and shutil.which("setpriv") and interpreter and "nobody" not in found:
            words = [
                *NOBODY,
                interpreter,
                "-c",
                "import numpy, serial, rig.driving.controller_lock_and_stop_of_its_holder",
            ]
            if subprocess.run(words, capture_output=True, cwd="/", env=BARE | packages()).returncode == 0:
                found["nobody"] = (NOBODY, interpreter)
    return found


def packages():
    """Environment by which another Python of this version finds the same packages."""
    return {"PYTHONPATH": os.pathsep.join([str(ROOT), sysconfig.get_path("purelib")])}


@pytest.fixture
def open_rig():
    """An emulated rig that every user of this computer may drive, homed."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        made = EmulatedRig(Path(folder))
        os.chmod(Path(folder) / "port", 0o666)
        assert main(["home", str(Path(folder) / "rig.toml"), "--quiet"]) == 0
        yield made
        made.close()


@pytest.mark.slow
def test_commands_of_any_user_and_environment_refuse_and_stop_each_other(users, open_rig, capsys):
    """Of each round other users and environments drive, want to drive too, and stop."""
    path = str(open_rig.folder / "rig.toml")

    def rig(user, starter, *words):
        before, interpreter = users[user]
        return subprocess.Popen(
            [*before, interpreter, "-c", RIG, *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=STARTED_BY[starter] | packages(),
            cwd="/",
        )

    roles = [
        [*zip(who, how)]
        for how in itertools.product(STARTED_BY, repeat=3)
        for who in itertools.product(users, repeat=3)
    ]
    for k in range(ROUNDS):
        driving, second, stopping = roles[7 * k % len(roles)]
        count = len(open_rig.commanded_goals())
        first = rig(*driving, "jog", path, "--by", ("20", "-20")[k % 2], "--speed", "0.0001")
        while first.poll() is None and len(open_rig.commanded_goals()) == count:
            time.sleep(0.01)
        refused = rig(*second, "jog", path, "--by", "1")
        assert f"process {first.pid}" in (said := refused.communicate()[0]) and "is driving" in said, said
        assert refused.returncode == 1
        stop = rig(*stopping, "stop", path)
        assert f"process {first.pid}, which drove them, was stopped" in (said := stop.communicate()[0]), said
        assert stop.returncode == 0 and "ended by signal" in first.communicate()[0]
        assert first.returncode == 128 + signal.SIGTERM and len(open_rig.commanded_goals()) == count + 1
    with capsys.disabled():
        print(f"\n{ROUNDS} rounds of users {', '.join(users)}, {len(roles)} ways to share them out")
