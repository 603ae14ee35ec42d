"""Diagnoses for tests: of a recording, with its report and its page."""

from calib.diagnosis.recording_diagnosis import DiagnosisOptions, diagnose
from calib.diagnosis.report.diagnosis_page import figures_of_arm_or_platform, write_diagnosis_page
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report


def diagnosis_of(recording, only=None, without=(), **options):
    """Diagnosis of a Recording. options : of DiagnosisOptions"""
    return diagnose(
        recording, DiagnosisOptions(only=None if only is None else tuple(only), without=tuple(without), **options)
    )


def page_text(path, recording, diagnosis, report=None):
    """The page's text of a Diagnosis, written to a path."""
    report = diagnosis_report(diagnosis) if report is None else report
    write_diagnosis_page(path, report, figures_of_arm_or_platform(diagnosis, recording, report))
    return path.read_text(encoding="utf-8")
