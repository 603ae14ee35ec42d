"""HTML page of a measurement.

Camera residuals, pictures of frames, platform poses and uncertainty.
"""

import base64
import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.report.pose_and_effect_figures import pose_coverage_figures
from rig.array_and_json_types import Floats
from rig.formats.numbers_and_units import count_text
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.pose import pose_to_vector
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import (
    collapsible_section_html,
    figures_with_caption_html,
    heading_html,
    list_html,
    note_html,
    paragraph_html,
    table_html,
)
from rig.report.pages.image_plane_and_3d_views import Arrows, Cells, image_patch_centres_and_means, image_plane_figure
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import Series, figures_side_by_side_html, plot_panel_svg
from vision import measured_frame_drawings_and_frame_jpegs
from vision.api import TWICE, MeasurementResult, measurement_verdict
from vision.bundle.adjustment_cross_validation_and_determined_unknowns import HeldOut, NotHeldOut
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import UnknownName
from vision.bundle.marker_and_target_displacements import Places
from vision.reading.marker_identity_mistakes_and_expected_marker_places import Suspect
from vision.recording_adjustment_with_hand_and_stages import Measurement

ENLARGED = 200.0


def _frame_pictures_html(recording: Recording, measurement: Measurement, frame: int) -> list[str]:
    """HTML of the images of a frame; nothing where the recording has corners alone."""
    images = measured_frame_drawings_and_frame_jpegs.frame_jpegs(recording, frame)
    if not images:
        return []
    figures = [
        _figure(measurement, i, frame, images[camera.name])
        for i, camera in enumerate(measurement.design.cameras)
        if camera.name in images
    ]
    return [
        figures_with_caption_html(
            figures_side_by_side_html(*figures),
            "Outlined in green: markers used; in red: at least one corner rejected. Yellow: residuals (px), "
            f"{ENLARGED:g} times as long as they are. Point at a marker to see its number. Good: few red outlines, "
            "yellow lines in all directions. Bad: yellow lines of one marker that all point the same way.",
        )
    ]


