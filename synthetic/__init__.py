"""A simulated rig: a secret machine, its recordings and images, blind campaigns.

`simulate` takes a rig.toml to a recording (`SimulationResult`), as `SimulateOptions` and `ImageOptions` have it;
`simulate_with_and_without_findings` simulates a diagnosed recording, with and without the findings.
"""

from typing import TYPE_CHECKING

from rig.compute.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from synthetic.api import ImageOptions as ImageOptions
    from synthetic.api import SimulateOptions as SimulateOptions
    from synthetic.api import SimulationResult as SimulationResult
    from synthetic.api import simulate as simulate
    from synthetic.api import simulate_with_and_without_findings as simulate_with_and_without_findings

__all__ = ["simulate", "simulate_with_and_without_findings", "SimulateOptions", "ImageOptions", "SimulationResult"]
__getattr__, __dir__ = lazy_exports(__name__, dict.fromkeys(__all__, "synthetic.api"))
