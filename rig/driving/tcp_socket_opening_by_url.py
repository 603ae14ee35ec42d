"""Opening of a TCP socket to a controller by its URL; others read and write.

It imports nothing that takes time.
"""

import socket
from urllib.parse import urlsplit

from rig.errors import LinkLost
from rig.model.protocol_port_and_user_program_name_checks import USUAL_PORTS


def connect_tcp_socket(url: str, patience: float) -> socket.socket:
    """TCP socket connected to the host and port of a URL.

    SCHEME://HOST or SCHEME://HOST:PORT; it delays nothing that is sent.
    patience : s to connect, and its timeout from then on. Raises LinkLost where nothing listens
    """
    parts = urlsplit(url)
    try:
        found = socket.create_connection(
            (parts.hostname or "127.0.0.1", parts.port or USUAL_PORTS[parts.scheme]), patience
        )
    except OSError as error:
        raise LinkLost(f"cannot open {url}: {error.strerror or error}") from None
    found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return found
