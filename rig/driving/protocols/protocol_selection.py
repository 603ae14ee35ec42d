"""Selection of the protocol stated for the controller in rig.toml."""

from rig.driving.protocols.gcs import GCS
from rig.driving.protocols.grblhal import GrblHAL
from rig.driving.protocols.linuxcnc import LinuxCNC
from rig.driving.protocols.own_strut_protocol import Struts
from rig.driving.protocols.protocol_interface import Protocol
from rig.driving.protocols.user_protocol import load_user_protocol
from rig.model.controller_protocol_list_and_port_name_check import is_user_program
from rig.model.design import Controller


def protocol_of_controller(controller: Controller, axis_count: int) -> Protocol:
    """The Protocol of a controller that drives `axis_count` axes. A program of the user's own is run for it.

    Raises ValueError for a protocol that there is not, FileError and RigError for a program that cannot be used
    """
    if is_user_program(controller.protocol):
        return load_user_protocol(controller, axis_count)
    if controller.protocol == "grblhal":
        return GrblHAL(controller.axes or tuple("XYZABC"[:axis_count]))
    if controller.protocol == "gcs":
        return GCS(controller.axes, axis_count)
    if controller.protocol == "struts":
        return Struts(axis_count, controller.watchdog)
    if controller.protocol == "linuxcnc":
        return LinuxCNC(
            controller.axes or tuple("XYZABC"[:axis_count]),
            controller.kinematics,
            controller.password,
            controller.enable_password,
        )
    raise ValueError(f"no protocol {controller.protocol!r}")
