"""Calibration of a rig from poses: parameters, corrections, their certified accuracy, and unmodelled effects.

A verb a step, each with options and a result that shows itself: `plan` chooses configurations to visit, `check` looks
for mistakes in a recording (rig.load), `calibrate` takes one to its calibration, `diagnose` to what its model leaves
out, `correct` a calibration and wanted poses to the commands that give them, `verify` holds a calibration against
another recording, `certify` states what is promised by recordings that it was not made from, `watch` holds small visits
against it day by day, `investigate` goes all of that by itself, `why` takes data of any form and a model to five lines.
`learn` takes poses one at a time, `accept_limbs` compares measuring limbs with vision, `close_loops` more lengths than
six with each other, `analyse_workspace` says what a calibration does to the workspace, `export` writes for other
programs, `plan_run` begins a run of the machine. `load` and `save` are of calibration.json.
"""

from typing import TYPE_CHECKING

from rig.compute.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from calib.api.calibrate import CalibrateOptions as CalibrateOptions
    from calib.api.calibrate import calibrate as calibrate
    from calib.api.certify import certify as certify
    from calib.api.correct import CorrectOptions as CorrectOptions
    from calib.api.correct import correct as correct
    from calib.api.diagnose import DiagnoseOptions as DiagnoseOptions
    from calib.api.diagnose import diagnose as diagnose
    from calib.api.execute_plan_at_machine import RunOptions as RunOptions
    from calib.api.execute_plan_at_machine import plan_run as plan_run
    from calib.api.export_calibration_or_recording import ExportOptions as ExportOptions
    from calib.api.export_calibration_or_recording import export as export
    from calib.api.investigate import investigate as investigate
    from calib.api.loop_closure_check_of_redundant_legs import LoopClosureOptions as LoopClosureOptions
    from calib.api.loop_closure_check_of_redundant_legs import close_loops as close_loops
    from calib.api.measuring_limb_acceptance_and_poses_from_readings import AcceptLimbsOptions as AcceptLimbsOptions
    from calib.api.measuring_limb_acceptance_and_poses_from_readings import accept_limbs as accept_limbs
    from calib.api.options_and_imported_data_of_why import WhyOptions as WhyOptions
    from calib.api.parameter_learning_pose_by_pose_from_recording import LearnOptions as LearnOptions
    from calib.api.parameter_learning_pose_by_pose_from_recording import learn as learn
    from calib.api.plan import plan as plan
    from calib.api.plan_options_and_result import PlanOptions as PlanOptions
    from calib.api.recording_check_combination_and_view import check as check
    from calib.api.verify_and_watch import verify as verify
    from calib.api.verify_and_watch import watch as watch
    from calib.api.why import why as why
    from calib.api.workspace_change_by_calibration import analyse_workspace as analyse_workspace
    from calib.certificate.certificate_content_dataclasses import CertifyOptions as CertifyOptions
    from calib.experiment.investigation_plan_execution import InvestigateOptions as InvestigateOptions
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
    "why",
    "learn",
    "accept_limbs",
    "close_loops",
    "analyse_workspace",
    "export",
    "plan_run",
    "load",
    "save",
    "PlanOptions",
    "CalibrateOptions",
    "DiagnoseOptions",
    "CorrectOptions",
    "CertifyOptions",
    "InvestigateOptions",
    "WhyOptions",
    "LearnOptions",
    "AcceptLimbsOptions",
    "LoopClosureOptions",
    "ExportOptions",
    "RunOptions",
]
__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "plan": "calib.api.plan",
        "PlanOptions": "calib.api.plan_options_and_result",
        "check": "calib.api.recording_check_combination_and_view",
        "calibrate": "calib.api.calibrate",
        "CalibrateOptions": "calib.api.calibrate",
        **dict.fromkeys(("diagnose", "DiagnoseOptions"), "calib.api.diagnose"),
        **dict.fromkeys(("correct", "CorrectOptions"), "calib.api.correct"),
        "verify": "calib.api.verify_and_watch",
        "watch": "calib.api.verify_and_watch",
        "certify": "calib.api.certify",
        **dict.fromkeys(("learn", "LearnOptions"), "calib.api.parameter_learning_pose_by_pose_from_recording"),
        **dict.fromkeys(
            ("accept_limbs", "AcceptLimbsOptions"), "calib.api.measuring_limb_acceptance_and_poses_from_readings"
        ),
        **dict.fromkeys(("close_loops", "LoopClosureOptions"), "calib.api.loop_closure_check_of_redundant_legs"),
        **dict.fromkeys(("export", "ExportOptions"), "calib.api.export_calibration_or_recording"),
        **dict.fromkeys(("plan_run", "RunOptions"), "calib.api.execute_plan_at_machine"),
        "analyse_workspace": "calib.api.workspace_change_by_calibration",
        "investigate": "calib.api.investigate",
        "InvestigateOptions": "calib.experiment.investigation_plan_execution",
        "why": "calib.api.why",
        "WhyOptions": "calib.api.options_and_imported_data_of_why",
        **dict.fromkeys(("load", "save"), "calib.files.calibration_file"),
        "CertifyOptions": "calib.certificate.certificate_content_dataclasses",
    },
)
