"""Design read from a rig.toml.

Every value is checked; errors have file, line and column.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, Entries, rig_part_name_problem
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.local_and_remote_input_files import read_text
from rig.formats.rig_toml import camera_instrument_experiment_and_cube_turn_entries
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import (
    instrument_of_table,
    user_program_with_path_beside_rig_toml,
)
from rig.formats.rig_toml.controller_entries import controller_of_table, port_of_table
from rig.formats.rig_toml.mechanism_entries import (
    bodies_by_name_in_rig_toml,
    mechanism_of_table,
    refuse_tables_unsuited_to_several_hands,
)
from rig.model.base_and_link_tilt_sensors import ANGLE_UNITS, BaseTilt, TiltSensor
from rig.model.calibration_board_layout_and_description_parsing import parse_board
from rig.model.design import (
    DICTIONARIES,
    FACES,
    Actuator,
    Design,
    Marker,
    MeasuringLimbs,
    Platform,
    Sensor,
    SensorPort,
    Target,
)
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, has_links
from rig.model.protocol_port_and_user_program_name_checks import is_user_file_or_package

SCHEMA = "rig/1"
STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
DYNAMICS = ("links", "torque_limits", "torque_sigma", "torque_constants", "friction", "angle_sigma", "speed_sigma")
LEAST_GRAVITY = 0.1  # m/s^2; a smaller one in a file in mm is in m/s^2
LARGEST_MARKER = 5.0  # m
MOST_TILT = 6.3  # rad
LARGEST = 1 << 22  # bytes of a rig.toml


def load_design(path: str | Path) -> Design:
    """Load the Design of a rig.toml.

    Raises FileError with line and column for anything missing, malformed or implausible.
    """
    return design_of_entries(load_entries(path))


def load_entries(path: str | Path) -> Entries:
    """Load the unchecked Entries of a rig.toml.

    Raises FileError where it cannot be read or is no TOML.
    """
    path = Path(path)
    return toml_entries(read_text(path, LARGEST, "no such file; every recording has a rig.toml"), path)


def design_of_entries(root: Entries) -> Design:
    """Design of the Entries of a rig.toml, lengths in m, angles in rad.

    Raises FileError as `load_design` does.
    """
    root.schema("rig.toml", SCHEMA)
    root = root.in_stated_units()
    root.refuse_misspelt(
        (
            "schema",
            "units",
            "name",
            "environment",
            "mechanism",
            "instrument",
            "actuator",
            "platform",
            "camera",
            "target",
            "sensor",
            "tilt_sensor",
            "insitu",
            "controller",
            "sensors",
            "dynamics",
            "experiment",
            "turned",
        )
    )
    root.table("dynamics", optional=True).refuse_misspelt(DYNAMICS)  # its figures are read by what needs them
    environment = root.table("environment", optional=True)
    environment.refuse_misspelt(("gravity", "tilt"))
    gravity = environment.array("gravity", (3,), default=list(STANDARD_GRAVITY), unit="m/s^2")
    if root.units.length != "m" and 0 < np.linalg.norm(gravity) < LEAST_GRAVITY:
        stated = root.units.shown(float(np.linalg.norm(gravity)), "m/s^2")
        environment.fail(
            f'environment.gravity of {stated} is nowhere: the file states units = "{root.units}", in which standard '
            f"gravity is {root.units.shown(9.80665, 'm/s^2')}",
            "gravity",
        )
    refuse_tables_unsuited_to_several_hands(root)
    mechanism, actuator = mechanism_of_table(root.table("mechanism")), _actuator(root.table("actuator", optional=True))
    cameras, targets = (
        camera_instrument_experiment_and_cube_turn_entries.cameras_of_tables(root.tables("camera")),
        _targets(root.tables("target"), bodies_by_name_in_rig_toml(mechanism)),
    )
    targets = camera_instrument_experiment_and_cube_turn_entries.targets_with_cubes_turned_by_table(
        root.table("turned", optional=True), targets
    )
    camera_instrument_experiment_and_cube_turn_entries.require_supported_hand_mounted_cameras(
        root, cameras, targets, mechanism
    )
    camera_instrument_experiment_and_cube_turn_entries.refuse_stage_targets_of_moving_cameras(root, cameras, targets)
    return Design(
        name=root.text("name", default="rig"),
        gravity=gravity,
        mechanism=mechanism,
        instrument=instrument_of_table(root.table("instrument"), mechanism) if "instrument" in root.tree else None,
        actuator=actuator,
        platform=_platform(root.table("platform", optional=True)),
        cameras=cameras,
        targets=targets,
        sensor=_sensor(root.table("sensor", optional=True)),
        insitu=_limbs(root.table("insitu")) if "insitu" in root.tree else None,
        controller=controller_of_table(root.table("controller"), mechanism, actuator)
        if "controller" in root.tree
        else None,
        sensors=_sensors(root.table("sensors")) if "sensors" in root.tree else None,
        tilts=tuple(base_tilt_of_table(entry) for entry in environment.tables("tilt")),
        joint_names=_joint_names(root.table("mechanism"), mechanism) if has_links(mechanism) else (),
        tilt_sensors=_tilt_sensors(root.tables("tilt_sensor"), mechanism, gravity),
        experiment=camera_instrument_experiment_and_cube_turn_entries.experiment_permission(
            root.table("experiment", optional=True), targets
        ),
    )


def _joint_names(table: Entries, arm: Mechanism) -> tuple[str, ...]:
    """Names of an arm's joints in other files, () where none are stated. Raises FileError for another number."""
    if table.get("joint_names", None) is None:
        return ()
    names = table.texts("joint_names")
    if len(names) != len(arm.axes):
        table.fail(
            f"{table.name('joint_names')} must name each of the {len(arm.axes)} joints, not {len(names)}", "joint_names"
        )
    return names


