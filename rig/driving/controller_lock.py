"""Controller lock: one process drives a controller; who holds the lock, and how that process is stopped.

The lock is a listening socket in Linux's abstract namespace, named by the device: it is no file, so that no folder,
environment or umask decides who sees it and nothing can be planted in its place, and the kernel says which process
listens.
"""

import hashlib
import os
import pwd
import select
import signal
import socket
import stat
import struct
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import urlsplit

from rig.driving.clock import Clock
from rig.errors import LinkLost, RigError

KILLED = 2.0  # s in which a process that was killed is gone
LOOK = 0.05  # s between looks at whether the other has ended
STOP = b"stop"  # what is sent to a process that this user may not signal
LOOKS = 20  # at a lock that is held and does not listen
WAITING = 4096  # callers that may wait; the system may allow fewer
_held: set[socket.socket] = set()  # of this process, which no forked child may hold on to


@dataclass(frozen=True, slots=True)
class LockHolder:
    """A process that drives. name : of the lock; pid : 0 where it runs in another process namespace; uid : of its
    user
    """

    name: bytes
    pid: int
    uid: int

    def __str__(self) -> str:
        own = self.uid == os.getuid()
        return (f"process {self.pid}" if self.pid else "a process in another container") + (
            "" if own else f" of user {_user(self.uid)}"
        )


class ControllerLock:
    """Holds the controller at a port for this process. Raises RigError naming the process that has it.

    port : as [controller] states it, or the USB device's number; usb : of [controller], "" where none is stated
    """

    def __init__(self, port: str, usb: str = "") -> None:
        self._sockets: list[socket.socket] = []
        self._open = True
        try:
            for name in lock_names(port, usb):
                self._sockets.append(_bound(name, port or usb))
        except BaseException:
            self._close()
            raise
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> "ControllerLock":
        return self

    def __exit__(self, *_: object) -> None:
        self._open = False
        for held in self._sockets:
            with suppress(OSError):  # closed, in a forked child
                held.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._close()

    def _close(self) -> None:
        for held in self._sockets:
            _held.discard(held)
            held.close()

    def _listen(self) -> None:
        """Take callers: those who look who drives send nothing; whoever sends STOP has this process end as SIGTERM
        does.
        """
        while self._open:
            for held in select.select(self._sockets, [], [])[0]:
                try:
                    caller = held.accept()[0]
                except OSError:  # closed; or out of open files, which may pass
                    time.sleep(LOOK if self._open else 0)
                    continue
                with caller:
                    caller.settimeout(LOOK)
                    if self._open and _received(caller) == STOP:
                        os.kill(os.getpid(), signal.SIGTERM)


def stop_lock_holder(port: str, clock: Clock, timeout: float, usb_id: str = "") -> int | None:
    """Stop the process that holds a controller's lock: it halts the struts and ends, or is killed after `timeout`.

    timeout : s after which one that has not is killed. It is asked by SIGTERM, as a shell's background job ignores
    SIGINT; one of another user over its lock
    Returns its number, or None where nobody drives. Raises RigError where it does not let go
    """
    names = lock_names(port, usb_id)
    holder = next((found for name in names if (found := _lock_holder(name))), None)
    if holder is None:
        return None
    for number, wait in ((signal.SIGTERM, timeout), (signal.SIGKILL, KILLED)):
        _ask(holder, number, port or usb_id)
        end = clock.now() + wait
        while clock.now() <= end:
            if _lock_holder(holder.name) != holder:
                return holder.pid
            clock.sleep(LOOK)
    raise RigError(
        f"{holder} was killed and still holds the controller at {port or usb_id}: use the rig's own emergency stop"
    )


def lock_names(port: str, usb_id: str = "") -> list[bytes]:
    """Names of all locks of the controller at a port: by device, path, network address and USB number."""
    words = set()
    if usb_id:
        from rig.driving.serial_port import find_usb_port

        words.add(f"usb {usb_id.lower()}")
        try:
            port = find_usb_port(port, usb_id)
        except LinkLost:  # not plugged in now; who drives it holds the name by its number
            port = ""
    if "://" in port:
        words |= _addresses(port)
    elif port:
        words |= _device(port)
    return sorted(b"\0rig-driver-" + hashlib.sha256(os.fsencode(word)).hexdigest()[:32].encode() for word in words)


def _lock_holder(name: bytes) -> LockHolder | None:
    """The process that holds a lock, or None. Raises RigError where it does not identify itself."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.setblocking(False)
        try:
            caller.connect(name)
        except ConnectionRefusedError:
            return None
        except BlockingIOError:
            raise RigError("another process holds the controller and does not identify itself") from None
        return _peer(name, caller)


def _peer(name: bytes, connected: socket.socket) -> LockHolder:
    pid, uid, _ = struct.unpack("iII", connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return LockHolder(name, pid, uid)


def _bound(name: bytes, port: str) -> socket.socket:
    """A lock, held. Raises RigError naming the process that has it."""
    held = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    for _ in range(LOOKS):
        try:
            held.bind(name)
            break
        except OSError:
            if (holder := _lock_holder(name)) is not None:
                held.close()
                raise RigError(f"{holder} is driving the controller at {port}; `rig stop` ends what it does") from None
        time.sleep(LOOK)  # another is beginning or ending just now
    else:
        held.close()
        raise RigError(f"another process holds the controller at {port} and does not identify itself")
    held.listen(WAITING)
    held.setblocking(False)
    _held.add(held)
    return held


def _ask(holder: LockHolder, number: signal.Signals, port: str) -> None:
    """Have a process end: by a signal where that is permitted, else over its lock. Raises RigError where neither can
    end it.
    """
    try:
        if holder.pid:
            os.kill(holder.pid, number)
            return
    except ProcessLookupError:
        return  # it has ended by itself
    except PermissionError:
        pass  # another user's: it is asked over its lock
    if number != signal.SIGTERM:
        raise RigError(
            f"{holder} drives the controller at {port} and does not stop; only {_user(holder.uid)} or root "
            "can kill it: "
            "use the rig's own emergency stop"
        )
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.setblocking(False)
        try:
            caller.connect(holder.name)
            if _peer(holder.name, caller) == holder:
                caller.send(STOP)
        except ConnectionRefusedError:
            return  # it has ended by itself


def _addresses(url: str) -> set[str]:
    """Words for the TCP port that a URL names, one for each address of its host; the URL itself where it names none."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or port is None:
        return {url}
    try:
        return {f"tcp {found[4][0]} {port}" for found in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)}
    except OSError:  # a name that cannot be resolved now
        return {f"tcp {host} {port}"}


def _device(path: str) -> set[str]:
    """Words for a device: its real path, and its number where it is there."""
    words = {f"path {os.path.realpath(path)}"}
    try:
        there = os.stat(path)
    except (OSError, ValueError):
        return words
    if stat.S_ISCHR(there.st_mode):
        words.add(f"device {os.major(there.st_rdev)}:{os.minor(there.st_rdev)}")
    return words


def _received(caller: socket.socket) -> bytes:
    try:
        return caller.recv(len(STOP))
    except OSError:  # silent, or gone
        return b""


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _let_go() -> None:
    """In a forked child: the lock is the parent's alone, and ends with it."""
    for held in _held:
        held.close()
    _held.clear()


os.register_at_fork(after_in_child=_let_go)
