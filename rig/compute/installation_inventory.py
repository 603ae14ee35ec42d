"""Inventory of the installation.

For `rig doctor`: packages, OpenGL, cameras, serial ports, disk space, threads.
"""

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

SPACE = 2e9  # bytes: a recording of a thousand images of a megapixel, and what is made of it
CONTEXT = """
import os
from synthetic.ideal_image_renderer import import_pyrender_without_viewer as opengl
pyrender = opengl()
renderer = pyrender.OffscreenRenderer(8, 8)
from OpenGL.GL import GL_RENDERER, GL_VERSION, glGetString
print(glGetString(GL_RENDERER).decode(), 'OpenGL', glGetString(GL_VERSION).decode(), sep=', ')
renderer.delete()
"""


@dataclass(frozen=True, slots=True)
class InventoryItem:
    """about : what was looked for; state : "ok", "absent" (needed for some things only) or "missing"; text : what was
    found
    todo : what to do, "" where nothing is"""

    about: str
    state: str
    text: str
    todo: str = ""


def installation_inventory() -> list[InventoryItem]:
    """Inventory of the installation.

    Versions come first.
    """
    system = f"Python {platform.python_version()} on {platform.system()} {platform.release()}, {platform.machine()}"
    return [
        InventoryItem("rig", "ok", f"{metadata.version('rig')}, {Path(__file__).parents[2]}"),
        InventoryItem("system", "ok", system),
        *installed_package_inventory_items(),
        check_opengl_drawing(),
        list_video_devices(),
        list_genicam_producers(),
        list_serial_ports_and_access_rights(),
        *working_and_temporary_folder_free_space(),
        usable_cores_and_thread_limits(),
    ]


def installed_package_inventory_items() -> Iterator[InventoryItem]:
    """Inventory items of the installed packages, each with its version.

    Against what rig requires.
    """
    for need in metadata.requires("rig") or ():
        name, least, extra = parse_requirement(need)
        if extra == "test":
            continue
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            yield InventoryItem(
                name,
                "absent" if extra else "missing",
                "not installed",
                f"pip install 'rig[{extra}]'" if extra else f"pip install {name}",
            )
            continue
        old = least is not None and _numbers(version) < _numbers(least)
        yield InventoryItem(
            name,
            "missing" if old else "ok",
            version,
            f"rig needs {least} or newer: pip install -U {name}" if old else "",
        )


def parse_requirement(requirement: str) -> tuple[str, str | None, str | None]:
    """Parse a package requirement.

    Returns (name, least version or None, extra or None)
    """
    name = re.match(r"[\w.-]+", requirement)
    least, extra = (
        re.search(r">=\s*([\w.]+)", requirement.split(";")[0]),
        re.search(r"extra\s*==\s*['\"]([\w-]+)", requirement),
    )
    return name[0] if name else requirement, least and least[1], extra and extra[1]


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version)[:3])


def check_opengl_drawing() -> InventoryItem:
    """Check of whether OpenGL draws, as an InventoryItem.

    Tried in a child process, since a broken driver ends its process.
    """
    try:
        done = subprocess.run([sys.executable, "-c", CONTEXT], capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        return InventoryItem("OpenGL", "absent", "no answer within 60 s", "drawing images does not work; all else does")
    if done.returncode == 0:
        return InventoryItem("OpenGL", "ok", done.stdout.strip())
    message = (done.stderr.strip().splitlines() or [f"ended by status {done.returncode}"])[-1]
    return InventoryItem(
        "OpenGL",
        "absent",
        message,
        "drawing images (simulate --images, emulate --cameras) does not work; all else does",
    )


def list_video_devices(device_folder: Path = Path("/sys/class/video4linux")) -> InventoryItem:
    """List the cameras (video devices) by name.

    None is opened.
    """
    entries = sorted(device_folder.iterdir()) if device_folder.is_dir() else []
    names = [f"/dev/{one.name} ({(one / 'name').read_text().strip()})" for one in entries]
    return InventoryItem(
        "cameras",
        "ok" if names else "absent",
        ", ".join(names) or "no video device",
        "" if names else "plug one in, or name a folder of images in [[camera]] of rig.toml",
    )


def list_genicam_producers() -> InventoryItem:
    """List the installed GenICam producers (GenTL files)."""
    folders = [Path(folder) for folder in os.environ.get("GENICAM_GENTL64_PATH", "").split(os.pathsep) if folder]
    files = [file.name for folder in folders if folder.is_dir() for file in sorted(folder.glob("*.cti"))]
    todo = "only for GenICam cameras: install the maker's producer, which sets GENICAM_GENTL64_PATH"
    return InventoryItem(
        "GenICam producers", "ok" if files else "absent", ", ".join(files) or "none", "" if files else todo
    )


def list_serial_ports_and_access_rights() -> InventoryItem:
    """List serial ports, and whether this user may open them."""
    from serial.tools import list_ports

    found = [port for port in list_ports.comports() if port.hwid != "n/a"]
    closed = [port.device for port in found if not os.access(port.device, os.R_OK | os.W_OK)]
    text = ", ".join(f"{port.device} ({port.description})" for port in found) or "no serial port"
    if closed:
        return InventoryItem(
            "ports",
            "absent",
            text,
            f"this user may not open {', '.join(closed)}: add them to the group dialout and log in again",
        )
    return InventoryItem(
        "ports",
        "ok" if found else "absent",
        text,
        "" if found else "plug the controller in, or name socket://HOST:PORT in [controller]",
    )


def working_and_temporary_folder_free_space() -> Iterator[InventoryItem]:
    """Free disk space in the working folder and in the folder of temporary files."""
    for name, folder in (("space here", Path.cwd()), ("temporary space", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free
        writable = os.access(folder, os.W_OK)
        todo = (
            ""
            if free > SPACE and writable
            else "free some: a thousand images take about 2 GB"
            if writable
            else "choose a folder of your own"
        )
        text = f"{free / 1e9:.1f} GB free in {folder}{'' if writable else ', which cannot be written'}"
        yield InventoryItem(name, "ok" if not todo else "absent", text, todo)


def usable_cores_and_thread_limits() -> InventoryItem:
    """Cores that this process may use, and environment variables that limit its threads."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limits = [f"{name}={os.environ[name]}" for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS") if name in os.environ]
    return InventoryItem(
        "threads", "ok", f"{cores} of {os.cpu_count()} cores" + (f", {', '.join(limits)}" if limits else "")
    )
