"""The machine: what it is, how it moves, how it is commanded, how it misbehaves.

`load` reads a recording; `load_design` reads a rig.toml alone. What they refuse is a `RigError` that names file, line
and column.
"""

from typing import TYPE_CHECKING

from rig.compute.lazy_package_exports import lazy_getattr
from rig.compute.numba_kernels import set_kernel_cache_folder

if TYPE_CHECKING:
    from rig.errors import RigError as RigError
    from rig.formats.rig_toml.design_file import load_design as load_design
    from rig.model.design import Design as Design
    from rig.recording.recording_folder import Recording as Recording
    from rig.recording.recording_folder import load_recording as load_recording

set_kernel_cache_folder()

__all__ = ["load_recording", "load_design", "Recording", "Design", "RigError"]
__getattr__ = lazy_getattr(
    __name__,
    {
        "load": "rig.recording.recording_folder:load_recording",
        "load_design": "rig.formats.rig_toml.design_file:load_design",
        "Recording": "rig.recording.recording_folder",
        "Design": "rig.model.design",
        "RigError": "rig.errors",
    },
)
