"""One process drives a controller: a lock that goes with the process, and by which another can ask it to stop."""

import fcntl
import hashlib
import os
import signal
import stat
import tempfile
from pathlib import Path

from rig.clock import Clock
from rig.errors import RigError

KILLED = 2.0  # s in which a process that was killed is gone
LOOK = 0.05  # s between looks at whether the other has ended


class Occupied:
    """Holds the controller at a port for this process. Raises RigError naming the process that has it."""

    def __init__(self, port: str) -> None:
        self._file = os.open(_path(port), os.O_RDWR | os.O_CREAT, 0o600)
        if not _locked(self._file):
            other = _process(self._file)
            os.close(self._file)
            raise RigError(f"process {other} is driving the controller at {port}; `rig stop` ends what it does")
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, str(os.getpid()).encode(), 0)

    def __enter__(self) -> "Occupied":
        return self

    def __exit__(self, *_: object) -> None:
        os.ftruncate(self._file, 0)
        os.close(self._file)


def interrupt(port: str, clock: Clock, patience: float) -> int | None:
    """Have the process that drives the controller at a port stop the struts and end, and wait until it has let go.

    patience : s after which one that has not is killed. It is asked by SIGTERM, as a shell's background job ignores SIGINT
    Returns its number, or None where nobody drives. Raises RigError where it does not let go, or belongs to somebody else
    """
    handle = os.open(_path(port), os.O_RDWR | os.O_CREAT, 0o600)
    try:
        if _locked(handle):
            return None
        other = _process(handle)
        if not other:
            raise RigError(f"another process holds the controller at {port} and does not say which it is")
        for number, wait in ((signal.SIGTERM, patience), (signal.SIGKILL, KILLED)):
            try:
                os.kill(other, number)
            except OSError as error:
                raise RigError(f"process {other} drives the controller at {port} and cannot be asked to stop: {error.strerror}") from None
            end = clock.now() + wait
            while clock.now() <= end:
                if _locked(handle):
                    return other
                clock.sleep(LOOK)
        raise RigError(f"process {other} was killed and still holds the controller at {port}: use the rig's own emergency stop")
    finally:
        os.close(handle)


def _path(port: str) -> Path:
    """The lock of a port, in a folder of this user's own."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "rig" if runtime else Path(tempfile.gettempdir()) / f"rig-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise RigError(f"{folder} should be a folder that only this user writes to, and is not")
    return folder / (hashlib.sha256(os.path.realpath(port).encode() if os.path.exists(port) else port.encode()).hexdigest()[:16] + ".lock")


def _locked(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _process(handle: int) -> int:
    text = os.pread(handle, 20, 0).decode("ascii", "replace")
    return int(text) if text.isdigit() else 0
