"""Kinds of controllers, one module each, all offering rig.driving.protocols.protocol_bases.Protocol."""

from rig.driving.protocols.protocol_bases import Protocol
from rig.driving.protocols.protocol_selection_and_user_protocols import protocol_of_controller

__all__ = ["Protocol", "protocol_of_controller"]