def _frame_of_median_residual(measurement: Measurement) -> int:
    """The solved frame whose residual is the middle one of all."""
    rms = _by_frame(measurement)
    return int(measurement.frames[np.argsort(rms)[len(rms) // 2]])


def _frame_of_greatest_residual(measurement: Measurement) -> int:
    """The solved frame with the greatest residual."""
    return int(measurement.frames[int(np.argmax(_by_frame(measurement)))])


def _by_frame(m: Measurement) -> Floats:
    """(f,) px RMS of the corners of each solved frame, those set aside as well."""
    o, square = m.observations, (m.residuals**2).sum(axis=1)
    out = np.zeros(len(m.frames))
    for k, frame in enumerate(m.frames):
        own = (o.frames[o.frame] == frame) & np.isfinite(square)
        out[k] = np.sqrt(square[own].mean()) if own.any() else 0.0
    return out


def _figure(m: Measurement, i: int, frame: int, image: bytes) -> str:
    camera, o, ids = m.design.cameras[i], m.observations, m.ids()
    rows = np.flatnonzero((o.camera == i) & (o.frames[o.frame] == frame))
    shapes = []
    for marker in np.unique(o.marker[rows]):
        own = rows[o.marker[rows] == marker]
        own = own[np.argsort(o.corner[own])]
        good = bool(m.inliers[own].all())
        points = " ".join(f"{u:.1f},{v:.1f}" for u, v in o.uv[own].tolist())
        label = f"marker {ids[marker]}" + ("" if good else ", rejected")
        shapes.append(
            f'<polygon class="quad{"" if good else " aside"}" points="{points}"><title>{label}</title></polygon>'
        )
    solved = rows[np.isfinite(m.residuals[rows, 0]) & m.inliers[rows]]
    d = "".join(
        f"M{u:.1f} {v:.1f}l{du:.1f} {dv:.1f}"
        for (u, v), (du, dv) in zip(o.uv[solved].tolist(), (ENLARGED * m.residuals[solved]).tolist())
    )
    rms = f", {np.sqrt((m.residuals[solved] ** 2).mean()):.3f} px RMS" if len(solved) else ""
    label = f"frame {frame}, {camera.name}: {count_text(len(np.unique(o.marker[rows])), 'marker')}{rms}"
    return (
        f'<figure class="picture"><div class="stack"><img alt="{html.escape(label)}" width="{camera.width}" '
        f'height="{camera.height}" '
        f'src="data:image/jpeg;base64,{base64.b64encode(image).decode()}">'
        f'<svg role="img" aria-label="its markers, outlined" viewBox="-0.5 -0.5 {camera.width} '
        f'{camera.height}">{"".join(shapes)}'
        f'<path class="residual" d="{d}"/></svg></div><figcaption>{html.escape(label)}</figcaption></figure>'
    )


CELLS = 16  # of a residual map, across the image


def write_measurement_page(path: Path | str, result: MeasurementResult, links: Sequence[Link] = ()) -> None:
    """Write the HTML page of a measurement.

    Residual maps, coverage, uncertainty, cameras, unsolved frames.
    """
    m, collected = result.measurement, result.collected
    rotation = np.sqrt(np.trace(m.covariance[:, 3:, 3:], axis1=1, axis2=2))
    position = np.sqrt(np.trace(m.covariance[:, :3, :3], axis1=1, axis2=2))
    parts = [
        *_suspects(result.suspects),
        *_pictures(result),
        heading_html("Residuals of the cameras"),
        figures_with_caption_html(
            _residual_maps(m),
            "Arrows: mean residual over patches of the image, enlarged; the longest is stated in px. Blue: RMS of the "
            "patch, px. Good: arrows in all directions, an even blue. Bad: arrows that turn or grow towards an edge; "
            "then the lens model omits something.",
        ),
        paragraph_html(
            f"{count_text(m.inliers.sum(), 'corner')} used, {(~m.inliers & np.isfinite(m.residuals[:, 0])).sum()} set "
            "aside as outliers. A corner "
            f"scatters by {m.noise:.4f} px per axis. {_held(result.held)}"
        ),
        heading_html("Positions of the platform"),
        pose_coverage_figures(pose_to_vector(m.T_base_platform)),
        heading_html("Uncertainty of each pose"),
        figures_with_caption_html(
            _uncertainty(m, position, rotation),
            "Standard uncertainty of each pose, position (µm) and rotation (µrad), including that of the cameras. "
            "Good: an even band. Bad: single high dots; those frames show few markers, or to one camera alone.",
        ),
        heading_html("Cameras"),
        _cameras(result.recording, m),
    ]
    if result.statement:
        parts += [heading_html("What this recording determines"), list_html(result.statement)]
    if result.places is not None:
        parts += [
            heading_html("Estimated positions of the markers"),
            note_html(
                "Relative to their stated positions, along their own x (right), y (up), z (out), with 95 % intervals. "
                "The stated positions, taken "
                "together, fix the frames."
            ),
            _moves(result.places),
            figures_with_caption_html(
                _residuals(result.places),
                "RMS residual of the platform's corners (px), frame by frame, with the markers as stated and as "
                "adjusted. Good: both series coincide. Bad: the stated places leave clearly more.",
            ),
        ]
    disagreeing = _worst_markers(m)
    if disagreeing:
        parts += [
            heading_html("Markers that disagree"),
            note_html("Share of a marker's corners rejected: a tilted face, a wrong print, a covered marker."),
            table_html(("marker", "corners", "set aside"), disagreeing),
        ]
    if m.unsolved:
        parts += [heading_html("Frames without a pose"), table_html(("frame", "reason"), sorted(m.unsolved.items()))]
    if collected is not None and collected.left_out:
        rows = [row[:4] for row in collected.left_out]
        parts += [
            heading_html("Markers read but not located"),
            collapsible_section_html(f"{len(rows)} of them", table_html(("frame", "camera", "marker", "reason"), rows)),
        ]
    title, verdict = f"Measurement of {result.recording.name}", measurement_verdict(result)
    write_page(
        path,
        Page(
            "measure", title, verdict, parts, list(dict.fromkeys([*_recommended_actions(result), *verdict.next])), links
        ),
    )


def _recommended_actions(result: MeasurementResult) -> list[str]:
    """What an owner does next with a measurement."""
    steps = (
        ["Correct the entries of the markers named below in rig.toml, or their print, and measure again"]
        if result.suspects
        else []
    )
    if result.measurement.unsolved:
        steps.append("See below why frames lack a pose; `rig view REC --frame N` draws the markers read in one")
    if result.held and result.held.ratio > TWICE and abs(result.held.ratio - 1) > 2 * result.held.scatter:
        steps.append("Determine the unmodelled effects: `rig diagnose REC --out found`")
    if result.recording.commands is None:  # nothing was commanded that a calibration could correct
        return [*steps, "See the poses in three dimensions: `rig view MEASURED --page view.html`"]
    return [*steps, "Calibrate from these poses: `rig calibrate MEASURED --out calibration.json`"]


def _held(held: HeldOut | NotHeldOut) -> str:
    if isinstance(held, NotHeldOut):
        return f"No held-out figure: {held.reason}."
    return (
        f"On frames held out, residuals are {held.ratio:.3f} ± {2 * held.scatter:.3f} of what the covariance "
        "predicts (1 where it is true), "
        f"{held.rms:.3f} px RMS over {count_text(held.corners, 'corner')}."
    )


def _suspects(suspects: Sequence[Suspect]) -> list[str]:
    if not suspects:
        return []
    return [
        heading_html("Markers that disagree with rig.toml"),
        note_html("What disagrees is excluded from the poses."),
        list_html(map(str, suspects)),
    ]


def _pictures(result: MeasurementResult) -> list[str]:
    m = result.measurement
    usual, bad = _frame_of_median_residual(m), _frame_of_greatest_residual(m)
    shown = _frame_pictures_html(result.recording, m, usual)
    if not shown:
        return []
    rest = (
        [
            collapsible_section_html(
                f"The frame with the greatest residuals, {bad}", *_frame_pictures_html(result.recording, m, bad)
            )
        ]
        if bad != usual
        else []
    )
    return [heading_html(f"A frame with its detected markers: {usual}"), *shown, *rest]


def _residual_maps(m: Measurement) -> str:
    return figures_side_by_side_html(*(_residual_map(m, i) for i in range(len(m.design.cameras))))


def _residual_map(m: Measurement, i: int) -> str:
    camera, rows = m.design.cameras[i], (m.observations.camera == i) & m.inliers
    size = (float(camera.width), float(camera.height))
    if not rows.any():
        return image_plane_figure(camera.name, "no corners", size, ())
    uv, r = m.observations.uv[rows], m.residuals[rows]
    cell = camera.width / CELLS
    centre, means = image_patch_centres_and_means(uv, np.column_stack([r, (r**2).sum(axis=1) / 2]), cell)
    mean, rms = means[:, :2], np.sqrt(means[:, 2])
    longest = max(float(np.linalg.norm(mean, axis=1).max(initial=0)), 1e-6)
    return image_plane_figure(
        f"{camera.name}: {count_text(rows.sum(), 'corner')}",
        f"longest arrow {longest:.3f} px",
        size,
        (Cells(centre, rms, cell, "px RMS"), Arrows(centre, mean, 1.2 * cell / longest, "px", 3)),
    )


def _uncertainty(m: Measurement, position: Floats, rotation: Floats) -> str:
    return figures_side_by_side_html(
        *(
            plot_panel_svg(
                name,
                ("frame", unit),
                [Series(m.frames, values * 1e6)],
                limits=(0.0, 1.1e6 * float(values.max()) or 1.0),
            )
            for name, unit, values in (("position", "µm", position), ("rotation", "µrad", rotation))
        )
    )


def _cameras(recording: Recording, m: Measurement) -> str:
    sigma = dict(zip(m.adjustment.shared_names, np.sqrt(np.diag(m.adjustment.shared_covariance))))
    rows = []
    for stated, found in zip(recording.design.cameras, m.design.cameras):
        camera = Place("camera", found.name)
        moved = pose_to_vector(stated.pose.inv() * found.pose)
        rows.append(
            (
                found.name,
                f"{np.linalg.norm(moved[:3]) * 1e3:.3f}",
                f"{np.linalg.norm(moved[3:]) * 1e3:.3f}",
                *(
                    f"{value:.3f} ± {2 * sigma.get(UnknownName(camera, term), 0):.3f}"
                    for term, value in (
                        ("fx", found.matrix[0, 0]),
                        ("fy", found.matrix[1, 1]),
                        ("cx", found.matrix[0, 2]),
                        ("cy", found.matrix[1, 2]),
                    )
                ),
            )
        )
    return table_html(("camera", "moved, mm", "turned, mrad", "fx, px (k = 2)", "fy", "cx", "cy"), rows)


def _moves(places: Places) -> str:
    rows = [
        (
            str(move.place),
            "yes" if move.moved else "no",
            *(f"{by * 1e3:+.3f} ± {half * 1e3:.3f}" for by, half in zip(move.by, move.ci95)),
        )
        for move in places.moves
    ]
    return table_html(("marker", "moved", "x, mm", "y, mm", "z, mm", "rx, mrad", "ry, mrad", "rz, mrad"), rows)


def _residuals(places: Places) -> str:
    return plot_panel_svg(
        "residuals frame by frame",
        ("frame", "platform's corners, RMS px"),
        [
            Series(places.frames, places.before, "places as stated", colour=1),
            Series(places.frames, places.after, "as adjusted"),
        ],
        log=True,
    )


def _worst_markers(m: Measurement) -> list[tuple[int, int, str]]:
    o, known = m.observations, np.isfinite(m.residuals[:, 0])
    rows = []
    for marker in np.unique(o.marker[known]):
        own = known & (o.marker == marker)
        share = 1 - m.inliers[own].mean()
        if share > 0.05:
            rows.append((share, int(marker), int(own.sum())))
    ids = m.ids()
    return [(ids[marker], count, f"{share:.0%}") for share, marker, count in sorted(rows, reverse=True)[:12]]
