"""Readers held to a law of what they may take, written another way: a key, a number, a request, a file that gets
through must be one.
"""

import json
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

from calib.files import calibration_file
from calib.models import machine_parameters_and_file_entries as machine_models
from rig.driving.cameras.opencv_uvc_gstreamer_and_network_cameras import gstreamer_pipeline_problem
from rig.errors import RigError
from rig.formats.json_toml_and_yaml_loading import Places, first_repeated_key_and_position, toml_entries
from rig.formats.numbers_and_units import parse_number, parse_whole_number
from rig.formats.output_files.atomic_file_writing_and_process_locks import escape_unprintable
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Actuator
from rig.model.protocol_port_and_user_program_name_checks import SCHEMES, port_problem
from rig.report.pages import run_page_server

PLAIN = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
TOKEN = "a-token-that-nobody-guesses"
TABLES = {
    "actuator": {field.name for field in fields(Actuator)},
    "environment": {"gravity"},
    "mechanism": {"kind"},
    "experiment": {"may"},
}
WORDS = ("screw_lead", "max_speed", "joints", "gravity", "kind", "may", "shuter", "screw_led")


def text_of(path: Path) -> str:
    """A file's text, whatever its bytes."""
    return path.read_bytes().decode("utf-8", "replace").replace("\0", "0")


def a_number(path: Path) -> None:
    """What is taken for a number is written as one."""
    text = path.read_bytes().decode("utf-8", "surrogateescape")
    plain = len(text) <= 100 and PLAIN.fullmatch(text) is not None
    for read, matches in (
        (parse_number, plain),
        (parse_whole_number, plain and re.fullmatch(r"[+-]?[0-9]+", text) is not None),
    ):
        try:
            value = read(text)
        except ValueError:
            assert not matches or read is parse_number and abs(float(text)) == float("inf"), text
        else:
            assert matches and value == (float(text) if read is parse_number else int(text)), text


def a_key(path: Path) -> None:
    """A key of a rig.toml that is read without complaint is one that is known."""
    table, _, key = text_of(path)[:200].partition(".")
    table = table if table in TABLES else "actuator"
    quoted = json.dumps(key)
    try:
        design_from_rig_toml.design_of_entries(toml_entries(_toml(table, f"{quoted} = 0.001\n"), path))
    except RigError:
        return
    assert key in TABLES[table], key


def _toml(table: str, line: str) -> str:
    text = 'schema = "rig/1"\n' + (f"[{table}]\n{line}" if table != "mechanism" else "")
    return text + '[mechanism]\nkind = "free"\n' + (line if table == "mechanism" else "")


def a_calibration(path: Path) -> None:
    """A calibration.json that is taken has no key twice, states the units, frames and order in which it is read, and
    holds what its schema says.
    """
    calibration_file.load(path)
    doubles: list[str] = []

    def looked(pairs: list[tuple[str, object]]) -> dict[str, object]:
        doubles.extend(key for key in {key for key, _ in pairs} if sum(other == key for other, _ in pairs) > 1)
        return dict(pairs)

    tree = json.loads(path.read_bytes().decode("utf-8-sig"), object_pairs_hook=looked)
    assert not doubles and tree["units"] == calibration_file.UNITS and tree["frames"] == machine_models.FRAMES
    assert tree["parameter_order"] == machine_models.MODELS[tree["nominal"]["kind"]].order
    assert ("physics" in tree) == (tree["schema"] == calibration_file.WITH_PHYSICS) or tree[
        "schema"
    ] == calibration_file.WITH_POSE_MAPS
    assert ("pose_maps" in tree) == (tree["schema"] == calibration_file.WITH_POSE_MAPS)
    for name in ("nominal", "fitted"):
        assert all(0 < low < high <= 50 for low, high in tree[name]["strut_range"])


def places_of_json(path: Path) -> None:
    """Every value of a JSON text has a place, at which it stands; a key that occurs twice is found where json loses
    one.
    """
    text = text_of(path)
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError):
        return
    lines = text.split("\n")
    found = Places(text)
    for at, value in _paths(tree, ()):
        line, column = found[at]
        if at:
            start = lines[line - 1][column - 1]
            assert start == {dict: "{", list: "[", str: '"', bool: "t" if value else "f", type(None): "n"}.get(
                type(value), start
            ), (at, start)
    assert first_repeated_key_and_position(text) is not None or len(list(_paths(tree, ()))) == len(found)


def _paths(tree, at):
    yield at, tree
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        yield from _paths(value, (*at, key))


def a_port(path: Path) -> None:
    """A port's name that is taken has no scheme but those that are opened, and nothing that a terminal acts on."""
    text = text_of(path)
    if port_problem(text) is None:
        assert "://" not in text or text.partition("://")[0].lower() in SCHEMES
        assert escape_unprintable(text) == text


