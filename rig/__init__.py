"""The machine: what it is, how it moves, how it is commanded, how it misbehaves.

`load` reads a recording; `load_design` reads a rig.toml alone. What they refuse is a `RigError` that names file, line
and column.
"""

from typing import TYPE_CHECKING

from rig.compute.kernel_cache import keep_kernels
from rig.compute.lazy_exports import handed_on

if TYPE_CHECKING:
    from rig.errors import RigError as RigError
    from rig.formats.rig_toml.design_file import load as load_design
    from rig.model.design import Design as Design
    from rig.recording.recording_folder import Recording as Recording
    from rig.recording.recording_folder import load as load

keep_kernels()

__all__ = ["load", "load_design", "Recording", "Design", "RigError"]
__getattr__ = handed_on(
    __name__,
    {
        "load": "rig.recording.recording_folder",
        "load_design": "rig.formats.rig_toml.design_file:load",
        "Recording": "rig.recording.recording_folder",
        "Design": "rig.model.design",
        "RigError": "rig.errors",
    },
)
