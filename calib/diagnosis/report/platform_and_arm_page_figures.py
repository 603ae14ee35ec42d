"""Figures of a diagnosis page, of a platform and of an arm."""

from dataclasses import dataclass

import numpy as np

from calib.diagnosis.problems.arm.arm_recording_evidence import ArmEvidence
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import Refinement
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.diagnosis.report import residual_figures_and_finding_contributions
from calib.diagnosis.report.diagnosis_json_entries import FindingEntry
from calib.diagnosis.report.residual_figures_and_finding_contributions import (
    SAME_ANGLE,
    closure_and_corner_residuals,
    effect_residual_figures,
    mean_residual_figures_over_camera_image,
    position_error_statistics_and_mean_rotation_error,
    residual_scatter_figure,
    residuals_in_time_figure,
    residuals_without_effects,
)
from calib.diagnosis.report.rig_and_arm_outline_figures import arm_outline_figures, rig_outline_figure
from calib.report.pose_and_effect_figures import (
    FACTORS,
    mechanism_scene,
    pose_displacements_by_effect_at_several_sizes,
    rig_scene,
)
from rig.array_and_json_types import Floats
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import (
    figures_with_caption_html,
    heading_html,
    note_html,
    paragraph_html,
    table_html,
)
from rig.report.pages.image_plane_and_3d_views import DrawnEffect, view_3d_html
from rig.report.pages.image_plane_and_3d_views import DrawnEffect as Shown
from rig.report.pages.svg_plots import Series, bar_chart_svg, figures_side_by_side_html, plot_panel_svg

ARM_PLAYED = 4  # findings that are shown in three dimensions
ROWS = (
    "geometry alone",
    "with effects",
    "of these, every joint near fitted angles",
    "of these, a joint at angles not fitted",
)


