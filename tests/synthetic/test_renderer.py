"""Pictures show corners where the lens model puts them, over lenses and tilts; and say plainly where they cannot be
drawn.
"""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.errors import MissingLibrary
from rig.model.design import Camera, Marker, Sensor, Target
from rig.model.pose import pose
from synthetic import ideal_image_renderer as render
from synthetic import rig_meshes
from synthetic.marker_drawing_sensor_and_occlusion import simulate_sensor_exposure
from tests.synthetic.corners_by_edge_lines import edge_corners
from vision.corners.marker_detection_and_corner_fit import ReadMarkers, fit_read_markers
from vision.marker_corner_prediction import State, marker_map, predict_sightings, sightings_facing_cameras_anywhere


def wall(design, tilt, distortion, size=0.11):
    """A design with one camera and a wall of markers one metre ahead, each tilted about its own axis."""
    rng = np.random.default_rng(int(tilt * 100))
    listed = []
    for k, (i, j) in enumerate([(i, j) for i in range(4) for j in range(3)]):
        axis = rng.normal(size=2)
        turn = np.r_[axis / np.linalg.norm(axis) * tilt, 0]
        place = (
            pose([0.16 * (i - 1.5), 0.17 * (j - 1), 1.0], [np.pi, 0, 0])
            * pose([0, 0, 0], turn)
            * pose([0, 0, 0], [0, 0, rng.uniform(0, 6)])
        )
        listed.append(Marker(k, size, place, size / 7))
    camera = Camera(
        "c",
        1280,
        1024,
        [[1500.0, 0, 645.3], [0, 1500, 508.7], [0, 0, 1]],
        np.array(distortion),
        RigidTransform.identity(),
    )
    return replace(design, cameras=(camera,), targets=(Target("wall", "base", "DICT_5X5_100", listed=tuple(listed)),))


def drawn(rig):
    """(fine picture of a wall, its markers' identities, their exact corners (k, 4, 2) px)."""
    home = rig.mechanism.home
    parts = [
        part
        for part in rig_meshes.rig_and_background_meshes(rig)
        if part.body in ("base", "world") and (part.uv is not None or part.normal is None or abs(part.centre[2]) > 0.3)
    ]
    renderer = render.Renderer(parts, rig)
    try:
        image = renderer.draw("c", home)
    finally:
        renderer.close()
    state, markers = State(rig.cameras, RigidTransform.concatenate([home]), {}), marker_map(rig)
    found = sightings_facing_cameras_anywhere(state, markers, 0.3)
    return image, markers.id[found.marker], predict_sightings(found, state, markers)


def edge_errors(image, exact, camera):
    """(k, 4, 2) px, corners by edge lines in a picture less where they are."""
    seen = [edge_corners(image, corners, camera) for corners in exact]
    return np.array([a - b for a, b in zip(seen, exact) if a is not None])


LENSES = {
    "none": [0.0, 0, 0, 0, 0],
    "barrel": [-0.3, 0.12, 5e-4, -5e-4, 0.0],
    "pincushion": [0.15, -0.05, 0, 0, 0.0],
    "fourteen terms": [-0.2, 0.1, 1e-4, 2e-4, 0.01, 0.05, 0.02, 0, 1e-3, 0, -1e-3, 0, 0.01, -0.01],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LENSES)
def test_corners_are_where_the_lens_puts_them(design, name, opengl):
    errors, ours = [], []
    for tilt in np.radians([0, 20, 40, 55, 65]):
        rig = wall(design, tilt, LENSES[name])
        picture, numbers, exact = drawn(rig)
        mean = picture.reshape(1024, render.SAMPLES, 1280, render.SAMPLES).mean(axis=(1, 3))
        errors.append(edge_errors(mean.astype(float), exact, rig.cameras[0]))
        image = simulate_sensor_exposure(
            picture, Sensor(blur=0.5, bits=12), np.random.default_rng(0), render.SAMPLES
        ) * np.float32(255 / 4095)
        found = fit_read_markers(image, rig.cameras[0], marker_map(rig), ReadMarkers(numbers, exact))
        ours.append(found.corners - exact[[numbers.tolist().index(k) for k in found.marker]])
    assert all(len(e) >= 6 for e in errors)
    everything = np.concatenate(errors).reshape(-1, 2)
    assert np.abs(everything.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.mean(everything**2)) < 0.02
    ours = np.concatenate(ours)
    assert np.sqrt(np.median((ours**2).mean(axis=(1, 2)))) < 0.002  # px, without noise; textures had left 0.004
    assert np.sqrt(np.mean(ours**2)) < 0.004


