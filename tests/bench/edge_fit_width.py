"""How far beside an edge the fit looks, and how finely its spread is learnt: candidates compared on pictures of our
own.

Corners of the same pictures are fitted with every candidate, the spread learnt from the pictures themselves as `rig
measure` does.
Each kind of picture (exact ones and the renderer's, blurs, defocus, a halo, sharpening) gives the RMS of a candidate's
corner errors (without the largest, see SOUND) over the least any candidate has there; a candidate's score is the
geometric mean over the kinds. vision/corners/edge_pixels.py's REACH and vision/corners/edge_spread_function.py's KNOTS
are the smallest reach, then the fewest knots, whose score is within MARGIN of the best one's.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import correlate1d

from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Marker, Sensor, Target
from rig.model.pose import exp, pose
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.vision.exact_pictures import camera, picture, quad

REACHES, KNOTS = (2.4, 2.8, 3.2, 3.6), (5, 7, 9, 11)
MARGIN = 0.01
# share of the errors, the smallest, that count: the rig's own struts cover some corners in the renderer's pictures
SOUND = 0.95
NAME, PICTURES, DRAWS, SIZE = "DICT_5X5_100", 10, 3, 130
DRAWN = {
    "blur 0.3, noise 1": Sensor(blur=0.3, read_noise=1.0),
    "blur 0.7, noise 2": Sensor(blur=0.7, read_noise=2.0),
    "defocus 1.2, noise 1": Sensor(defocus=1.2, read_noise=1.0),
}


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    here = Path(__file__).parents[2]
    scores = {}
    for reach in REACHES:  # compiled into the fit, hence a process and a cache of its own for each
        with tempfile.TemporaryDirectory() as cache:
            done = subprocess.run(
                [sys.executable, "-m", "tests.bench.edge_fit_width", str(reach)],
                cwd=here,
                text=True,
                check=True,
                stdout=subprocess.PIPE,
                env={**os.environ, "NUMBA_CACHE_DIR": cache},
            )
        scores.update({(reach, knots): errors for knots, errors in json.loads(done.stdout)})
    least = {kind: min(errors[kind] for errors in scores.values()) for kind in next(iter(scores.values()))}
    mean = {
        key: float(np.exp(np.mean([np.log(errors[kind] / least[kind]) for kind in least])))
        for key, errors in scores.items()
    }
    for reach in REACHES:
        yield (
            f"reach {reach}: score with {', '.join(map(str, KNOTS))} knots",
            ", ".join(f"{mean[reach, knots]:.3f}" for knots in KNOTS),
            "",
        )
    best = min(key for key in mean if mean[key] <= (1 + MARGIN) * min(mean.values()))
    from vision.corners import edge_pixels
    from vision.corners import edge_spread_function as spread

    yield "reach and knots by the rule; as they are", f"{best}; {(edge_pixels.REACH, spread.KNOTS)}", "equal"
    for kind in least:
        yield f"{kind}: RMS with them; least of all", f"{scores[best][kind]:.4f}; {least[kind]:.4f} px", ""


def _exact(rng):
    """{kind: [(image, [camera], [identity], true corners (1, 4, 2))]} of pictures by brute force."""

    def plain(corners, number, blur):
        return picture(corners, NAME, number, blur, samples=8, size=SIZE)

    def halo(corners, number):
        return 0.85 * plain(corners, number, 0.5) + 0.15 * plain(corners, number, 1.6)

    def sharpened(corners, number):
        image = plain(corners, number, 0.6)
        for axis in (0, 1):
            image = correlate1d(image, [-0.08, 1.16, -0.08], axis=axis)
        return image

    def shaken(corners, number):
        return np.mean([plain(corners + [d, 0], number, 0.4) for d in np.linspace(-0.8, 0.8, 7)], axis=0)

    kinds = {
        f"exact, blur {blur}, noise {noise}": (lambda c, k, blur=blur: plain(c, k, blur), noise)
        for blur, noise in ((0.4, 1.0), (0.7, 2.0), (1.2, 1.0))
    }
    kinds |= {
        "exact, halo, noise 1": (halo, 1.0),
        "exact, sharpened, noise 1": (sharpened, 1.0),
        "exact, moved 1.6 px, noise 2": (shaken, 2.0),
    }
    out = {}
    for kind, (draw, noise) in kinds.items():
        out[kind] = []
        for k in range(PICTURES):
            corners = quad(rng, rng.uniform(40, 75), rng.uniform(0, 1.0), SIZE)
            clean = draw(corners, k)
            images = [(clean + rng.normal(0, noise, clean.shape)).astype(np.float32) for _ in range(DRAWS)]
            out[kind] += [(image, camera(size=SIZE), [k], corners[None]) for image in images]
    return out


def _rendered(design, rng):
    """The same of the renderer's pictures of a rig."""
    from synthetic import rig_meshes
    from synthetic.ideal_image_renderer import SAMPLES, Renderer
    from synthetic.marker_drawing_sensor_and_occlusion import simulate_sensor_exposure
    from vision.marker_corner_prediction import expected_marker_rows_and_corners_in_image, marker_map

    renderer, markers, out = Renderer(rig_meshes.rig_and_background_meshes(design), design), marker_map(design), {}
    scenes = []
    for _ in range(4):
        T = design.mechanism.home * exp(rng.uniform(-1, 1, 6) * [0.02, 0.02, 0.02, 0.1, 0.1, 0.1])
        for view in design.cameras:
            shown, places = expected_marker_rows_and_corners_in_image(view, T, markers)
            scenes.append((renderer.draw(view.name, T), view, markers.id[shown], places))
    renderer.close()
    for kind, sensor in DRAWN.items():
        out[f"rendered, {kind}"] = [
            (simulate_sensor_exposure(radiance, sensor, rng, SAMPLES), *rest) for radiance, *rest in scenes
        ]
    return out