@dataclass(frozen=True, slots=True, eq=False)
class ArmFigures:
    """diagnosis : Diagnosis of ArmEvidence; entries : its findings as reported, in the diagnosis' order"""

    diagnosis: Diagnosis
    entries: tuple[FindingEntry, ...]

    @property
    def fit(self) -> Fit:
        """The Fit with all findings."""
        fit: Fit = self.diagnosis.selection.fit
        return fit

    @property
    def evidence(self) -> ArmEvidence:
        """What was measured."""
        assert isinstance(self.diagnosis.evidence, ArmEvidence)
        return self.diagnosis.evidence

    @property
    def mechanism(self) -> Arm | Chain:
        """The Arm or Chain as fitted."""
        design = self.diagnosis.design
        assert design is not None and isinstance(design.mechanism, (Arm, Chain))
        return design.mechanism

    def where(self, places: list[str]) -> str:
        """The arm in outline, joints marked."""
        fit = self.fit
        moved: dict[int, dict[str, float]] = {}
        for number, term in enumerate(fit.terms):
            if term.candidate.joint is not None:
                here = moved.setdefault(term.candidate.joint, {})
                here[term.candidate.name] = float(np.hypot(here.get(term.candidate.name, 0.0), fit.part(number).std()))
        return arm_outline_figures(self.mechanism, fit.arms.q, moved)

    def plot(self, finding: FindingEntry) -> str | None:
        """Residuals of all poses turned back into the joint against what gives the finding away; None where it acts on
        the whole arm, or was found before all else.
        """
        number = next((f.number for f, e in zip(self.diagnosis.findings, self.entries) if e is finding), None)
        if number is None:
            return None
        fit = self.fit
        term = fit.terms[number]
        joint = term.candidate.joint
        if joint is None:
            return None
        a = (fit.W @ fit.arms.directions(joint))[..., 0]
        rest = (a * fit.y).sum(axis=1) / np.maximum((a * a).sum(axis=1), 1e-300)
        moved = fit.part(number) - fit.part(number)[fit.used].mean()
        covariate = term.candidate.effect(term.node, fit.theta[fit.slices[number]]).covariate(fit.arms.context.moved())
        x = covariate.values if covariate.values.ndim == 1 else covariate.values[:, joint]
        both = [v[fit.used] * 1e6 for v in (rest + moved, rest)]
        return residual_scatter_figure(
            x[fit.used],
            covariate.label,
            both,
            f"{term.candidate.place}, µ{mechanisms.axis_units(self.mechanism)[joint]}",
        )

    def in_space(self) -> list[str]:
        """The arm's poses, with what each finding at a joint does, linear in its size."""
        d, fit, effects = self.diagnosis, self.fit, list[DrawnEffect]()
        J = np.zeros((len(fit.arms), 6, fit.arms.q.shape[1]))
        known = slice(3, 5) if fit.arms.unit == "rad" else slice(fit.arms.joints.shape[1])
        J[:, known] = fit.arms.joints  # of positions alone, no rotation is known
        for finding in d.findings[:ARM_PLAYED]:
            candidate = self.fit.terms[finding.number].candidate
            if candidate.joint is not None:
                once = J[:, :, candidate.joint] * fit.part(finding.number)[:, None]
                sizes = tuple(f"{factor:g} times as found" for factor in FACTORS)
                effects.append(
                    DrawnEffect(
                        f"{candidate.name.replace('_', ' ')} at {candidate.place}",
                        sizes,
                        np.multiply.outer(FACTORS, once),
                    )
                )
        return view_3d_html(mechanism_scene(self.mechanism, fit.arms.frame, fit.arms.q, tuple(effects)))

    def remaining(self, unknown: list[FindingEntry]) -> list[str]:
        """Held-out errors, before and after, pose by pose and in a table."""
        d, rows, unit = self.diagnosis, [], self.fit.arms.unit
        for h in d.held:
            near = h.far <= SAME_ANGLE
            for label, left in zip(ROWS, (h.before, h.after, h.after[near], h.after[~near])):
                if len(left):
                    f = position_error_statistics_and_mean_rotation_error(left)
                    rows.append(
                        [
                            f"{label}, {h.stretches} stretches",
                            *(f"{f[f'{key}_{unit}'] * 1e6:.1f}" for key in ("mean", "rms", "p95", "max")),
                            f"{f['mean_rad'] * 1e6:.1f}" if "mean_rad" in f else "",
                            f["n"],
                        ]
                    )
        parts: list[str] = [
            self._errors(),
            table_html(("held-out error", f"mean, µ{unit}", "RMS", "95 %", "max", "mean, µrad", "N"), rows),
        ]
        if d.findings:
            parts += [
                heading_html("Gain of each finding on held-out poses", 3),
                held_out_gain_table(d),
                heading_html("Findings that affect individual poses", 3),
                paragraph_html(
                    "The poses most displaced by all findings, a bar for each finding, the largest first. "
                    "contributions.csv has them for every pose."
                ),
                figures_with_caption_html(
                    residual_figures_and_finding_contributions.worst_pose_contribution_figure(
                        self.evidence, d.selection
                    ),
                    "Contribution of each finding to a pose (µm), side by side; grey: the rest. Good: short grey. Bad: "
                    "grey as long as the findings.",
                ),
            ]
        aside = self.evidence.frames_set_aside(d.selection)
        if len(aside):
            parts.append(
                paragraph_html(
                    f"{len(aside)} poses agree with no model and have negligible weight: frames "
                    f"{', '.join(map(str, aside))}."
                )
            )
        if d.repeats is not None and any(u.depends_on == ("configuration",) for u in d.left):
            parts.append(
                paragraph_html(
                    f"The same command brings {d.repeats.recurring_share:.0%} of the residual again: it is "
                    "not noise, and has none of the forms tried."
                )
            )
        return parts

    def measurement(self) -> list[tuple[str, object]]:
        """Where poses came from, and how well they repeat."""
        d = self.diagnosis
        rows = repeatability_rows(d)
        if self.fit.scatter[0] > 0:
            beyond, _ = self.evidence.scatter_beyond_stated(d.selection)
            rows.append(
                ("beyond what the instrument states, poses scatter by", f"{beyond * 1e6:.1f} µ{self.fit.arms.unit}")
            )
        arms = self.fit.arms
        return [
            ("poses from", self.evidence.source),
            ("poses", len(arms)),
            ("time", f"{np.ptp(arms.t) / 60:.1f} min"),
            ("sensors", ", ".join(arms.channels) or "none"),
            *rows,
        ]

    def _errors(self) -> str:
        d = self.diagnosis
        series = [
            Series(np.arange(len(left)), np.linalg.norm(left[:, :3], axis=1) * 1e6, label, colour=colour)
            for left, label, colour in ((d.held[0].before, "geometry alone", 1), (d.held[0].after, "with effects", 0))
        ]
        if d.repeats is not None:
            ends = np.array([0.0, len(d.held[0].after) - 1.0])
            series.append(Series(ends, np.full(2, d.repeats.mean * 1e6), "the same command repeated", "line", -1))
        return figures_with_caption_html(
            plot_panel_svg("held-out errors", ("pose", f"error, µ{self.fit.arms.unit}"), series, log=True),
            f"Error of each held-out pose (µ{self.fit.arms.unit}), by the geometry alone and with the effects. Good: "
            "with effects it is lower, near the line of repeated commands. Bad: both series overlap.",
        )


