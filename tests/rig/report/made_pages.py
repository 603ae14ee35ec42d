"""Pages whose commands take minutes, as their writers make them: measuring limbs, a campaign, an investigation."""

from pathlib import Path

import numpy as np

from calib.certification.measuring_limb_calibration_slips_and_vision_agreement import Agreement
from calib.experiment.investigation_folder_and_report import Hypothesis, InvestigationRound, write_investigation_page
from calib.report.online_learning_and_limb_vision_agreement_pages import write_measuring_limbs_page
from synthetic.blind_campaign_page import write_campaign_page
from synthetic.blind_diagnosis_score import Case, Found, Hidden


def write_made_pages(at: Path) -> dict[str, Path]:
    """Write them into a folder. Returns {kind: path}"""
    size = np.array([4e-6, 3e-6, 9e-6, 2e-5, 3e-5, 5e-5])
    limits = np.stack([-2 * size, 2 * size])
    found = Agreement(60, size / 9, size, limits, 3 * size, size, np.full(6, 0.1), np.repeat([2e-5, 2e-4], 3))
    write_measuring_limbs_page(at / "insitu.html", "rec", found, "images", None)
    hidden = [Hidden("backlash", "strut 3", {}, 30.0), Hidden("hysteresis", "strut 1", {}, 4.0)]
    named = [Found("backlash", "strut 3", {}, []), Found("creep", "rig", {}, [])]
    cases = [Case(0, "two", None, hidden, named, False, 1.02, 40.0), Case(1, "nothing", None, [], [], False, 1.0, 31.0)]
    write_campaign_page(at / "blind.html", {"season": 2}, cases)
    alike = (Hypothesis("backlash at strut 3", 0.7), Hypothesis("creep at rig", 0.3))
    looks = [
        InvestigationRound(1, "rec1", 12.0, ("backlash at strut 3",), (), (), (alike,), (), ()),
        InvestigationRound(2, "rec2", 9.0, ("backlash at strut 3",), ("backlash at strut 3",), (), (), (), ()),
    ]
    write_investigation_page(at / "investigate.html", "rig.toml", looks, 60.0, "told apart", ())
    return {kind: at / f"{kind}.html" for kind in ("insitu", "blind", "investigate")}
