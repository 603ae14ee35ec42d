"""rig stop sends its bytes before anything that takes time is imported."""

import contextlib
import errno
import os
import select
import subprocess
import sys
import threading
import time

import pytest

from rig.cli.command_line import main
from rig.cli.command_parser_execution_and_exit_status import command_line_parser
from rig.cli.urgent_stop_before_slow_imports import (
    begin_urgent_stop_or_return_error,
    real_time_priority,
    rig_toml_and_port_in_stop_words,
)
from rig.driving.controller_address_and_urgent_stop import STOPS, controller_address_in_rig_toml
from rig.driving.protocols import protocol_of_controller
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import PROTOCOLS
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.planning.layout.shipped_arms_and_layouts import shipped_arm_path
from tests.conftest import ROOT
from tests.emulated_run import controller_text

# ends at the first import of a slow package, with what had been sent by then, and what was imported for that
WATCHED = """
import os, sys
before = {*sys.modules}
class Slow:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("numpy", "scipy", "numba", "cv2", "argparse"):
            os.set_blocking(int(sys.argv[1]), False)
            try:
                sent = os.read(int(sys.argv[1]), 4096)
            except BlockingIOError:
                sent = b""
            print(name, sent, *sorted({*sys.modules} - before), flush=True)
            os._exit(0)
sys.meta_path.insert(0, Slow())
from rig.cli.command_line import main
main(["stop", sys.argv[2]])
"""
NOT_BEFORE = {"ast", "concurrent", "ctypes", "dataclasses", "glob", "inspect", "json", "logging", "multiprocessing"}
NOT_BEFORE |= {"shutil", "subprocess", "tempfile", "rig.compute.numba_compilation_and_kernel_cache_folder"}
AT_MOST = 2.5  # times as long as a bare Python takes to its first byte; 0.3 s where that takes 0.12 s


@pytest.fixture(params=PROTOCOLS)
def stated(request, tmp_path):
    """(protocol, path of a rig.toml, our end of the terminal at which its controller is)."""
    ours, theirs = os.openpty()
    path = tmp_path / "rig.toml"
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1)
    if request.param == "urscript":
        text = shipped_arm_path("ur10").read_text()
    path.write_text(text + controller_text(request.param, os.ttyname(theirs)))
    yield request.param, path, ours
    os.close(ours)
    os.close(theirs)


def test_the_urgent_stop_is_out_before_anything_slow_is_imported(stated):
    protocol, path, ours = stated
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(ours), str(path)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        pass_fds=(ours,),
    )
    assert repr(STOPS[protocol])[2:-1].removesuffix("\\r\\n") in done.stdout, done.stdout + done.stderr
    assert done.stdout.startswith("argparse ") and not NOT_BEFORE & {*done.stdout.split()}


def test_what_is_sent_first_is_what_the_protocol_sends_to_stop(stated):
    protocol, path, _ = stated
    design = design_from_rig_toml.load_design(path)
    address, c = controller_address_in_rig_toml(path, None), design.driver()
    assert (address.port, address.baudrate, address.password) == (c.port, c.baudrate, c.password)
    assert address.urgent_stop().endswith(protocol_of_controller(c, design.mechanism).urgent_stop)
    assert controller_address_in_rig_toml(path, "/dev/other").port == "/dev/other"


def test_a_rig_without_a_controller_has_no_address(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1))
    assert (
        controller_address_in_rig_toml(path, None) is None
        and controller_address_in_rig_toml(tmp_path / "none.toml", None) is None
    )


@pytest.mark.parametrize(
    "text",
    [
        "rig.toml",
        "rig.toml --port /dev/x",
        "--port=/dev/x rig.toml --quiet",
        "rig.toml --trace t --port a --port b",
        "--trace=t rig.toml",
    ],
)
def test_words_that_are_understood_at_once_are_understood_alike_by_the_parser(text):
    stated = command_line_parser(["stop"]).parse_args(["stop", *text.split()])
    assert rig_toml_and_port_in_stop_words(text.split()) == (str(stated.design), stated.port)