def _actuator(table: Entries) -> Actuator:
    table.refuse_misspelt([field.name for field in fields(Actuator)])
    return Actuator(
        table.number("screw_lead", None, above=0, most=1, unit="m"),
        table.text("joints", ("cardan-cardan", "cardan-ball"), default=None),
        table.number("max_speed", None, above=0, most=100, unit="m/s"),
    )


def base_tilt_of_table(table: Entries) -> BaseTilt:
    """BaseTilt of an [[environment.tilt]].

    Raises FileError for a channel that is no angle, or an axis of no length.
    """
    table.refuse_misspelt(("channel", "axis", "zero"))
    channel, axis = table.text("channel"), table.array("axis", (3,))
    if rig_part_name_problem(channel) or not channel.endswith(tuple(ANGLE_UNITS)):
        table.fail(
            f"channel must name a column of sensors.csv in {' or '.join(ANGLE_UNITS)}, not {channel!r}", "channel"
        )
    size = float(np.linalg.norm(axis))
    if not size > 0:
        table.fail("axis has no direction", "axis")
    return BaseTilt(channel, axis / size, table.number("zero", 0.0, least=-MOST_TILT, most=MOST_TILT, unit="rad"))


def _tilt_sensors(tables: list[Entries], mechanism: Mechanism, gravity: Floats) -> tuple[TiltSensor, ...]:
    """Tilt sensors. Raises FileError for a link that a machine lacks, a name given twice, and without gravity."""
    out, arm = list[TiltSensor](), has_links(mechanism)
    least, most = (0, len(mechanism.axes)) if arm else (1, 1)
    for table in tables:
        table.refuse_misspelt([field.name for field in fields(TiltSensor)])
        name = table.identifier("name")
        if not gravity.any():
            table.fail("a tilt sensor shows angles against gravity, and [environment] gravity is 0", "name", value=name)
        if name in [sensor.name for sensor in out]:
            table.fail(f"tilt sensor {name!r} is listed twice", "name", value=name)
        link = table.whole("link", 0)
        if not least <= link <= most:
            known = f"is 0, the base, to {most}" if arm else "of a machine that is no arm is 1, its platform"
            table.fail(f"{table.name('link')} {known}, not {link}", "link", value=link)
        out.append(
            TiltSensor(
                name,
                link,
                table.number("sigma", above=0, most=0.1, unit="rad"),
                table.array("mount", (3,), default=[0.0, 0.0, 0.0], unit="rad"),
                table.number("mount_sigma", 0.02, above=0, most=0.2, unit="rad"),
            )
        )
    return tuple(out)


def _sensors(table: Entries) -> SensorPort:
    table.refuse_misspelt([field.name for field in fields(SensorPort)])
    channels = table.get("channels")
    if (
        not isinstance(channels, list)
        or not channels
        or not all(isinstance(name, str) and name.isidentifier() for name in channels)
        or (len(set(channels)) != len(channels) or "t" in channels)
    ):
        table.fail(
            f"{table.name('channels')} must list different names of channels, got {channels!r}",
            "channels",
            value=channels,
        )
    stated = table.text("port")
    port = (
        user_program_with_path_beside_rig_toml(table, "port", stated)
        if is_user_file_or_package(stated)
        else port_of_table(table)
    )
    return SensorPort(port, table.whole("baudrate", 1, default=115200), table.text("ask", default=""), tuple(channels))


def _platform(table: Entries) -> Platform:
    table.refuse_misspelt([field.name for field in fields(Platform)])
    return Platform(
        table.number("mass", None, least=0, unit="kg"),
        table.array("centre_of_mass", (3,), None, length_limit=LARGEST_RIG),
        table.array("payload_centre_of_mass", (3,), None, length_limit=LARGEST_RIG),
    )


def _limbs(table: Entries) -> MeasuringLimbs:
    table.refuse_misspelt(("base_joints", "platform_joints", "length_sigma"))
    base, platform = (
        table.array(name, (None, 3), length_limit=LARGEST_RIG) for name in ("base_joints", "platform_joints")
    )
    if len(base) != len(platform) or not len(base):
        table.fail(
            f"{table.name('platform_joints')} must have a row for each of the {len(base)} limbs of "
            f"base_joints, got {len(platform)}",
            "platform_joints",
        )
    return MeasuringLimbs(base, platform, table.number("length_sigma", above=0, most=0.1, unit="m"))


