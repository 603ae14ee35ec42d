"""Poses to a better rig: parameters, corrections, what is promised of them, and what physics was left out.

`calibrated` takes a recording (rig.load_recording) to its `Calibration`, `diagnosed` to the `Report` of what its model
leaves out, `certified` a calibration and recordings that it was not made from to a `Certificate`, `commanded` a
calibration and wanted poses to the commands that give them, all that is known undone. `load` and `save` are of
calibration.json.
"""

from typing import TYPE_CHECKING

from rig.compute.lazy_package_exports import lazy_getattr

if TYPE_CHECKING:
    from calib.certificate.certificate import Certificate as Certificate
    from calib.certify.calibration import Calibration as Calibration
    from calib.diagnose.report.diagnosis_report import Report as Report
    from calib.files.calibration_file import load as load
    from calib.files.calibration_file import save as save
    from calib.models.wanted_pose_commands import Commanded as Commanded
    from calib.models.wanted_pose_commands import commanded as commanded
    from calib.recording_calibration import calibrated as calibrated
    from calib.recording_calibration import certified as certified
    from calib.recording_calibration import diagnosed as diagnosed

__all__ = [
    "calibrated",
    "diagnosed",
    "certified",
    "commanded",
    "load",
    "save",
    "Calibration",
    "Commanded",
    "Report",
    "Certificate",
]
__getattr__ = lazy_getattr(
    __name__,
    {
        **dict.fromkeys(("calibrated", "diagnosed", "certified"), "calib.recording_calibration"),
        **dict.fromkeys(("commanded", "Commanded"), "calib.models.wanted_pose_commands"),
        **dict.fromkeys(("load", "save"), "calib.files.calibration_file"),
        "Calibration": "calib.certify.calibration",
        "Report": "calib.diagnose.report.diagnosis_report",
        "Certificate": "calib.certificate.certificate",
    },
)
