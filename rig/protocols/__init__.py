"""Kinds of controllers, one module each, all offering rig.protocols.base.Protocol."""

from rig.controller import Controller
from rig.protocols.base import Protocol
from rig.protocols.gcs import GCS
from rig.protocols.grblhal import GrblHAL
from rig.protocols.linuxcnc import LinuxCNC
from rig.protocols.struts import Struts


def of(controller: Controller, count: int) -> Protocol:
    """The protocol of a controller that drives `count` axes. Raises ValueError for a protocol that there is not."""
    if controller.protocol == "grblhal":
        return GrblHAL(controller.axes or tuple("XYZABC"[:count]))
    if controller.protocol == "gcs":
        return GCS(controller.axes, count)
    if controller.protocol == "struts":
        return Struts(count, controller.watchdog)
    if controller.protocol == "linuxcnc":
        return LinuxCNC(controller.axes or tuple("XYZABC"[:count]), controller.kinematics, controller.password, controller.enable_password)
    raise ValueError(f"no protocol {controller.protocol!r}")
