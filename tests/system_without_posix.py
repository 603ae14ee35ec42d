"""What Windows lacks of the standard library, taken away from a process on another system.

It stands in for Windows in what the product imports and calls; file names, drives and modes stay those of the system.
"""

import importlib
import os
import pkgutil
import shutil
import signal
import socket
import sys

MODULES = ("fcntl", "termios", "pty", "tty", "resource", "pwd", "grp", "syslog")
ATTRIBUTES = {
    os: "fork forkpty getuid geteuid getgid getegid getgroups chown fchmod fchown lchown register_at_fork openpty "
    "ttyname mkfifo mknod killpg setsid getpgid getsid sysconf sched_getaffinity uname set_blocking nice pread "
    "pwrite O_NOFOLLOW O_CLOEXEC O_DIRECTORY O_NONBLOCK O_NOCTTY O_SYNC",
    signal: "SIGHUP SIGKILL SIGALRM SIGUSR1 SIGUSR2 SIGPIPE SIGQUIT SIGCHLD pthread_sigmask pause alarm setitimer",
    socket: "AF_UNIX SO_PEERCRED SO_REUSEPORT",
}
# Other people's libraries, which have an edition of their own for Windows: imported as the edition of this system.
LIBRARIES = (
    "multiprocessing.pool",
    "multiprocessing.popen_spawn_posix",
    "subprocess",
    "concurrent.futures.process",
    "tempfile",
    "serial.tools.list_ports",
    "numpy",
    "scipy.optimize",
    "cv2",
    "numba",
    "threadpoolctl",
    "tqdm",
)


def take_posix_away() -> None:
    """From here on this process has no more than Windows has; what it has imported before keeps what it took."""
    for name in LIBRARIES:
        importlib.import_module(name)
    for name in MODULES:
        sys.modules[name] = None
    for module, names in ATTRIBUTES.items():
        for name in names.split():
            if hasattr(module, name):
                delattr(module, name)
    os.supports_dir_fd.clear()
    os.supports_fd.clear()
    shutil._use_fd_functions = False
    for name in ("open", "replace", "rename", "unlink", "remove", "rmdir", "mkdir", "stat"):
        setattr(os, name, _without_folders(name, getattr(os, name)))


def _without_folders(name, function):
    def call(path, *rest, **named):
        if any(named.get(word) is not None for word in ("dir_fd", "src_dir_fd", "dst_dir_fd")):
            raise NotImplementedError(f"os.{name} takes no dir_fd on this system")
        if name == "open" and os.path.isdir(path):
            raise PermissionError(13, "Permission denied", path)
        return function(path, *rest, **named)

    return call


def import_every_module() -> int:
    """How many modules the product has, all imported. Raises what one of them raises."""
    names = []
    for package in ("rig", "vision", "calib", "synthetic"):
        folder = importlib.import_module(package).__path__
        names += [found.name for found in pkgutil.walk_packages(folder, f"{package}.")]
    for name in names:
        if not name.endswith("__main__"):
            importlib.import_module(name)
    return len(names)
