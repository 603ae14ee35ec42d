"""Opening of the port at which a controller is: a serial device, a URL of pyserial, or an EPICS IOC."""

from rig.driving.channel_access_port import SCHEME, ChannelAccessPort
from rig.driving.clock import Clock
from rig.driving.serial_port import SerialPort, find_usb_port


def open_port(port: str, usb: str, baudrate: int, clock: Clock) -> SerialPort | ChannelAccessPort:
    """The open port of a controller. port, usb, baudrate : as [controller] states them

    Raises LinkLost where it does not open, MissingLibrary for an IOC without the package that it takes
    """
    if port.partition("://")[0].lower() == SCHEME:
        return ChannelAccessPort(port, clock)
    return SerialPort(find_usb_port(port, usb), baudrate, clock)
