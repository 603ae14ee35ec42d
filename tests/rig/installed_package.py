"""A package of somebody else's with a protocol, a camera and sensors, installed by pip from a wheel of its own."""

import subprocess
import sys
import zipfile

from tests.conftest import ROOT

GREY = 137  # of every image
CAMERA = f'''"""A camera that gives one grey."""

import numpy as np

from rig.driving.base import UserCamera


class Grey(UserCamera):
    def grab(self):
        return np.full((self.camera.height, self.camera.width), {GREY}, np.uint8)
'''
SENSORS = '''"""A gauge and a thermometer."""

from rig.driving.base import UserSensors


class Gauge(UserSensors):
    def read(self):
        return {"gauge": 0.0012, "air_temperature_C": 20.4}
'''
FILES = {
    "acme_machine/__init__.py": "",
    "acme_machine/protocol.py": (ROOT / "rig" / "driving" / "example_user_protocol_with_emulator.py").read_text(),
    "acme_machine/camera.py": CAMERA,
    "acme_machine/sensors.py": SENSORS,
    "acme_machine-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: acme-machine\nVersion: 1.0\n",
    "acme_machine-1.0.dist-info/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    "acme_machine-1.0.dist-info/RECORD": "",
    "acme_machine-1.0.dist-info/entry_points.txt": (
        "[rig.protocols]\nacme = acme_machine.protocol:Acme\n[rig.cameras]\ngrey = acme_machine.camera:Grey\n"
        "[rig.sensors]\ngauge = acme_machine.sensors:Gauge\n"
    ),
}


def install_acme_machine(folder):
    """The folder, for `sys.path`, in which pip installed the package from its wheel."""
    wheel = folder / "acme_machine-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as file:
        for name, text in FILES.items():
            file.writestr(name, text)
    words = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-input"]
    site = folder / "site"
    done = subprocess.run([*words, "--target", str(site), str(wheel)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return site
