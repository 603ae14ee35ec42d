"""The page of a chain's calibration: what it is worth, before and after, stage by stage, and what cannot be told apart."""

import html
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calib.certify.calibration import Calibration
from calib.certify.held_out import errors_of
from calib.chains import model
from calib.chains.certify import Certified
from calib.html_page import coverage, page, table
from calib.report import before_after, origin, worth
from calib.samples import Samples
from rig.pose import vector
from rig.recording import Recording


def calibration_page(path: Path | str, recording: Recording, calibration: Calibration, samples: Samples, done: Certified) -> None:
    """Write the page. recording : Recording; calibration : Calibration; samples : Samples; done : Certified."""
    told = "".join(f"<p>{html.escape(line)}</p>" for line in done.found.report())
    parts: list[str | Figure]
    parts = [*worth(calibration.claim), "<h2>Before and after, pose by pose</h2><p class=note>All poses; the fit has seen these.</p>",
             before_after(*errors_of(calibration.correction, samples), samples.frame), "<h2>Stage by stage</h2>", told, _parameters(done),
             "<h2>Where the last platform went</h2>", coverage(vector(samples.T_base_platform)), "<h2>Where this came from</h2>", origin(calibration)]
    page(path, f"Calibration from {recording.name}", parts)


def _parameters(done: Certified) -> str:
    found, nominal = done.found, done.correction.nominal
    sigma = np.sqrt(np.diag(found.covariance))
    rows = [(name, f"{1e3 * step:+.4f}", f"{2e3 * s:.4f}", "mm" if unit == "m" else "mrad")
            for name, unit, step, s in zip(model.names(nominal), model.units(nominal), found.step, sigma) if s > 0]
    return ("<details><summary>Every parameter</summary>" + table(("change from nominal", "", "± (k = 2)", ""), rows) + "</details>")
