"""Controller lock, and the stop of the process that holds it.

One process drives a controller.
Who holds the lock, and how that process is stopped.

The lock is a listening socket, named by the device: who listens at the name holds it, until its process ends. On Linux
sockets are in the abstract namespace: they are no files, so that no folder, environment or umask decides who sees them
and nothing can be planted in their place, and the kernel says which process listens. Elsewhere they are TCP ports of
this computer, numbered by the name, and the holder says itself who it is.
"""

import hashlib
import os
import select
import signal
import socket
import stat
import struct
import sys
import threading
import time
from contextlib import suppress
from typing import NamedTuple
from urllib.parse import urlsplit

from rig.driving.driving_clock import Clock
from rig.errors import LinkLost, RigError
from rig.model.protocol_port_and_user_program_name_checks import USUAL_PORTS

ABSTRACT = sys.platform == "linux" and hasattr(socket, "AF_UNIX")
LOOK = 0.05  # s between looks at a lock
LOOKS = 20  # at a lock that is held and does not listen
WAITING = 4096  # callers that may wait; the system may allow fewer
FIRST, PORTS = 20000, 12000  # TCP ports of locks, below those that systems hand out themselves
SILENT = "another process holds the controller and does not identify itself"


class LockHolder(NamedTuple):
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


def acquire_lock_socket(name: str, port: str) -> socket.socket:
    """The listening socket of a lock, now held by this process.

    It does not block.
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


def send_lock_name_and_process_id(name: str, caller: socket.socket) -> None:
    """Send a caller the name of the lock and the process number of this process.

    This process holds the lock.
    Only where the system does not tell it. Raises OSError where the caller is gone.
    """
    if not ABSTRACT:
        caller.sendall(f"{name} {os.getpid()}\n".encode())


def connect_to_lock_holder(name: str) -> tuple[socket.socket, LockHolder] | None:
    """Connect to the process that holds a lock.

    Returns the connection and the LockHolder.
    None where nobody does.
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


KILLED = 2.0  # s in which a process that was killed is gone
KILL: int = getattr(signal, "SIGKILL", signal.SIGTERM)  # Windows ends a process at once by either
STOP = b"stop"  # what is sent to a process that this user may not signal
_held: set[socket.socket] = set()  # of this process, which no forked child may hold on to


class ControllerLock:
    """Holds the controller at a port for this process. Raises RigError naming the process that has it.

    Within its context callers are answered; before that they wait.
    port : as [controller] states it, or the USB device's number; usb : of [controller], "" where none is stated
    """

    def __init__(self, port: str, usb: str = "") -> None:
        self._sockets: dict[socket.socket, str] = {}
        self._wake, self._woken = socket.socketpair()  # ends the wait of the thread
        _held.update((self._wake, self._woken))
        self._open = True
        try:
            for name in names_of_all_locks_of_controller(port, usb):
                held = acquire_lock_socket(name, port or usb)
                self._sockets[held] = name
                _held.add(held)
        except BaseException:
            self._close()
            raise
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> "ControllerLock":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._open = False
        with suppress(OSError):  # closed, in a forked child
            self._wake.send(b"\0")
        if self._thread.ident is not None:
            self._thread.join()
        self._close()

    def _close(self) -> None:
        for held in (*self._sockets, self._wake, self._woken):
            _held.discard(held)
            held.close()

    def _listen(self) -> None:
        """Take callers: those who look who drives send nothing; whoever sends STOP has this process end as SIGTERM
        does.
        """
        while self._open:
            for held in select.select([*self._sockets, self._woken], [], [])[0]:
                if held is self._woken:
                    return
                try:
                    caller = held.accept()[0]
                except OSError:  # closed; or out of open files, which may pass
                    time.sleep(LOOK if self._open else 0)
                    continue
                with caller:
                    caller.settimeout(LOOK)
                    if self._open and _received(self._sockets[held], caller) == STOP:
                        _end_this_process()