def a_pipeline(path: Path) -> None:
    """A pipeline that is taken has one sink, appsink, which is its last element; all else are settings or what is asked
    of the video.
    """
    text = text_of(path)
    if gstreamer_pipeline_problem(text) is None:
        parts = [part.split() for part in text.split("!")]
        elements = [words for words in parts if not words[0].startswith(("video/", "image/"))]
        assert [words[0] for words in elements if "sink" in words[0]] == ["appsink"] and parts[-1][0] == "appsink", (
            text[:200]
        )
        assert all(
            words[0].replace("_", "").isalnum() and all("=" in word[1:-1] for word in words[1:]) for words in elements
        ), text[:200]
        assert not set(text) & set("\"'\\;{}<>"), text[:200]


def text_shown(path: Path) -> None:
    """What is printed of any text does nothing at a terminal, and can be encoded."""
    shown = escape_unprintable(path.read_bytes().decode("utf-8", "surrogateescape"))
    shown.encode("utf-8")
    assert not any(
        ord(c) < 32 and c not in "\n\t\r" or 0x7F <= ord(c) < 0xA0 or 0x202A <= ord(c) <= 0x202E for c in shown
    )
    assert "\r" not in shown.replace("\r\n", "")


class Wire:
    """In place of a socket: bytes that came, and those that are answered."""

    def __init__(self, data: bytes) -> None:
        self.data, self.answer = data, b""

    def makefile(self, mode: str, size: int = -1):
        """What came, as a file."""
        import io

        return io.BufferedReader(io.BytesIO(self.data))

    def sendall(self, data: bytes) -> None:
        """Keep what is answered."""
        self.answer += bytes(data)

    def settimeout(self, seconds: float) -> None:
        """Nothing waits."""


def requests_to_a_page(path: Path) -> None:
    """Nothing is answered with anything of the run's, and no button is pressed, without the token; what comes is never
    a mistake of ours.
    """
    data = path.read_bytes()
    pressed: list[bool] = []
    page = SimpleNamespace(
        token=TOKEN,
        port=8000,
        pressed=lambda: pressed.append(True),
        image=lambda name: b"jpeg" if name == "cam0" else None,
        listen=lambda after, seconds: (1, b"{}", False),
        take_line=lambda more: True,
    )
    wire = Wire(data.replace(b"TOKEN", TOKEN.encode()))
    server = SimpleNamespace(page=page, admit=lambda request: True)
    run_page_server._Handler(wire, ("127.0.0.1", 1), server)  # type: ignore[arg-type]
    if b"TOKEN" not in data:
        assert not pressed and b" 200 " not in wire.answer, wire.answer[:80]
    if pressed:
        assert re.search(rb"POST\s+/stop\?", data) and re.search(rb"Origin:", data, re.IGNORECASE)


REQUESTS = (
    b"GET /?token=TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8000\r\n\r\nGET /page.js?token=TOKEN HTTP/1.1\r\nHost: "
    b"localhost:8000\r\n\r\n",
    b"POST /stop?token=TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8000\r\nOrigin: "
    b"http://127.0.0.1:8000\r\nContent-Length: 0\r\n\r\n",
    b"GET /image?camera=cam0&token=TOKEN HTTP/1.0\r\nHost: 127.0.0.1:8000\r\nSec-Fetch-Site: none\r\n\r\n",
    b"GET /events HTTP/1.1\r\nHost: 127.0.0.1:8000\r\n\r\n",
    b"GET http://evil.example/ HTTP/1.1\r\nHost: evil.example\r\n\r\n",
)


def laws(calibration: bytes) -> list[tuple[str, tuple[bytes, ...], Callable[[Path], object]]]:
    """(name, inputs that get through, reader) of all of them. calibration : of a calibration.json"""
    whole_text = json.dumps(json.loads(calibration)).encode()
    return [
        ("number", (b"1", b"-1.5e-3", b"+.5", b"5.", b"1E5"), a_number),
        ("keys of rig.toml", tuple(f"{table}.{word}".encode() for table in TABLES for word in WORDS), a_key),
        ("whole calibration.json", (calibration,), a_calibration),
        (
            "places of JSON",
            (
                whole_text[:2000],
                b'{"a": [1, {"b\\n": "x,]}"},\n [], -2.5e3], "c": null, "d": true}',
                b'{"a": 1, "a": {}}',
            ),
            places_of_json,
        ),
        ("port", (b"/dev/ttyUSB0", b"socket://localhost:23", b"spy:///dev/null?file=x", b"COM3"), a_port),
        (
            "pipeline",
            (
                b"v4l2src device=/dev/video0 ! video/x-raw, width=640 ! videoconvert ! appsink drop=true",
                b"v4l2src ! filesink location=a",
                b"v4l2src ! appsink t. ! filesink location=b",
            ),
            a_pipeline,
        ),
        ("text shown", (b"rec\x1b[2J", "\u202eabc\u00b5".encode(), b"a\r\nb\xff"), text_shown),
        ("requests to a page", REQUESTS, requests_to_a_page),
    ]
