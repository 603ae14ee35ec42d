"""Kinds of controllers, one module each.

All offer rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol.
"""

from rig.driving.protocols.protocol_interface_and_user_line_protocol import Protocol
from rig.driving.protocols.protocol_selection_and_user_protocols import protocol_of_controller

__all__ = ["Protocol", "protocol_of_controller"]
