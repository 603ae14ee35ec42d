"""Sockets that lock a controller: who listens at the lock's name holds it, until its process ends.

On Linux they are in the abstract namespace: they are no files, so that no folder, environment or umask decides who sees
them and nothing can be planted in their place, and the kernel says which process listens. Elsewhere they are TCP ports
of this computer, numbered by the name, and the holder says itself who it is.
"""

import hashlib
import os
import socket
import struct
import sys
import time
from dataclasses import dataclass

from rig.errors import RigError

ABSTRACT = sys.platform == "linux" and hasattr(socket, "AF_UNIX")
LOOK = 0.05  # s between looks at a lock
LOOKS = 20  # at a lock that is held and does not listen
WAITING = 4096  # callers that may wait; the system may allow fewer
FIRST, PORTS = 20000, 12000  # TCP ports of locks, below those that systems hand out themselves
SILENT = "another process holds the controller and does not identify itself"


@dataclass(frozen=True, slots=True)
class LockHolder:
    """A process that drives. name : of the lock; pid : 0 where it runs in another process namespace; uid : of its
    user, None where the system does not say
    """

    name: str
    pid: int
    uid: int | None

    def __str__(self) -> str:
        own = self.uid is None or self.uid == os.getuid()
        return (f"process {self.pid}" if self.pid else "a process in another container") + (
            "" if own else f" of user {self.user}"
        )

    @property
    def user(self) -> str:
        """Name of its user."""
        if self.uid is None:
            return "its user"
        import pwd

        try:
            return pwd.getpwuid(self.uid).pw_name
        except KeyError:
            return str(self.uid)


def bound_lock_socket(name: str, port: str) -> socket.socket:
    """The listening socket of a lock, now held by this process; it does not block.
    port : of the controller, for messages. Raises RigError naming the process that has it
    """
    held = None
    for _ in range(LOOKS):
        try:
            held = _bound(name)
            break
        except OSError:
            found = connect_to_lock_holder(name)
            if found is not None:
                found[0].close()
                raise RigError(
                    f"{found[1]} is driving the controller at {port}; `rig stop` ends what it does"
                ) from None
        time.sleep(LOOK)  # another is beginning or ending just now
    if held is None:
        raise RigError(f"another process holds the controller at {port} and does not identify itself")
    held.listen(WAITING)
    held.setblocking(False)
    return held


def greet(name: str, caller: socket.socket) -> None:
    """Tell a caller who holds the lock, where the system does not. Raises OSError where the caller is gone."""
    if not ABSTRACT:
        caller.sendall(f"{name} {os.getpid()}\n".encode())


def connect_to_lock_holder(name: str) -> tuple[socket.socket, LockHolder] | None:
    """A connection to the process that holds a lock, and who that is; None where nobody does.
    Raises RigError where it does not identify itself, or the lock's TCP port is another program's.
    """
    caller = socket.socket(socket.AF_UNIX if ABSTRACT else socket.AF_INET, socket.SOCK_STREAM)
    try:
        if ABSTRACT:
            caller.setblocking(False)
            caller.connect(_abstract(name))
            pid, uid, _ = struct.unpack("iII", caller.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
            return caller, LockHolder(name, pid, uid)
        caller.settimeout(LOOK * LOOKS)
        caller.connect(_address(name))
        return caller, LockHolder(name, _greeted_pid(name, caller), None)
    except ConnectionRefusedError:
        caller.close()
        return None
    except (BlockingIOError, TimeoutError):
        caller.close()
        raise RigError(SILENT) from None
    except BaseException:
        caller.close()
        raise


def _bound(name: str) -> socket.socket:
    if ABSTRACT:
        held = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            held.bind(_abstract(name))
        except OSError:
            held.close()
            raise
        return held
    return socket.create_server(_address(name))


def _greeted_pid(name: str, caller: socket.socket) -> int:
    greeting = b""
    try:
        while not greeting.endswith(b"\n") and (more := caller.recv(256)):
            greeting += more
    except ConnectionError:
        greeting = b""
    words = greeting.decode("ascii", "replace").split()
    if not greeting and not words:  # its holder is ending just now
        raise ConnectionRefusedError
    if len(words) != 2 or words[0] != name or not words[1].isdigit():
        raise RigError(
            f"TCP port {_address(name)[1]} of this computer, by which the controller is locked, is in use by another "
            "program: end that one"
        )
    return int(words[1])


def _abstract(name: str) -> bytes:
    return b"\0" + name.encode()


def _address(name: str) -> tuple[str, int]:
    return "127.0.0.1", FIRST + int(hashlib.sha256(name.encode()).hexdigest(), 16) % PORTS
