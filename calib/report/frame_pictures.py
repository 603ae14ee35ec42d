"""Pictures of a frame in a page: what each camera saw, its markers outlined as they were read, residuals enlarged."""

import base64
import html

import numpy as np

from rig.recording.recording_folder import Recording
from rig.report.pages.html_elements import note
from vision import jpeg_pictures
from vision.recording_adjustment import Measurement

ENLARGED = 200.0


def frame_pictures_html(recording: Recording, m: Measurement, frame: int) -> list[str]:
    """HTML of the images of a frame; nothing where the recording has corners alone."""
    images = jpeg_pictures.frame_jpegs(recording, frame)
    if not images:
        return []
    figures = [
        _figure(m, i, frame, images[camera.name]) for i, camera in enumerate(m.design.cameras) if camera.name in images
    ]
    return [
        note(
            "Outlined in green: markers that were used; in red: set aside, at a corner at least. Yellow: "
            f"residuals, {ENLARGED:g} times as "
            "long as they are. A marker says its number when it is pointed at."
        ),
        '<div class="panels">' + "".join(figures) + "</div>",
    ]


def frame_of_median_residual(m: Measurement) -> int:
    """The solved frame whose residual is the middle one of all."""
    rms = _by_frame(m)
    return int(m.frames[np.argsort(rms)[len(rms) // 2]])


def frame_of_greatest_residual(m: Measurement) -> int:
    """The solved frame with the greatest residual."""
    return int(m.frames[int(np.argmax(_by_frame(m)))])


def _by_frame(m: Measurement) -> np.ndarray:
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
        said = f"marker {ids[marker]}" + ("" if good else ", set aside")
        shapes.append(
            f'<polygon class="quad{"" if good else " aside"}" points="{points}"><title>{said}</title></polygon>'
        )
    solved = rows[np.isfinite(m.residuals[rows, 0]) & m.inliers[rows]]
    d = "".join(
        f"M{u:.1f} {v:.1f}l{du:.1f} {dv:.1f}"
        for (u, v), (du, dv) in zip(o.uv[solved].tolist(), (ENLARGED * m.residuals[solved]).tolist())
    )
    rms = f", {np.sqrt((m.residuals[solved] ** 2).mean()):.3f} px RMS" if len(solved) else ""
    said = f"frame {frame}, {camera.name}: {len(np.unique(o.marker[rows]))} markers{rms}"
    return (
        f'<figure class="picture"><div class="stack"><img alt="{html.escape(said)}" width="{camera.width}" '
        f'height="{camera.height}" '
        f'src="data:image/jpeg;base64,{base64.b64encode(image).decode()}">'
        f'<svg role="img" aria-label="its markers, outlined" viewBox="-0.5 -0.5 {camera.width} '
        f'{camera.height}">{"".join(shapes)}'
        f'<path class="residual" d="{d}"/></svg></div><figcaption>{html.escape(said)}</figcaption></figure>'
    )
