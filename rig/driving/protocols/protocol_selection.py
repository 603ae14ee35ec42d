"""Selection of the protocol stated for the controller in rig.toml."""

from rig.driving.protocols.gcs import GCS
from rig.driving.protocols.grblhal import GrblHAL
from rig.driving.protocols.linuxcnc import LinuxCNC
from rig.driving.protocols.own_strut_protocol import Struts
from rig.driving.protocols.protocol_interface import Protocol
from rig.model.design import Controller


def protocol_of_controller(controller: Controller, axis_count: int) -> Protocol:
    """The Protocol of a controller that drives `axis_count` axes. Raises ValueError for an unknown protocol.
    Raises ValueError for a protocol that there is not.
    """
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
