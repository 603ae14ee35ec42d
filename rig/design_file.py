"""rig.toml -> Design: every value checked, every complaint with file, line and column; and cameras written back."""

import difflib
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.design import (DICTIONARIES, DISTORTION_TERMS, FACES, Actuator, Arm, Camera, Design, Free, Hexapod, Instrument, Marker, Planar2,
                        Platform, Target)
from rig.errors import FileError
from rig.pose import pose, vector
from rig.toml_positions import positions

SCHEMA = "rig/1"
STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
LARGEST_RIG = 50.0  # m; nothing on struts or arms is larger, so a larger figure is in another unit
LARGEST_MARKER = 5.0  # m
REQUIRED = object()


def load(path):
    """Design read from a rig.toml. Raises FileError with line and column for anything missing, malformed or implausible."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileError(path, "no such file; every recording has a rig.toml") from None
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read as text: {error}") from None
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        where = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        line, column = map(int, where.groups()) if where else (len(text.splitlines()), None)
        raise FileError(path, f"not valid TOML: {str(error).split(' (at')[0]}", line, column) from None
    return _design(_Table(tree, (), path, positions(text)))


@dataclass
class _Table:
    """A TOML table that knows where it stands and complains about its values."""

    tree: dict
    path: tuple
    file: Path
    places: dict

    def fail(self, message, *keys, value=None):
        at = self.path + keys
        while at not in self.places:
            at = at[:-1]
        raise FileError(self.file, message, *self.places[at], value=value)

    def name(self, key):
        return ".".join(str(part + 1 if isinstance(part, int) else part) for part in (*self.path, key))

    def get(self, key, default=REQUIRED):
        if key in self.tree:
            return self.tree[key]
        if default is REQUIRED:
            near = difflib.get_close_matches(key, self.tree, n=1, cutoff=0.7)
            hint = f"; is {near[0]!r} meant?" if near else ""
            self.fail(f"{self.name(key)} is missing{hint}", *(near or ()))
        return default

    def table(self, key, optional=False):
        value = self.get(key, {} if optional else REQUIRED)
        if not isinstance(value, dict):
            self.fail(f"{self.name(key)} must be a table, not {value!r}", key, value=value)
        return _Table(value, self.path + (key,), self.file, self.places)

    def tables(self, key):
        value = self.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.fail(f"{self.name(key)} must be written as [[{key}]] tables", key, value=value)
        return [_Table(item, self.path + (key, i), self.file, self.places) for i, item in enumerate(value)]

    def text(self, key, choices=None, default=REQUIRED):
        value = self.get(key, default)
        if value is default and default is not REQUIRED:
            return default
        if not isinstance(value, str) or (not choices and not value):
            self.fail(f"{self.name(key)} must be text, not {value!r}", key, value=value)
        if choices and value not in choices:
            self.fail(f"{self.name(key)} must be one of {', '.join(map(repr, choices))}, not {value!r}", key, value=value)
        return value

    def whole(self, key, least, default=REQUIRED):
        value = self.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            self.fail(f"{self.name(key)} must be a whole number of at least {least}, not {value!r}", key, value=value)
        return value

    def number(self, key, default=REQUIRED, least=None, most=None, above=None, unit=""):
        value = self.get(key, default)
        if value is None:
            return None
        self._numbers(value, (), key, ())
        if (least is not None and value < least) or (most is not None and value > most) or (above is not None and value <= above):
            limits = [f">= {least}" if least is not None else "", f"> {above}" if above is not None else "",
                      f"<= {most}" if most is not None else ""]
            self.fail(f"{self.name(key)} must be {' and '.join(filter(None, limits))} {unit}".rstrip() + f", not {value}",
                      key, value=value)
        return float(value)

    def array(self, key, shape, default=REQUIRED, length_limit=None):
        """Numbers nested as shape says (None: any length). length_limit (m) catches figures in another unit."""
        value = self.get(key, default)
        if value is None:
            return None
        self._numbers(value, shape, key, (), length_limit)
        return np.array(value, float)

    def _numbers(self, value, shape, key, index, length_limit=None):
        label = self.name(key) + "".join(f"[{i + 1}]" for i in index)
        if not shape:
            if isinstance(value, bool) or not isinstance(value, int | float):
                self.fail(f"{label} must be a number, not {value!r}", key, *index, value=value)
            if not np.isfinite(value):
                self.fail(f"{label} is not finite: {value}", key, *index, value=value)
            if length_limit is not None and abs(value) > length_limit:
                self.fail(f"{label} = {value} m is implausible (more than {length_limit:g} m): rig.toml is in metres; "
                          f"is this in millimetres ({value / 1000:g} m)?", key, *index, value=value)
            return
        if not isinstance(value, list) or (shape[0] is not None and len(value) != shape[0]):
            got = f"{len(value)} entries" if isinstance(value, list) else repr(value)
            self.fail(f"{label} must have {'x'.join('n' if n is None else str(n) for n in shape)} numbers, got {got}",
                      key, *index, value=value)
        for i, item in enumerate(value):
            self._numbers(item, shape[1:], key, (*index, i), length_limit)

    def pose(self, key):
        inner = self.table(key)
        position = inner.array("position", (3,), length_limit=LARGEST_RIG)
        return pose(position, inner.array("rotvec", (3,)))

    def refuse_misspelt(self, known):
        """An unknown key one slip away from a known, absent one is a slip; other unknown keys are left alone."""
        for key in self.tree:
            if key not in known:
                near = [k for k in difflib.get_close_matches(key, known, n=1, cutoff=0.8) if k not in self.tree]
                if near:
                    self.fail(f"unknown key {self.name(key)!r}; is {near[0]!r} meant?", key, value=key)


def _design(root):
    root.text("schema", (SCHEMA,))
    root.refuse_misspelt(("schema", "name", "environment", "mechanism", "instrument", "actuator", "platform", "camera", "target"))
    environment = root.table("environment", optional=True)
    gravity = environment.array("gravity", (3,), default=list(STANDARD_GRAVITY))
    return Design(
        name=root.text("name", default="rig"), gravity=gravity, mechanism=_mechanism(root.table("mechanism")),
        instrument=_instrument(root.table("instrument")) if "instrument" in root.tree else None,
        actuator=_actuator(root.table("actuator", optional=True)), platform=_platform(root.table("platform", optional=True)),
        cameras=_cameras(root.tables("camera")), targets=_targets(root.tables("target")))


def _mechanism(table):
    kind = table.text("kind", ("hexapod", "planar2", "arm", "free"))
    if kind == "free":
        return Free()
    if kind == "arm":
        rows = table.get("joints")
        columns = len(rows[0]) if isinstance(rows, list) and rows and isinstance(rows[0], list) and len(rows[0]) in (4, 5) else 4
        joints = table.array("joints", (None, columns))
        if not len(joints):
            table.fail("mechanism.joints is empty", "joints")
        for i, row in enumerate(joints):
            for j in (1, 2):
                table._numbers(float(row[j]), (), "joints", (i, j), LARGEST_RIG)
        return Arm(joints, _ranges(table, "limits", len(joints), None))
    if kind == "planar2":
        return Planar2(table.array("base_joints", (2, 2), length_limit=LARGEST_RIG), _ranges(table, "strut_range", 2, LARGEST_RIG))
    table.refuse_misspelt(("kind", "base_joints", "platform_joints", "strut_range", "home"))
    base = table.array("base_joints", (6, 3), length_limit=LARGEST_RIG)
    platform = table.array("platform_joints", (6, 3), length_limit=LARGEST_RIG)
    hexapod = Hexapod(base, platform, _ranges(table, "strut_range", 6, LARGEST_RIG), table.pose("home"))
    lengths = np.linalg.norm(hexapod.home.apply(platform) - base, axis=1)
    for i, (length, (low, high)) in enumerate(zip(lengths, hexapod.strut_range)):
        if not low <= length <= high:
            table.fail(f"mechanism.home needs strut {i + 1} at {length:.6f} m, outside its strut_range {low:g} .. {high:g} m", "home")
    return hexapod


def _ranges(table, key, count, length_limit):
    ranges = table.array(key, (count, 2), length_limit=length_limit)
    for i, (low, high) in enumerate(ranges):
        if not low < high:
            table.fail(f"{table.name(key)}[{i + 1}] must run from small to large, not {low:g} .. {high:g}", key, i)
        if length_limit is not None and low <= 0:
            table.fail(f"{table.name(key)}[{i + 1}] must be positive, not {low:g} m", key, i, 0)
    return ranges


def _instrument(table):
    return Instrument(table.text("base", ("free", "rig")), table.text("tool", ("free", "rig")),
                      table.number("position_sigma", above=0, most=1, unit="m"), table.number("rotation_sigma", above=0, most=1, unit="rad"))


def _actuator(table):
    return Actuator(table.number("screw_lead", None, above=0, most=1, unit="m"),
                    table.text("joints", ("cardan-cardan", "cardan-ball"), default=None),
                    table.number("max_speed", None, above=0, most=100, unit="m/s"))


def _platform(table):
    return Platform(table.number("mass", None, least=0, unit="kg"),
                    table.array("centre_of_mass", (3,), None, LARGEST_RIG), table.array("payload_centre_of_mass", (3,), None, LARGEST_RIG))


def _cameras(tables):
    cameras = []
    for table in tables:
        table.refuse_misspelt(("name", "width", "height", "matrix", "distortion", "pose", "shutter", "row_time", "mount"))
        name = table.text("name")
        if name in [camera.name for camera in cameras]:
            table.fail(f"camera {name!r} is listed twice", "name", value=name)
        matrix = table.array("matrix", (3, 3))
        for (i, j), want in {(0, 1): 0, (1, 0): 0, (2, 0): 0, (2, 1): 0, (2, 2): 1}.items():
            if matrix[i, j] != want:
                table.fail(f"{table.name('matrix')} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; "
                           f"row {i + 1}, column {j + 1} is {matrix[i, j]:g}", "matrix", i, j, value=matrix[i, j])
        for i in (0, 1):
            if matrix[i, i] <= 0:
                table.fail(f"{table.name('matrix')}: the focal length must be positive px, not {matrix[i, i]:g}", "matrix", i, i)
        distortion = table.array("distortion", (None,))
        if len(distortion) not in DISTORTION_TERMS:
            table.fail(f"{table.name('distortion')} must have {', '.join(map(str, DISTORTION_TERMS))} terms (OpenCV order), "
                       f"got {len(distortion)}", "distortion")
        shutter = table.text("shutter", ("global", "rolling"), default="global")
        row_time = table.number("row_time", default=REQUIRED if shutter == "rolling" else 0.0, least=0, most=1, unit="s")
        cameras.append(Camera(name, table.whole("width", 1), table.whole("height", 1), matrix, distortion, table.pose("pose"), shutter,
                              row_time, table.text("mount", ("fixed", "moving"), default="fixed")))
    return tuple(cameras)


def _targets(tables):
    targets, owners = [], {}
    for table in tables:
        table.refuse_misspelt(("name", "body", "dictionary", "edge", "marker", "faces", "pose"))
        name = table.text("name")
        if name in [target.name for target in targets]:
            table.fail(f"target {name!r} is listed twice", "name", value=name)
        body, dictionary = table.text("body", ("platform", "base")), table.text("dictionary", tuple(DICTIONARIES))
        listed = isinstance(table.tree.get("marker"), list)
        target = _listed(table, name, body, dictionary) if listed else _cube(table, name, body, dictionary)
        for number, key in zip(target.ids, [("faces", face) for face, _ in target.faces] or
                               [("marker", i, "id") for i in range(len(target.listed))]):
            if number >= DICTIONARIES[dictionary]:
                table.fail(f"{dictionary} has identities 0..{DICTIONARIES[dictionary] - 1}, not {number}", *key, value=number)
            if number in owners:
                table.fail(f"marker {number} of target {name!r} already belongs to {owners[number]}: "
                           "an identity may be used once in a rig", *key, value=number)
            owners[number] = f"target {name!r} (line {table.places[table.path + key][0]})"
        targets.append(target)
    return tuple(targets)


def _cube(table, name, body, dictionary):
    edge = table.number("edge", above=0, most=LARGEST_MARKER, unit="m (is it in millimetres?)")
    marker = table.number("marker", above=0, most=LARGEST_MARKER, unit="m (is it in millimetres?)")
    if marker > edge:
        table.fail(f"{table.name('marker')} = {marker:g} m does not fit on a cube of edge {edge:g} m", "marker", value=marker)
    faces = table.table("faces")
    if not faces.tree:
        table.fail(f"{table.name('faces')} is empty", "faces")
    for face in faces.tree:
        if face not in FACES:
            faces.fail(f"{face!r} is no face of a cube; there are {', '.join(FACES)}", face, value=face)
    pairs = tuple((face, faces.whole(face, 0)) for face in faces.tree)
    return Target(name, body, dictionary, edge, marker, pairs, table.pose("pose"))


def _listed(table, name, body, dictionary):
    markers = []
    for row in table.tables("marker"):
        side = row.number("side", above=0, most=LARGEST_MARKER, unit="m (is it in millimetres?)")
        margin = row.number("margin", default=side / 8, least=0, most=LARGEST_MARKER, unit="m")
        markers.append(Marker(row.whole("id", 0), side, row.pose("pose"), margin))
    return Target(name, body, dictionary, listed=tuple(markers))


def with_cameras(text, cameras):
    """The rig.toml text with each camera's matrix, distortion and pose replaced; all else, comments too, as it was.

    text : a valid rig.toml; cameras : Camera objects, matched by name. Raises KeyError for one that is not in the text.
    """
    import tomlkit

    document = tomlkit.parse(text)
    tables = {table["name"]: table for table in document["camera"]}
    for camera in cameras:
        table = tables[camera.name]
        table["matrix"] = np.round(camera.matrix, 6).tolist()
        table["distortion"] = np.round(camera.distortion, 9).tolist()
        position, rotvec = np.split(np.round(vector(camera.pose), 10), 2)
        entry = tomlkit.inline_table()
        entry.update({"position": position.tolist(), "rotvec": rotvec.tolist()})
        table["pose"] = entry
    return tomlkit.dumps(document)
