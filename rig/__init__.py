"""The machine: what it is, how it moves, how it is commanded, how it misbehaves.

`load` reads a recording and `save` writes one; `load_design` reads a rig.toml alone, `new_rig_toml` lays one out.
`plan` chooses configurations to visit, `check` says what a recording's files show of mistakes. What they refuse is a
`RigError` that names file, line and column.
"""

from typing import TYPE_CHECKING

from rig.compute.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from rig.api import CheckResult as CheckResult
    from rig.api import PlannedConfigurations as PlannedConfigurations
    from rig.api import check as check
    from rig.api import load as load
    from rig.api import plan as plan
    from rig.api import save as save
    from rig.errors import RigError as RigError
    from rig.formats.rig_toml.design_from_rig_toml import load_design as load_design
    from rig.model.design import Design as Design
    from rig.planning.layout.shipped_arms_and_layouts import LayoutOptions as LayoutOptions
    from rig.planning.layout.shipped_arms_and_layouts import new_rig_toml as new_rig_toml
    from rig.recording.recording_folder import Recording as Recording

__all__ = [
    "load",
    "save",
    "load_design",
    "new_rig_toml",
    "plan",
    "check",
    "Recording",
    "Design",
    "LayoutOptions",
    "PlannedConfigurations",
    "CheckResult",
    "RigError",
]
__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        **dict.fromkeys(("load", "save", "plan", "check", "CheckResult", "PlannedConfigurations"), "rig.api"),
        "load_design": "rig.formats.rig_toml.design_from_rig_toml:load_design",
        **dict.fromkeys(("LayoutOptions", "new_rig_toml"), "rig.planning.layout.shipped_arms_and_layouts"),
        "Recording": "rig.recording.recording_folder",
        "Design": "rig.model.design",
        "RigError": "rig.errors",
    },
)
