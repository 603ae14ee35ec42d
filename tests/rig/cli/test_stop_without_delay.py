"""rig stop sends its bytes before anything that takes time is imported."""

import os
import subprocess
import sys

import pytest

from rig.driving.controller_address_and_urgent_stop import STOPS, controller_address_in_rig_toml
from rig.driving.protocols import protocol_of_controller
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import PROTOCOLS
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.conftest import ROOT
from tests.emulated_run import CONTROLLER

# ends at the first import of a slow package, with what had been sent by then
WATCHED = """
import os, sys
class Slow:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("numpy", "scipy", "numba", "cv2"):
            os.set_blocking(int(sys.argv[1]), False)
            try:
                sent = os.read(int(sys.argv[1]), 4096)
            except BlockingIOError:
                sent = b""
            print(name, sent, flush=True)
            os._exit(0)
sys.meta_path.insert(0, Slow())
from rig.cli.command_line import main
main(["stop", sys.argv[2]])
"""


@pytest.fixture(params=PROTOCOLS)
def stated(request, tmp_path):
    """(protocol, path of a rig.toml, our end of the terminal at which its controller is)."""
    ours, theirs = os.openpty()
    path = tmp_path / "rig.toml"
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1)
    path.write_text(text + CONTROLLER.format(protocol=request.param, port=os.ttyname(theirs)))
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
