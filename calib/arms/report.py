"""The page of an arm's calibration: before and after on held-out poses, joint profiles, coverage, parameters, rank."""

import html
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calib.arms import model
from calib.arms.certify import Certified
from calib.certify.calibration import Calibration
from calib.certify.held_out import Figures
from calib.certify.held_out import errors_of
from calib.html_page import coverage, page, table
from calib.report import before_after, origin, worth
from calib.samples import Samples
from calib.workspace.drawing import section
from rig import mechanisms
from rig.effects.covariate import DRAWN
from rig.recording import Recording


def calibration_page(path: Path | str, recording: Recording, calibration: Calibration, samples: Samples, done: Certified) -> None:
    """Write the page. recording : Recording; calibration : Calibration; samples : Samples; done : Certified."""
    parts: list[str | Figure]
    parts = [*worth(calibration.claim), *_held(done),
             "<h2>Before and after, pose by pose</h2><p class=note>All poses; the fit has seen these.</p>",
             before_after(*errors_of(calibration.correction, samples), samples.frame),
             "<h2>What each joint is corrected by</h2><p class=note>Beyond its offset, along the configurations visited.</p>",
             _profiles(calibration, samples), "<h2>Where the target went</h2>", coverage(np.concatenate(
                 [samples.T_base_platform.translation, samples.T_base_platform.rotation.as_rotvec()], axis=1)),
             *section(calibration.workspace, "rad"),
             "<h2>Parameters</h2>", "".join(f"<p>{html.escape(line)}.</p>" for line in done.found.rank.report()), _parameters(calibration),
             "<h2>Where this came from</h2>", origin(calibration)]
    page(path, f"Calibration from {recording.name}", parts)


def _held(done: Certified) -> list[str]:
    held = done.held_out
    if held is None or done.geometry is None or done.scattered is None:
        return []
    floor = " and ".join(f"{size * 1e3:.4f} {unit}" for size, unit in zip(held.floor, ("mm", "mrad")) if size < 1)
    floor += "".join(f"; {what} were not measured" for size, what in zip(held.floor, ("positions", "rotations")) if not size < 1)
    k, unit = (0, "mm") if held.floor[0] < 1 else (1, "mrad")
    rows = [(name, *_figures(f)) for name, f in (("owner's model", held.before), ("geometry alone", done.geometry.after), ("corrected", held.after),
                                                ("corrected, random rows", done.scattered.after))]
    return [f"<p>Held-out poses (whole stretches of configurations in turn, N = {held.after.n}, {held.configurations} distinct configurations): the "
            f"mean error falls from {held.before.mean[k] * 1e3:.3f} {unit} to {held.after.mean[k] * 1e3:.4f} {unit}. The measured poses themselves "
            f"are uncertain by {floor}. Rows drawn at random flatter: their neighbours in time were fitted.</p>",
            table(("held-out error", "mean, mm", "RMS", "95 %", "max", "mean, mrad", "RMS", "95 %", "max"), rows)]


def _figures(f: Figures) -> list[str]:
    return [f"{value * 1e3:.4f}" if value == value else "-" for value in (f.mean[0], *f.position, f.mean[1], *f.rotation)]


def _profiles(calibration: Calibration, samples: Samples) -> Figure:
    q = samples.commanded
    rho = calibration.correction.rho(q)
    count, nominal = q.shape[1], calibration.correction.nominal
    places, units = mechanisms.places(nominal), mechanisms.units(nominal)
    figure = Figure(figsize=(11, 2.4 * -(-count // 3)), layout="constrained")
    for i in range(count):
        axes = figure.add_subplot(-(-count // 3), 3, i + 1)
        scale, unit = DRAWN[units[i]]
        axes.plot(q[:, i] * scale, rho[:, i] * 1e3, ".", ms=2)
        axes.set(title=places[i], xlabel=f"commanded, {unit}", ylabel=f"correction, m{units[i]}")
    return figure


def _parameters(calibration: Calibration) -> str:
    fitted, nominal = calibration.correction.fitted, calibration.correction.nominal
    sigma = np.sqrt(np.diag(calibration.covariance))[6:-6].reshape(-1, 5)
    change = fitted.rows - nominal.rows
    rows = [(f"row {i + 1}", *(f"{c * 1e3:+.4f} ± {2 * s * 1e3:.4f}" if s else "held" for c, s in zip(change[i], sigma[i])))
            for i in range(len(change))]
    units = [f"{name}, {'mm' if unit == 'm' else 'mrad'}" for name, unit in zip(model.ROW, model.units(fitted)[6:11])]
    return table(("change from nominal (k = 2)", *units), rows)
