"""Images to poses: corners, their positions and covariance, cameras and targets adjusted jointly.

`measure` takes a recording (rig.load) to its `MeasurementResult`, as `MeasureOptions` have it: the platform's pose in
every frame with covariance, cameras as adjusted.
"""

from typing import TYPE_CHECKING

from rig.compute.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from vision.api import MeasurementResult as MeasurementResult
    from vision.api import MeasureOptions as MeasureOptions
    from vision.api import measure as measure

__all__ = ["measure", "MeasureOptions", "MeasurementResult"]
__getattr__, __dir__ = lazy_exports(
    __name__, {**dict.fromkeys(("measure", "MeasureOptions"), "vision.api"), "MeasurementResult": "vision.api"}
)
