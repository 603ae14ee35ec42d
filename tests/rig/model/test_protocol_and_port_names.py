"""Names of ports: what is no port is told in words, before anything opens it."""

import pytest

from rig.model.protocol_port_and_user_program_name_checks import port_problem


@pytest.mark.parametrize("port", ["xps://host:abc", "socket://host:99999", "ca://[::1"])
def test_a_url_without_a_sound_port_number_is_no_port(port):
    problem = port_problem(port)
    assert problem is not None and problem.startswith(f"{port!r} is not a port: ")


@pytest.mark.parametrize("port", ["/dev/ttyUSB0", "COM3", "xps://host", "socket://[::1]:5001", "loop://"])
def test_devices_and_sound_urls_are_ports(port):
    assert port_problem(port) is None
