"""The protocol of a controller, chosen by what its rig.toml states."""

from rig.driving.protocols.gcs import GCS
from rig.driving.protocols.grblhal import GrblHAL
from rig.driving.protocols.linuxcnc import LinuxCNC
from rig.driving.protocols.own_strut_protocol import Struts
from rig.driving.protocols.protocol_interface import Protocol
from rig.model.controller_settings import Controller


def of(controller: Controller, count: int) -> Protocol:
    """The protocol of a controller that drives `count` axes. Raises ValueError for a protocol that there is not."""
    if controller.protocol == "grblhal":
        return GrblHAL(controller.axes or tuple("XYZABC"[:count]))
    if controller.protocol == "gcs":
        return GCS(controller.axes, count)
    if controller.protocol == "struts":
        return Struts(count, controller.watchdog)
    if controller.protocol == "linuxcnc":
        return LinuxCNC(
            controller.axes or tuple("XYZABC"[:count]),
            controller.kinematics,
            controller.password,
            controller.enable_password,
        )
    raise ValueError(f"no protocol {controller.protocol!r}")