@pytest.mark.parametrize(
    "text",
    ["", "--help", "rig.toml --help", "rig.toml other.toml", "rig.toml --port", "rig.toml --prt x", "-- rig.toml"],
)
def test_other_words_are_left_to_the_parser_and_nothing_is_done(text):
    assert (
        rig_toml_and_port_in_stop_words(text.split()) is None
        and begin_urgent_stop_or_return_error(text.split()) is None
    )


def test_help_and_errors_of_stop_are_those_of_every_command(tmp_path, capsys):
    path = tmp_path / "rig.toml"
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1)
    path.write_text(text + controller_text("grblhal", tmp_path / "none"))
    for words, status, message in (
        ([str(path)], 1, f"rig stop: cannot open {tmp_path / 'none'}: No such file or directory; serial ports here: "),
        ([str(path), "--port", "spy://x"], 1, "rig stop: 'spy://x' is not a port: "),
        ([str(tmp_path / "other.toml")], 1, f"rig stop: {tmp_path / 'other.toml'}: "),
    ):
        assert main(["stop", *words]) == status and capsys.readouterr().err.startswith(message)
    for words, status, message in ((["--help"], 0, "usage: rig stop"), ([str(path), "--prt", "x"], 2, "usage: rig")):
        with pytest.raises(SystemExit) as end:
            main(["stop", *words])
        assert end.value.code == status and message in "".join(capsys.readouterr())


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="priorities of real time are Linux's")
def test_priority_is_raised_where_that_is_permitted_and_only_until_the_stop_is_sent():
    before = os.sched_getscheduler(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    permitted = os.sched_getscheduler(0)
    os.sched_setscheduler(0, before, os.sched_param(0))
    with real_time_priority():
        assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == permitted
        inherited = []
        thread = threading.Thread(target=lambda: inherited.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
    assert os.sched_getscheduler(0) == before and inherited == [before]


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="priorities of real time are Linux's")
@pytest.mark.parametrize("function", ["sched_getscheduler", "sched_setscheduler"])
def test_a_system_without_such_priorities_does_not_prevent_a_stop(monkeypatch, function):
    def refused(*_):
        raise OSError(errno.ENOSYS, "not implemented")

    monkeypatch.setattr(os, function, refused)
    with real_time_priority():
        pass


def seconds_to_first_byte(code, *words, ours):
    """s from the start of a Python with code and words to the first byte at the other end of the port."""
    begun = time.monotonic()
    with subprocess.Popen([sys.executable, "-c", code, *words], stderr=subprocess.DEVNULL) as process:
        assert select.select([ours], [], [], 60)[0]
        took = time.monotonic() - begun
        process.kill()
    os.read(ours, 4096)
    return took


@pytest.mark.slow
@pytest.mark.parametrize("loops_per_core", [0, 1, 2])
@pytest.mark.parametrize("stated", ["grblhal"], indirect=True)
def test_the_first_byte_takes_little_longer_than_python_itself(stated, loops_per_core, capsys):
    """The best of 15 counts, by turns with a Python that writes a byte at once: other programs delay both alike."""
    _, path, ours = stated
    port = design_from_rig_toml.load_design(path).controller.port
    stop = "from rig.cli.command_line import run_script; run_script()"
    bare = "import os, sys; os.write(os.open(sys.argv[1], os.O_WRONLY | os.O_NOCTTY), b'!')"
    loops = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops_per_core * os.cpu_count())
    ]
    try:
        both = [
            (seconds_to_first_byte(stop, "stop", str(path), ours=ours), seconds_to_first_byte(bare, port, ours=ours))
            for _ in range(15)
        ]
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    took, least = (sorted(each) for each in zip(*both))
    with capsys.disabled():
        for name, times in (("rig stop", took), ("bare Python", least)):
            figures = f"{times[0]:.3f} s at best, {times[7]:.3f} in the median, {times[-1]:.3f} at worst"
            print(f"\n{len(loops)} busy loops, {name}: {figures}", end="")
    assert took[0] < AT_MOST * least[0]
