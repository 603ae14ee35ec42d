"""The machine: what it is, how it moves, how it is commanded, how it misbehaves.

`load` reads a recording; `load_design` reads a rig.toml alone. What they refuse is a `RigError` that names file, line and column.
"""

from typing import TYPE_CHECKING

from rig.compiled import keep_kernels
from rig.lazily import handed_on

if TYPE_CHECKING:
    from rig.design import Design as Design
    from rig.design_file import load as load_design
    from rig.errors import RigError as RigError
    from rig.recording import Recording as Recording
    from rig.recording import load as load

keep_kernels()

__all__ = ["load", "load_design", "Recording", "Design", "RigError"]
__getattr__ = handed_on(__name__, {"load": "rig.recording", "load_design": "rig.design_file:load", "Recording": "rig.recording",
                                   "Design": "rig.design", "RigError": "rig.errors"})
