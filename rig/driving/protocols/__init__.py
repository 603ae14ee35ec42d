"""Kinds of controllers, one module each, all offering rig.driving.protocols.protocol_interface.Protocol."""

from rig.driving.protocols.protocol_interface import Protocol
from rig.driving.protocols.protocol_selection import protocol_of_controller

__all__ = ["Protocol", "protocol_of_controller"]