@pytest.mark.slow
def test_struts_hide_markers(design, opengl):
    parts = rig_meshes.rig_and_background_meshes(design)
    pictures = []
    for chosen in (parts, [part for part in parts if not part.body.startswith("strut")]):
        renderer = render.Renderer(chosen, design)  # one at a time: a process has one EGL display
        pictures.append(renderer.draw("cam0", design.mechanism.home))
        renderer.close()
    with_struts, without = pictures
    assert (np.abs(with_struts - without) > 0.05).mean() > 0.01


def test_each_camera_has_its_own_resolution(design, opengl):
    small = replace(
        design.cameras[1], width=320, height=256, matrix=np.array([[400.0, 0, 160], [0, 400, 128], [0, 0, 1]])
    )
    rig = replace(design, cameras=(design.cameras[0], small))
    renderer = render.Renderer(rig_meshes.rig_and_background_meshes(rig, "cluttered", np.random.default_rng(0)), rig)
    try:
        assert renderer.draw("cam0", rig.mechanism.home).shape == (2048, 2560)
        assert renderer.draw("cam1", rig.mechanism.home).shape == (512, 640)
    finally:
        renderer.close()


def test_cameras_drawn_in_turn_leave_no_framebuffers(design, opengl):
    """Each change of resolution makes new ones; those before it must go, or a long run fills the memory."""
    from OpenGL import GL

    first = replace(design.cameras[0], width=64, height=48, matrix=np.array([[80.0, 0, 32], [0, 80, 24], [0, 0, 1]]))
    second = replace(first, name="cam1", width=48)
    rig = replace(design, cameras=(first, second))
    renderer = render.Renderer([], rig)
    try:
        counts = []
        for _ in range(4):
            for camera in rig.cameras:
                renderer.draw(camera.name, rig.mechanism.home)
            counts.append(sum(bool(GL.glIsFramebuffer(number)) for number in range(1, 200)))
    finally:
        renderer.close()
    assert counts == [counts[0]] * 4


def test_without_opengl_one_clear_line(tmp_path):
    code = (
        "import sys\nsys.modules['OpenGL.GL'] = None\n"
        "from synthetic.ideal_image_renderer import import_pyrender_without_viewer\n"
        "from rig.errors import MissingLibrary\n"
        "try: import_pyrender_without_viewer()\nexcept MissingLibrary as e: print(e)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    assert "apt-get install -y libegl1 libgl1" in out and out.count("\n") == 1
    assert issubclass(MissingLibrary, Exception)


def test_a_lens_that_cannot_be_undone_is_refused(design, opengl):
    folding = replace(design.cameras[0], distortion=np.array([-3.0, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match="cannot be undone"):
        render.Renderer([], replace(design, cameras=(folding,)))


def test_the_same_picture_whatever_lies_where_in_memory(opengl, design):
    """Where two faces meet, which of them is seen must not hang on the order in which a set keeps what is drawn."""
    small = replace(
        design,
        cameras=(
            replace(design.cameras[0], width=640, height=512, matrix=design.cameras[0].matrix * [[0.5], [0.5], [1]]),
        ),
    )
    pictures, allocations = [], []
    for k in range(3):
        allocations.append([object() for _ in range(1 + 997 * k)])
        renderer = render.Renderer(rig_meshes.rig_and_background_meshes(small), small)
        try:
            pictures.append(renderer.draw(small.cameras[0].name, small.mechanism.home).tobytes())
        finally:
            renderer.close()
    assert pictures[0] == pictures[1] == pictures[2]
