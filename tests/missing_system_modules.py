"""What the system that runs the tests lacks: a test that comes to need it is skipped, and the reason says what."""

import importlib
import importlib.util
import re
import sys

MODULES = {  # for which the code or a test has no substitute, and what they are for
    "fcntl": "locks on files and ports",
    "termios": "serial ports and terminals",
    "pty": "pseudo-terminals",
    "resource": "limits of processes",
    "pinocchio": "another library's kinematics, to compare with",
}
ATTRIBUTES = {
    "os": ("openpty", "fork", "register_at_fork", "geteuid", "mkfifo", "fchmod", "sysconf", "killpg"),
    "signal": ("SIGHUP", "SIGKILL"),
    "socket": ("AF_UNIX",),
}
MODULE = re.compile(r"No module named '(\w+)")
ATTRIBUTE = re.compile(r"module '(\w+)' has no attribute '(\w+)'")


def is_absent(module: str, attribute: str = "") -> bool:
    """Whether this system has no such module, or no such attribute of one."""
    if not attribute:
        return importlib.util.find_spec(module) is None
    return not hasattr(importlib.import_module(module), attribute)


def missing_part(complaint: str) -> str | None:
    """Why a test with a complaint is skipped: it needs what this system lacks; None for any other complaint."""
    for name in MODULE.findall(complaint):
        if name in MODULES and is_absent(name):
            return f"needs the module {name} ({MODULES[name]}), which {sys.platform} does not have"
    for module, name in ATTRIBUTE.findall(complaint):
        if name in ATTRIBUTES.get(module, ()) and is_absent(module, name):
            return f"needs {module}.{name}, which {sys.platform} does not have"
    if sys.platform != "linux" and "rendering needs OpenGL through EGL" in complaint:
        return f"draws pictures by OpenGL through EGL, which {sys.platform} does not have"
    return None