def _score(pictures, markers):
    """{kind: px, RMS per axis of corners fitted with a spread learnt from the pictures themselves}."""
    from vision.corners.edge_spread_function import PLAIN_EDGE_SPREAD, empty_residual_profile, learn_edge_spread
    from vision.corners.marker_detection_and_corner_fit import ReadMarkers, fit_read_markers, grey_image_at_full_depth
    from vision.reading.corner_reading_from_recording_images import ROUNDS

    out = {}
    for kind, shown in pictures.items():
        start = [
            (grey_image_at_full_depth(image) if image.dtype != np.float32 else image, view, np.asarray(ids), true)
            for image, view, ids, true in shown
        ]
        first = [fit_read_markers(full, view, markers, ReadMarkers(ids, true)) for full, view, ids, true in start]
        spread = PLAIN_EDGE_SPREAD
        for _ in range(ROUNDS):
            profile, widths = empty_residual_profile(), []
            for (full, view, _, _), d in zip(start, first):
                widths.append(
                    fit_read_markers(
                        full, view, markers, d.read, spread=spread, search_distance=0.0, profile=profile
                    ).blur
                )
            spread = learn_edge_spread(spread, profile, float(np.median(np.concatenate(widths))))
        error = []
        for (full, view, ids, true), d in zip(start, first):
            found = fit_read_markers(full, view, markers, d.read, spread=spread)
            at = {number: k for k, number in enumerate(ids.tolist())}
            error += [found.corners[k] - true[at[number]] for k, number in enumerate(found.marker.tolist())]
        square = np.sort(np.abs(error).ravel() ** 2)
        out[kind] = float(np.sqrt(np.mean(square[: int(SOUND * len(square))])))
    return out


def _main(reach):
    from vision.corners import edge_pixels

    edge_pixels.REACH = reach
    from vision.corners import edge_spread_function as spread
    from vision.marker_corner_prediction import marker_map

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3))
        design = design_from_rig_toml.load_design(path)
    listed = tuple(Marker(k, 1.0, pose([0, 0, 0], [0, 0, 0]), 0.9 / 7) for k in range(PICTURES))
    sheet = marker_map(replace(design, targets=(Target("t", "platform", NAME, listed=listed),)))
    rng = np.random.default_rng(0)
    exact, rendered, rows_ = _exact(rng), _rendered(design, rng), []
    for knots in KNOTS:
        spread.KNOTS = knots
        terms = np.zeros((knots, 2 * len(spread.HARMONICS) - 1))
        spread.PLAIN_EDGE_SPREAD = spread.EdgeSpread(terms=terms)
        rows_.append((knots, {**_score(exact, sheet), **_score(rendered, marker_map(design))}))
    print(json.dumps(rows_))


if __name__ == "__main__":
    _main(float(sys.argv[1]))
