"""Poses to a better rig: parameters, corrections, what is promised of them, and what physics was left out.

`calibrated` takes a recording (rig.load) to its `Calibration`, `diagnosed` to the `Report` of what its model leaves out, `certified` a calibration
and recordings that it was not made from to a `Certificate`, `commanded` a calibration and wanted poses to the commands that give them, all that is
known undone. `load` and `save` are of calibration.json.
"""

from typing import TYPE_CHECKING

from rig.lazily import handed_on

if TYPE_CHECKING:
    from calib.certify.calibration import Calibration as Calibration
    from calib.commands import Commanded as Commanded
    from calib.commands import commanded as commanded
    from calib.diagnose.report.report import Report as Report
    from calib.from_recordings import calibrated as calibrated
    from calib.from_recordings import certified as certified
    from calib.from_recordings import diagnosed as diagnosed
    from calib.statement.certificate import Certificate as Certificate
    from calib.store import load as load
    from calib.store import save as save

__all__ = ["calibrated", "diagnosed", "certified", "commanded", "load", "save", "Calibration", "Commanded", "Report", "Certificate"]
__getattr__ = handed_on(__name__, {
    **dict.fromkeys(("calibrated", "diagnosed", "certified"), "calib.from_recordings"),
    **dict.fromkeys(("commanded", "Commanded"), "calib.commands"), **dict.fromkeys(("load", "save"), "calib.store"),
    "Calibration": "calib.certify.calibration", "Report": "calib.diagnose.report.report", "Certificate": "calib.statement.certificate"})