FAR = 10.0  # standard deviations; a corner farther off counts for no more in the page's bars
PICTURED = 3  # of what is unknown
PLAYED = 4  # findings that are shown in three dimensions


@dataclass(frozen=True, slots=True, eq=False)
class PlatformFigures:
    """diagnosis : Diagnosis of PlatformEvidence; entries : its findings as reported, in the diagnosis' order;
    recording : Recording
    """

    diagnosis: Diagnosis
    entries: tuple[FindingEntry, ...]
    recording: Recording

    @property
    def refined(self) -> Refinement:
        """All that is free, refined with all findings."""
        refined: Refinement = self.diagnosis.selection.fit.refined
        return refined

    def where(self, places: list[str]) -> str:
        """The rig in outline, places marked."""
        return rig_outline_figure(self.refined.point, places)

    def plot(self, finding: FindingEntry) -> str | None:
        """Of an admitted effect; None for what was found before all else: faces exchanged or moved."""
        number = next((f.number for f, e in zip(self.diagnosis.findings, self.entries) if e is finding), None)
        return None if number is None else effect_residual_figures(self.refined, number)

    def in_space(self) -> list[str]:
        """The rig's poses, with what each finding that moves the platform does at sizes of it."""
        k = self.refined.point
        effects, values = tuple[Shown, ...](), None
        if k.commands is not None and k.design.mechanism.axes:
            tried = [
                pose_displacements_by_effect_at_several_sizes(k.design, k.commands, k.t, k.effects, which, k.sensors)
                for which in range(min(len(k.effects), PLAYED))
            ]
            effects, values = tuple(one for one in tried if one is not None), k.motion(()).lengths
        return view_3d_html(rig_scene(k.design, k.frames, k.T, values, effects=effects))

    def remaining(self, unknown: list[FindingEntry]) -> list[str]:
        """Figure of the levels, then of what is unknown."""
        refined = self.refined
        k = refined.point
        struts, corners = residuals_without_effects(refined)
        parts: list[str] = [_levels(self.diagnosis, struts)]
        if self.diagnosis.findings and self.diagnosis.regions:
            parts += [heading_html("Gain of each finding on held-out frames", 3), held_out_gain_table(self.diagnosis)]
        for f in unknown[:PICTURED]:
            place = Place.parse(f.place)
            if place.kind == "strut":
                parts.append(residuals_in_time_figure(f.place, k.t, struts[:, place.number - 1] * 1e6, "strut, µm"))
            elif place.kind == "camera":
                own = np.flatnonzero(
                    k.observed.observations.camera == [c.name for c in k.design.cameras].index(place.name)
                )
                parts.append(mean_residual_figures_over_camera_image(k, own, (corners,), ("what is left",)))
        return parts

    def measurement(self) -> list[tuple[str, object]]:
        """Where poses came from, and how much there is."""
        k, rec = self.refined.point, self.recording
        return [
            ("poses from", self.diagnosis.evidence.source),
            ("frames", f"{len(k.t)} of {len(rec.exposures.times()[0])}"),
            ("time", f"{np.ptp(k.t) / 60:.1f} min"),
            ("corners", len(k.observed.observations) if k.seen is not None else "none"),
            ("sensors", ", ".join(rec.sensors.channels) if rec.sensors is not None else "none"),
            *repeatability_rows(self.diagnosis),
        ]


