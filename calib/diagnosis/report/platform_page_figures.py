"""Figures of a platform's diagnosis page: its outline, each finding's residuals, what is unexplained."""

from dataclasses import dataclass

import numpy as np

from calib.diagnosis.problems.platform.linearised_residuals import LinearisedModel
from calib.diagnosis.problems.platform.simultaneous_refinement import Refinement
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.diagnosis.report.diagnosis_json import FindingEntry
from calib.diagnosis.report.machine_outline import rig_outline_figure
from calib.diagnosis.report.residual_figures import held_out_gain_table, repeatability_rows, residuals_in_time_figure
from calib.diagnosis.report.residual_plots import (
    effect_residual_figures,
    image_residual_figures,
    model_residuals,
    residuals_without_effects,
)
from calib.report.pose_figures_and_effect_displacements import effect_displacements, rig_scene
from rig.array_types import Floats
from rig.effects.framework.effect_data_types import Place
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import heading_html
from rig.report.pages.image_plane_and_3d_views import DrawnEffect as Shown
from rig.report.pages.image_plane_and_3d_views import view_3d_html
from rig.report.pages.plots import bar_chart_svg, panel_row_html

FAR = 10.0  # standard deviations; a corner farther off counts for no more in the page's bars
PICTURED = 3  # of what is unknown
PLAYED = 4  # findings that are shown in three dimensions


@dataclass(frozen=True, slots=True, eq=False)
class PlatformView:
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
                effect_displacements(k.design, k.commands, k.t, k.effects, which, k.sensors)
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
            parts += [
                heading_html("What each finding brings on frames held out", 3),
                held_out_gain_table(self.diagnosis),
            ]
        for f in unknown[:PICTURED]:
            place = Place.parse(f.place)
            if place.kind == "strut":
                parts.append(residuals_in_time_figure(f.place, k.t, struts[:, place.number - 1] * 1e6, "strut, µm"))
            elif place.kind == "camera":
                own = np.flatnonzero(
                    k.observed.observations.camera == [c.name for c in k.design.cameras].index(place.name)
                )
                parts.append(image_residual_figures(k, own, (corners,), ("what is left",)))
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
        bare, _ = model_residuals(before.model)
        rows.append(
            ([str(Place.axis("strut", i)) for i in range(k.axes)], _rms(bare) * 1e6, _rms(struts) * 1e6, noise, "µm")
        )
    if k.seen is not None:
        rows.append(_camera_levels(refined.model, before.model))
    return panel_row_html(
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
