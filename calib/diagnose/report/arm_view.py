"""What an arm's page draws: the arm, each finding turned back into its joint, held-out errors pose by pose."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.diagnose.problems.arm.diagnose import ArmDiagnosis
from calib.diagnose.report import arm_contributions
from calib.diagnose.report.arm import SAME_ANGLE, figures
from calib.diagnose.report.arm_picture import picture
from calib.diagnose.report.drawing import scatter
from calib.diagnose.report.page import Part
from calib.diagnose.report.schema import FindingEntry
from calib.html_page import table
from rig import mechanisms

ROWS = ("geometry alone", "with effects", "of these, every joint near angles it was fitted at", "of these, a joint at angles never fitted")


@dataclass(frozen=True, slots=True, eq=False)
class ArmView:
    """diagnosis : ArmDiagnosis; entries : its findings as reported, in the diagnosis' order"""

    diagnosis: ArmDiagnosis
    entries: list[FindingEntry]

    @property
    def asked(self) -> int:
        """How many hypotheses were held against the recording."""
        return self.diagnosis.asked

    def where(self, places: list[str]) -> Figure:
        """The arm in outline, joints marked."""
        d = self.diagnosis
        moved: dict[int, dict[str, float]] = {}
        for number, term in enumerate(d.fit.terms):
            if term.candidate.joint is not None:
                here = moved.setdefault(term.candidate.joint, {})
                here[term.candidate.name] = float(np.hypot(here.get(term.candidate.name, 0.0), d.fit.part(number).std()))
        return picture(d.arm, d.arms.q, moved)

    def plot(self, finding: FindingEntry) -> Figure | None:
        """Residuals of all poses turned back into the joint against what gives the finding away; None where it acts on the whole arm."""
        d = self.diagnosis
        number = d.findings[next(i for i, entry in enumerate(self.entries) if entry is finding)].number
        term, fit = d.fit.terms[number], d.fit
        joint = term.candidate.joint
        if joint is None:
            return None
        a = (fit.W @ d.arms.directions(joint))[..., 0]
        rest = (a * fit.y).sum(axis=1) / np.maximum((a * a).sum(axis=1), 1e-300)
        moved = fit.part(number) - fit.part(number)[fit.used].mean()
        covariate = term.candidate.effect(term.node, fit.theta[fit.slices[number]]).covariate(d.arms.context.moved())
        x = covariate.values if covariate.values.ndim == 1 else covariate.values[:, joint]
        both = [v[fit.used] * 1e6 for v in (rest + moved, rest)]
        return scatter(x[fit.used], covariate.label, both, f"{term.candidate.place}, µ{mechanisms.units(d.arm)[joint]}")

    def remaining(self, unknown: list[FindingEntry]) -> list[Part]:
        """Held-out errors, before and after, pose by pose and in a table."""
        d, rows = self.diagnosis, []
        for h in d.held:
            near = h.far <= SAME_ANGLE
            for label, left in zip(ROWS, (h.before, h.after, h.after[near], h.after[~near])):
                if len(left):
                    f = figures(left)
                    rows.append([f"{label}, {h.stretches} stretches", *(f"{f[key] * 1e6:.1f}" for key in ("mean_m", "rms_m", "p95_m", "max_m")),
                                 f"{f['mean_rad'] * 1e6:.1f}" if "mean_rad" in f else "", f["n"]])
        parts: list[Part] = [self._errors(), table(("held-out error", "mean, µm", "RMS", "95 %", "max", "mean, µrad", "N"), rows)]
        if d.findings:
            parts += ["<h3>What each finding brings on poses held out</h3>", self._proofs(),
                      "<h3>What single poses suffer from</h3><p>The poses that all findings together displace most, for each finding a bar, the "
                      "biggest first. contributions.csv has them for every pose.</p>", arm_contributions.picture(d)]
        aside = d.arms.frame[d.fit.aside]
        if len(aside):
            parts.append(f"<p>{len(aside)} poses agree with no model and count for next to nothing: frames {', '.join(map(str, aside))}.</p>")
        if d.repeats is not None and any(u.depends_on == ("configuration",) for u in d.left):
            parts.append(f"<p>The same command brings {d.repeats.again:.0%} of what remains again: that is no noise, and of no form that was "
                         "tried.</p>")
        return parts

    def measurement(self) -> list[tuple[str, Any]]:
        """Where poses came from, and how well they repeat."""
        d = self.diagnosis
        again: list[tuple[str, Any]] = [] if d.repeats is None else [("the same command given again comes back within",
                                               f"{d.repeats.mean * 1e6:.1f} µm ({d.repeats.pairs} pairs)")]
        if d.fit.scatter[0] > 0:
            again.append(("beyond what the instrument states, poses scatter by", f"{np.sqrt(3) * d.fit.scatter[0] * 1e6:.1f} µm"))
        return [("poses from", d.source), ("poses", len(d.arms)), ("time", f"{np.ptp(d.arms.t) / 60:.1f} min"),
                ("sensors", ", ".join(d.arms.channels) or "none"), *again]

    def _proofs(self) -> str:
        """Table of the fall of the held-out misfit by each finding, with stretches of time and regions of each joint's travel held out."""
        d, rows = self.diagnosis, []
        for i, finding in enumerate(d.findings):
            candidate = d.fit.terms[finding.number].candidate
            found = [d.cross_validations[i], *(row[i] for row in d.regions)]
            rows.append([f"{candidate.name.replace('_', ' ')} at {candidate.place}", *(f"{(v.before - v.after) * 1e6:+.1f}" for v in found)])
        joints = [f"joint {j + 1}" for j in range(len(d.regions))]
        note = ("<p class=note>µm, RMS of a position per axis, by which poses are predicted better with it than without. A curve of a joint's own "
                "angle is not told where that joint never stood: there, what it brings by that joint's own regions may be a loss.</p>")
        return table(("finding", "held out: time", *joints), rows) + note

    def _errors(self) -> Figure:
        d = self.diagnosis
        figure = Figure(figsize=(11, 3), layout="constrained")
        axes = figure.subplots()
        for left, label in ((d.held[0].before, "geometry alone"), (d.held[0].after, "with effects")):
            axes.semilogy(np.linalg.norm(left[:, :3], axis=1) * 1e6, ".", ms=2, label=label)
        if d.repeats is not None:
            axes.axhline(d.repeats.mean * 1e6, color="0.3", lw=0.8, label="the same command again")
        axes.set(xlabel="pose", ylabel="held-out position error, µm")
        axes.legend(fontsize=8)
        return figure