def ask_lock_holder_to_end(port: str, usb_id: str = "") -> LockHolder | None:
    """Ask the process that holds a controller's lock to end.

    It halts the struts then.
    By SIGTERM, as a shell's background job ignores SIGINT; over its lock where it is another user's or the system does
    not say whose.
    Returns it, or None where nobody drives.
    """
    holder = next(
        (found for name in names_of_all_locks_of_controller(port, usb_id) if (found := _lock_holder(name))), None
    )
    if holder is not None:
        _ask_to_end(holder)
    return holder


def await_or_kill_lock_holder(holder: LockHolder, port: str, clock: Clock, timeout: float) -> None:
    """Await that a process asked to end no longer holds its lock, and kill it after `timeout` (s).

    port : of the controller, for messages
    Raises RigError where it does not let go
    """
    for kill, wait in ((False, timeout), (True, KILLED)):
        if kill:
            _kill(holder, port)
        end = clock.now() + wait
        while clock.now() <= end:
            if _lock_holder(holder.name) != holder:
                return
            clock.sleep(LOOK)
    raise RigError(f"{holder} was killed and still holds the controller at {port}: use the rig's own emergency stop")


def names_of_all_locks_of_controller(port: str, usb_id: str = "") -> list[str]:
    """Names of all locks of the controller at a port.

    By device, path, network address and USB number.
    """
    words = set()
    if usb_id:
        from rig.driving.serial_and_epics_ports_and_checksummed_frames import find_usb_port

        words.add(f"usb {usb_id.lower()}")
        try:
            port = find_usb_port(port, usb_id)
        except LinkLost:  # not plugged in now; who drives it holds the name by its number
            port = ""
    if "://" in port:
        words |= _addresses(port)
    elif port:
        words |= _device(port)
    return sorted(f"rig-driver-{hashlib.sha256(os.fsencode(word)).hexdigest()[:32]}" for word in words)


def _lock_holder(name: str) -> LockHolder | None:
    """The process that holds a lock, or None. Raises RigError where it does not identify itself."""
    found = connect_to_lock_holder(name)
    if found is None:
        return None
    found[0].close()
    return found[1]


def _ask_to_end(holder: LockHolder) -> None:
    """Ask a process to halt and end: by SIGTERM where the system says which it is and permits that, else over its
    lock.
    """
    if holder.pid and holder.uid is not None:
        try:
            os.kill(holder.pid, signal.SIGTERM)
            return
        except ProcessLookupError:
            return  # it has ended by itself
        except PermissionError:
            pass  # another user's
    if (found := connect_to_lock_holder(holder.name)) is not None:
        with found[0] as caller:
            if found[1] == holder:
                caller.send(STOP)


def _kill(holder: LockHolder, port: str) -> None:
    """Kill a process. Raises RigError where that is not permitted or its number is not known."""
    with suppress(PermissionError, ProcessLookupError):
        if holder.pid:
            os.kill(holder.pid, KILL)
            return
    if _lock_holder(holder.name) == holder:
        raise RigError(
            f"{holder} drives the controller at {port} and does not stop; only {holder.user} or root can kill it: "
            "use the rig's own emergency stop"
        )


def _addresses(url: str) -> set[str]:
    """Words for the TCP port that a URL names, one for each address of its host; the URL itself where it names none."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or USUAL_PORTS.get(parts.scheme)
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
    words = {f"path {os.path.normcase(os.path.realpath(path))}"}  # COM3 and com3 are one
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return words
    if stat.S_ISCHR(status.st_mode) and hasattr(os, "major"):  # on Windows a port has one name and no number
        words.add(f"device {os.major(status.st_rdev)}:{os.minor(status.st_rdev)}")
    return words


def _received(name: str, caller: socket.socket) -> bytes:
    try:
        send_lock_name_and_process_id(name, caller)
        return caller.recv(len(STOP))
    except OSError:  # silent, or gone
        return b""


def _end_this_process() -> None:
    """End as SIGTERM does."""
    if sys.platform == "win32":  # whose os.kill ends a process without its handlers
        signal.raise_signal(signal.SIGTERM)
    else:
        os.kill(os.getpid(), signal.SIGTERM)


def _let_go() -> None:
    """In a forked child: the lock is the parent's alone, and ends with it."""
    for held in _held:
        held.close()
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)
