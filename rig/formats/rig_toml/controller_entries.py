"""Controller entries of rig.toml, table [controller].

What drives a machine's axes, and by which protocol.
"""

from dataclasses import fields

from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, REQUIRED, Entries, Required
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import (
    user_program_with_path_beside_rig_toml,
)
from rig.model import protocol_port_and_user_program_name_checks as names
from rig.model.design import PROTOCOLS, Actuator, Controller
from rig.model.mechanisms.hexapod import home_values
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Mechanism,
    axis_units,
    has_axes,
    has_struts,
    is_hexapod,
    is_redundant,
)


def controller_of_table(table: Entries, mechanism: Mechanism, actuator: Actuator) -> Controller:
    """Controller of a [controller] table.

    actuator : whose max_speed holds where the controller states none

    Raises FileError for what does not suit the mechanism.
    """
    table.refuse_misspelt([field.name for field in fields(Controller)])
    n = len(mechanism.axes)
    if not has_axes(mechanism):
        table.fail(f"[controller] drives axes; a mechanism of kind {mechanism.kind!r} has none")
    units, turns = axis_units(mechanism), "rad" in axis_units(mechanism)
    one = "rad" if {*units} == {"rad"} else "m"  # of a figure that stands for all axes
    if is_redundant(mechanism):
        table.fail(f"[controller] drives six struts, and this platform has {n}: drive it by the lengths of rig correct")
    protocol = _protocol(table)
    axes, fits = table.get("axes", []), names.is_motor_record_name if protocol in names.MOTOR_RECORDS else str.isalnum
    if (
        not isinstance(axes, list)
        or not all(isinstance(name, str) and fits(name) for name in axes)
        or len(set(axes)) not in (0, n)
    ):
        table.fail(f"{table.name('axes')} must list {n} different names, got {axes!r}", "axes", value=axes)
    if turns and protocol in PROTOCOLS and protocol not in names.TURN:
        table.fail(
            f"protocol {protocol} drives axes that slide; joints that turn take {', '.join(names.TURN)}", "protocol"
        )
    homing = table.flag("homing", protocol != "urscript")
    stated = REQUIRED if turns else actuator.max_speed or REQUIRED
    speed = table.each("max_speed", n, stated, above=0, most=100, units=[f"{unit}/s" for unit in units])
    step = table.number("max_step", None, above=0, most=LARGEST_RIG, unit=one)
    home = (
        table.each("home", n, None, above=0, most=LARGEST_RIG, unit="m (joint centre to joint centre)")
        if has_struts(mechanism)
        else table.each("home", n, None, least=-LARGEST_RIG, most=LARGEST_RIG, units=units)
    )
    if protocol == "urscript" and homing and home is None:
        table.fail(f"{table.name('home')} must state where homing = true moves the arm", "homing")
    if protocol == "urscript" and (n != 6 or {*units} != {"rad"}):
        words = ", ".join(mechanism.axis_words)
        table.fail(f"protocol urscript drives six joints that turn; this machine's axes are {words}", "protocol")
    if protocol in names.MOTOR_RECORDS and not axes:
        table.fail(f"protocol {protocol} takes {table.name('axes')}: the names of {n} motor records", "protocol")
    if protocol in names.TAKE_POSES:
        if not is_hexapod(mechanism):
            table.fail(f"protocol {protocol} drives a hexapod, not a mechanism of kind {mechanism.kind!r}", "protocol")
        home = home_values(mechanism) if home is None else home
    kinematics = table.text("kinematics", ("joint", "world"), default="joint")
    if kinematics == "world" and not is_hexapod(mechanism):
        table.fail(
            f'{table.name("kinematics")} = "world" sends poses of a hexapod; a mechanism of kind {mechanism.kind!r} '
            'takes "joint"',
            "kinematics",
        )
    for keys, protocols in ((("work", "tool"), names.TAKE_POSES), (("angles",), names.STATE_ANGLES)):
        for key in [key for key in keys if key in table.tree and protocol not in protocols]:
            table.fail(f"{' and '.join(keys)} are stated of protocol {', '.join(protocols)}", key)
    return Controller(
        protocol,
        port_of_table(table, default=""),
        table.whole("baudrate", 1, default=115200),
        table.text("usb", default=""),
        tuple(axes),
        homing,
        table.each("zero", n, 0.0, least=-LARGEST_RIG, most=LARGEST_RIG, units=units),
        home,
        speed,
        table.each("max_acceleration", n, None, above=0, most=1000, units=[f"{unit}/s^2" for unit in units]),
        table.number("tolerance", 1e-4 if turns else 1e-5, above=0, most=0.01, unit=one),
        step,
        table.number("margin", default=0.1, least=0, most=1),
        table.number("timeout", default=2.0, above=0, most=60, unit="s"),
        table.number("home_timeout", default=120.0, above=0, most=3600, unit="s"),
        table.number("watchdog", default=1.0, above=0, most=60, unit="s"),
        kinematics,
        table.text("password", default="EMC"),
        table.text("enable_password", default="EMCTOO"),
        table.text("ini", default=""),
        table.pose("work") if "work" in table.tree else None,
        table.pose("tool") if "tool" in table.tree else None,
        table.text("angles", tuple(names.ANGLES), default="moving"),
    )


def _protocol(table: Entries) -> str:
    stated = table.text("protocol")
    if names.is_user_file_or_package(stated):
        return user_program_with_path_beside_rig_toml(table, "protocol", stated)
    if stated not in PROTOCOLS:
        table.refuse("protocol", f"one of {', '.join(map(repr, PROTOCOLS))}, file:NAME.py or package:NAME", stated)
    return stated


def port_of_table(table: Entries, default: str | Required = REQUIRED) -> str:
    """Port that a table states. Raises FileError for what is none."""
    port = table.text("port", default=default)
    if problem := names.port_problem(port):
        table.fail(f"{table.name('port')}: {problem}", "port", value=port)
    return port