def _levels(d: Diagnosis, struts: Floats) -> str:
    """Figures of what is left of each strut and camera, with nothing admitted, with all, and the noise."""
    refined, before = d.selection.fit.refined, d.selection.before.refined
    k, rows = refined.point, []
    if k.axes:
        noise = np.sqrt(refined.model.strut_noise().mean(axis=0)) * 1e6
        bare, _ = closure_and_corner_residuals(before.model)
        rows.append(
            ([str(place) for place in k.places], _rms(bare) * 1e6, _rms(struts) * 1e6, noise, f"µ{k.axis_unit}")
        )
    if k.seen is not None:
        rows.append(_camera_levels(refined.model, before.model))
    return figures_with_caption_html(
        figures_side_by_side_html(
            *(
                bar_chart_svg(
                    "what is left, RMS",
                    labels,
                    [
                        ("nothing admitted", first.tolist(), 3),
                        ("as diagnosed", last.tolist(), 0),
                        ("noise", noise.tolist(), -1),
                    ],
                    unit,
                )
                for labels, first, last, noise, unit in rows
            )
        ),
        "RMS of what is left (µm or µrad of an axis, px of a camera), with nothing admitted, as diagnosed, and the "
        "noise. Good: as diagnosed equals the noise. Bad: it stays clearly longer; something is unexplained.",
    )


def _camera_levels(model: LinearisedModel, before: LinearisedModel) -> tuple[list[str], Floats, Floats, Floats, str]:
    k = model.point
    o, sigma = k.observed.observations, model.corner_noise()
    present = np.unique(o.camera)
    off = [np.clip(o.uv - at.pixels(), -FAR * sigma, FAR * sigma) for at in (before.point, k)]
    first, last = (np.array([np.sqrt(np.mean(v[o.camera == i] ** 2)) for i in present]) for v in off)
    return [k.design.cameras[i].name for i in present], first, last, np.full(len(present), sigma), "px"


def _rms(values: Floats) -> Floats:
    return np.sqrt((values**2).mean(axis=0))


SCALES, UNITS = {"m": 1e6, "rad": 1e6}, {"m": "µm", "rad": "µrad"}  # in which misfits are shown


def repeatability_rows(diagnosis: Diagnosis) -> list[tuple[str, object]]:
    """Table rows [(what, value)] on how well poses repeat.

    None where too few commands were repeated.
    """
    repeats = diagnosis.repeats
    if repeats is None:
        return []
    text = f"{repeats.mean * 1e6:.1f} {UNITS[repeats.unit]} ({repeats.pairs} pairs)"
    return [("repeatability of the same command", text)]


def held_out_gain_table(diagnosis: Diagnosis) -> str:
    """Table of the gain in held-out misfit by each finding.

    With stretches of time and regions of each axis' travel held out.
    """
    rows, terms = [], diagnosis.selection.problem.terms(diagnosis.selection.fit)
    for i, finding in enumerate(diagnosis.findings):
        candidate = terms[finding.number]
        found = [diagnosis.cross_validations[i], *(row[i] for row in diagnosis.regions)]
        scale = SCALES.get(found[0].unit, 1.0)
        rows.append(
            [
                f"{candidate.name.replace('_', ' ')} at {candidate.place}",
                *(f"{(v.before - v.after) * scale:+.{1 if scale > 1 else 4}f}" for v in found),
            ]
        )
    places = [] if diagnosis.design is None else mechanisms.axis_place_texts(diagnosis.design.mechanism)
    units = " or ".join(dict.fromkeys(UNITS.get(v.unit, v.unit) for v in diagnosis.cross_validations))
    note = note_html(
        f"{units}, RMS along one axis, by which held-out data are predicted better with it than without. A curve of "
        "an axis' own position is undetermined where that axis was never recorded: there, its gain by that axis' own "
        "regions may be negative."
    )
    return table_html(("finding", "held out: time", *places[: len(diagnosis.regions)]), rows) + note
