"""Poses to a better rig: parameters, corrections, what is promised of them, and what physics was left out.

A verb a step, each with options and a result that shows itself: `plan` chooses configurations to visit, `check` looks
for mistakes in a recording (rig.load), `calibrate` takes one to its calibration, `diagnose` to what its model leaves
out, `correct` a calibration and wanted poses to the commands that give them, `verify` holds a calibration against
another recording, `certify` states what is promised by recordings that it was not made from, `watch` holds small visits
against it day by day, `investigate` goes all of that by itself. `load` and `save` are of calibration.json.
"""

from typing import TYPE_CHECKING

from rig.compute.lazy_package_exports import lazy_getattr

if TYPE_CHECKING:
    from calib.api.calibrate import calibrate as calibrate
    from calib.api.calibrate_options import CalibrateOptions as CalibrateOptions
    from calib.api.certify import certify as certify
    from calib.api.check import check as check
    from calib.api.correct import CorrectOptions as CorrectOptions
    from calib.api.correct import correct as correct
    from calib.api.diagnose import DiagnoseOptions as DiagnoseOptions
    from calib.api.diagnose import diagnose as diagnose
    from calib.api.investigate import investigate as investigate
    from calib.api.plan import plan as plan
    from calib.api.plan_result import PlanOptions as PlanOptions
    from calib.api.verify import verify as verify
    from calib.api.watch import watch as watch
    from calib.certificate.certificate_contents import CertifyOptions as CertifyOptions
    from calib.experiment.investigation_machine import InvestigateOptions as InvestigateOptions
    from calib.files.calibration_file import load as load
    from calib.files.calibration_file import save as save

__all__ = [
    "plan",
    "check",
    "calibrate",
    "diagnose",
    "correct",
    "verify",
    "certify",
    "watch",
    "investigate",
    "load",
    "save",
    "PlanOptions",
    "CalibrateOptions",
    "DiagnoseOptions",
    "CorrectOptions",
    "CertifyOptions",
    "InvestigateOptions",
]
__getattr__ = lazy_getattr(
    __name__,
    {
        "plan": "calib.api.plan",
        "PlanOptions": "calib.api.plan_result",
        "check": "calib.api.check",
        "calibrate": "calib.api.calibrate",
        "CalibrateOptions": "calib.api.calibrate_options",
        **dict.fromkeys(("diagnose", "DiagnoseOptions"), "calib.api.diagnose"),
        **dict.fromkeys(("correct", "CorrectOptions"), "calib.api.correct"),
        "verify": "calib.api.verify",
        "watch": "calib.api.watch",
        "certify": "calib.api.certify",
        "investigate": "calib.api.investigate",
        "InvestigateOptions": "calib.experiment.investigation_machine",
        **dict.fromkeys(("load", "save"), "calib.files.calibration_file"),
        "CertifyOptions": "calib.certificate.certificate_contents",
    },
)