def _sensor(table: Entries) -> Sensor:
    table.refuse_misspelt([field.name for field in fields(Sensor)])
    default = Sensor()
    sensor = Sensor(
        table.number("blur", default.blur, least=0, most=20, unit="px"),
        table.number("defocus", default.defocus, least=0, most=20, unit="px"),
        table.number("vignetting", default.vignetting, least=0, most=1),
        table.number("gain", default.gain, least=0, most=1000, unit="grey levels"),
        table.number("exposure", default.exposure, least=0, most=10, unit="s"),
        read_noise=table.number("read_noise", default.read_noise, least=0, most=100, unit="grey levels"),
        electrons=table.number("electrons", default.electrons, least=0, most=1e6),
        exposures=table.whole("exposures", 1, default.exposures),
        bits=table.whole("bits", 8, default.bits),
    )
    if sensor.bits not in (8, 12):
        table.fail("sensor.bits must be 8 or 12", "bits")
    return sensor


def _targets(tables: list[Entries], bodies: dict[str, str]) -> tuple[Target, ...]:
    targets, owners = list[Target](), dict[int, str]()
    for table in tables:
        listed, board = isinstance(table.tree.get("marker"), list), "board" in table.tree
        of_cube = () if listed else ("edge", "faces", "pose")
        of_kind = ("board", "first", "legacy", "pose") if board else ("dictionary", "marker", *of_cube)
        table.refuse_misspelt(("name", "body", *of_kind))
        name = table.identifier("name")
        if name in [target.name for target in targets]:
            table.fail(f"target {name!r} is listed twice", "name", value=name)
        body = bodies[table.text("body", tuple(bodies))]
        target = _board(table, name, body) if board else (_listed if listed else _cube)(table, name, body)
        dictionary, keys = target.dictionary, list[tuple[str | int, ...]]()
        if board:
            keys = [("first" if "first" in table.tree else "board",)] * len(target.listed)
        else:
            keys = [("faces", face) for face, _ in target.faces]
        for number, key in zip(target.ids, keys or [("marker", i, "id") for i in range(len(target.listed))]):
            if number >= DICTIONARIES[dictionary]:
                table.fail(
                    f"{dictionary} has identities 0..{DICTIONARIES[dictionary] - 1}, not {number}", *key, value=number
                )
            if number in owners:
                table.fail(
                    f"marker {number} of target {name!r} already belongs to {owners[number]}: "
                    "an identity may be used once in a rig",
                    *key,
                    value=number,
                )
            owners[number] = f"target {name!r} (line {table.places[table.path + key][0]})"
        targets.append(target)
    return tuple(targets)


def _board(table: Entries, name: str, body: str) -> Target:
    """Target of the markers of a printed board."""
    text, legacy = table.text("board"), table.flag("legacy", False)
    try:
        board = replace(parse_board(text, table.units), legacy=legacy)
    except RigError as error:
        table.fail(f"{table.name('board')}: {error}", "board", value=text)
    if legacy and board.kind != "charuco":
        table.fail(f"{table.name('legacy')} is of charuco boards alone, not of {board.kind}", "legacy")
    first, T = table.whole("first", 0, default=0), table.pose("pose")
    poses = [T * RigidTransform.from_translation(place) for place in board.in_board_frame(board.places())]
    markers = tuple(Marker(first + i, board.side, place, board.margin) for i, place in enumerate(poses))
    return Target(name, body, board.dictionary, listed=markers, board=board, T_body_board=T)


def _cube(table: Entries, name: str, body: str) -> Target:
    dictionary = table.text("dictionary", tuple(DICTIONARIES))
    edge = table.number("edge", above=0, most=LARGEST_MARKER, unit="m (is it in millimetres?)")
    marker = table.number("marker", above=0, most=LARGEST_MARKER, unit="m (is it in millimetres?)")
    if marker > edge:
        table.fail(
            f"{table.name('marker')} = {table.units.shown(marker, 'm')} does not fit on a cube of edge "
            f"{table.units.shown(edge, 'm')}",
            "marker",
            value=marker,
        )
    faces = table.table("faces")
    if not faces.tree:
        table.fail(f"{table.name('faces')} is empty", "faces")
    for face in faces.tree:
        if face not in FACES:
            faces.fail(f"{face!r} is no face of a cube; there are {', '.join(FACES)}", face, value=face)
    pairs = tuple((face, faces.whole(face, 0)) for face in faces.tree)
    return Target(name, body, dictionary, edge, marker, pairs, table.pose("pose"))


def _listed(table: Entries, name: str, body: str) -> Target:
    dictionary = table.text("dictionary", tuple(DICTIONARIES))
    markers = []
    for row in table.tables("marker"):
        row.refuse_misspelt(("id", "side", "pose", "margin"))
        side = row.number("side", above=0, most=LARGEST_MARKER, unit="m (is it in millimetres?)")
        margin = row.number("margin", default=side / 8, least=0, most=LARGEST_MARKER, unit="m")
        placed = "pose" in row.tree
        markers.append(Marker(row.whole("id", 0), side, row.pose("pose") if placed else None, margin, placed))
    return Target(name, body, dictionary, listed=tuple(markers))
