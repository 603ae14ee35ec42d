"""Renderer of ideal images of a scene.

By pyrender, off screen through EGL; OpenGL's axes are known only here.

The scene is drawn as an oversized pinhole picture, finer than the camera's, and bent through the lens by sampling it
bilinearly at SAMPLES x SAMPLES places of each pixel; the sensor blurs that finer picture before it takes the pixels'
means, as optics do. Markers are white paper to OpenGL: it tells which paper is seen where, with white and with black
light, and the ink is laid exactly between the two (marker_drawing_sensor_and_occlusion.py), because a texture's filters
move edges by some thousandths of a pixel, the same in every picture of one pose.
(cv2.remap would round the places to 1/32 px, which shows.) A pixel centre is at a whole number for OpenCV and half a
pixel further for OpenGL.
"""

from __future__ import annotations

import os
import sys
import types
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, ImageBytes, Pixels, Singles
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.errors import MissingLibrary
from rig.model.design import Camera, Design
from rig.model.pose import exp
from synthetic.marker_drawing_sensor_and_occlusion import bilinear_value, draw_marker_pattern
from synthetic.rig_meshes import BLACK, WHITE, Ink, Part, mesh_body_matrices, part_brightness
from vision import opencv_lens_model as lens

FINER = 1.25  # how many pixels of the pinhole picture to one of the camera's
SAMPLES = 2  # per pixel along either axis, before the pixel's mean
GRID = 16  # px between the points where the lens is undone exactly
PAD = 3  # elements of the finer picture about a marker
OUTLINE = np.linspace(0, 1, 9)[:-1]  # along each side of a marker, where its outline is looked at
NUMBERS = 255  # parts with ink that a picture tells apart; two that share a number must not lie side by side
NEAR_PLANE, FAR_PLANE = 0.02, 50.0  # m
TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV camera axes to OpenGL's
PACKAGES = "libegl1 libgl1"


def import_pyrender_without_viewer() -> types.ModuleType:
    """Import pyrender without its viewer.

    Raises MissingLibrary where there is no OpenGL.
    """
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    if "pyrender" not in sys.modules:
        viewer: Any = types.ModuleType("pyrender.viewer")  # the real one pulls in pyglet and X11
        viewer.Viewer = None
        sys.modules["pyrender.viewer"] = viewer
    try:
        import OpenGL.GL  # noqa: F401  (fails first, and plainly, where the library is missing)
        import pyrender
    except (ImportError, OSError, AttributeError) as error:
        raise MissingLibrary(
            f"rendering needs OpenGL through EGL, which cannot be loaded here; as root: apt-get install -y {PACKAGES}"
        ) from error
    return pyrender


class Renderer:
    """Draws one rig for its cameras. parts : Parts of the scene; design : Design whose cameras look at it."""

    def __init__(self, parts: list[Part], design: Design) -> None:
        self.pyrender = import_pyrender_without_viewer()
        self.parts, self.mechanism = parts, design.mechanism
        self.numbers = {
            id(part): 1 + k % NUMBERS for k, part in enumerate(part for part in parts if part.ink is not None)
        }
        self.cameras = {camera.name: _Pinhole(camera) for camera in design.cameras}
        self.scene = self.pyrender.Scene(bg_color=[0, 0, 0, 0], ambient_light=[1, 1, 1])
        self.nodes = [self.scene.add(self._mesh(part)) for part in parts]
        self.eye = None
        width, height = np.max([p.size for p in self.cameras.values()], axis=0)
        try:
            self.renderer = self.pyrender.OffscreenRenderer(int(width), int(height))
        except Exception as error:  # pyrender passes on whatever EGL raises
            raise MissingLibrary(
                f"no off-screen OpenGL context could be created ({error}); as root: apt-get install -y {PACKAGES}"
            ) from None
        self._without_multisampling()
        # pyrender draws in a set's order, by where nodes lie in memory; where faces meet, the first drawn is what is
        # seen
        self.renderer._renderer._sorted_mesh_nodes = lambda _: self.nodes

    def close(self) -> None:
        """Give the OpenGL context back."""
        self.renderer.delete()

    def draw(
        self,
        camera_name: str,
        T_base_platform: RigidTransform,
        mount: Floats | None = None,
        focal: float = 1.0,
        below: Sequence[RigidTransform] = (),
    ) -> Singles:
        """(SAMPLES height, SAMPLES width) float32 radiance 0..1 seen by a camera at a pose of the platform, SAMPLES to
        the pixel each way.

        below : of a chain, where the platforms of the stages below the last stand, one pose each
        mount : (6,) tangent by which the camera's own pose has moved, on the right, or None; focal : factor on its
            focal length
        """
        pinhole = self.cameras[camera_name]
        poses = mesh_body_matrices(self.mechanism, [*below, T_base_platform])
        for part, node in zip(self.parts, self.nodes):
            matrix = poses[part.body]
            self.scene.set_pose(node, matrix)
            node.mesh.primitives[0].material.baseColorFactor = self._colour(part, part_brightness(part, matrix))
        if self.eye is not None:
            self.scene.remove_node(self.eye)
        stands = pinhole.camera.pose if pinhole.camera.mount != "hand" else T_base_platform * pinhole.camera.pose
        T = (stands if mount is None else stands * exp(mount)).as_matrix()
        if focal != 1:
            pinhole = _Pinhole(_zoomed(pinhole.camera, focal))
        fx, fy, cx, cy = pinhole.intrinsics
        view = self.pyrender.IntrinsicsCamera(fx, fy, cx + 0.5, cy + 0.5, znear=NEAR_PLANE, zfar=FAR_PLANE)
        self.eye = self.scene.add(view, pose=T @ TO_OPENGL)
        self.renderer.viewport_width, self.renderer.viewport_height = pinhole.size
        flags = self.pyrender.RenderFlags.FLAT | self.pyrender.RenderFlags.SKIP_CULL_FACES
        picture = self.renderer.render(self.scene, flags=flags)
        out = pinhole.bend(picture)
        to_camera = np.linalg.inv(T)
        for part in self.parts:
            if part.ink is not None:
                self._lay(part, part.ink, to_camera @ poses[part.body] @ part.ink.to_body, pinhole, picture, out)
        out /= np.float32(255)
        return out

    def _colour(self, part: Part, grey: float) -> list[float]:
        """Red: the part's grey; green: the same where paper is black; blue: the number of a part with ink."""
        if part.ink is None:
            return [grey, grey, 0.0, 1.0]
        return [grey, grey * BLACK / WHITE, self.numbers[id(part)] / 255, 1.0]

    def _lay(self, part: Part, ink: Ink, from_cells: Floats, pinhole: _Pinhole, picture: Pixels, out: Singles) -> None:
        """Lay a part's ink. from_cells : (4, 3) cells (X, Y, 1) to the camera's frame"""
        G, n = from_cells[:3], len(ink.cells)
        if not G[:, 2] @ np.cross(G[:, 0], G[:, 1]) > 0:
            return  # seen from behind
        around = np.concatenate(
            [
                n * np.stack([OUTLINE, 0 * OUTLINE]),
                n * np.stack([1 + 0 * OUTLINE, OUTLINE]),
                n * np.stack([1 - OUTLINE, 1 + 0 * OUTLINE]),
                n * np.stack([0 * OUTLINE, 1 - OUTLINE]),
            ],
            axis=1,
        )
        outline = G @ np.concatenate([around, np.ones((1, around.shape[1]))])
        if outline[2].min() <= NEAR_PLANE:
            return
        box = pinhole.box(outline.T)
        if box is not None:
            draw_marker_pattern(
                picture,
                pinhole.places,
                box,
                pinhole.ideal(box),
                np.linalg.inv(G),
                ink.cells,
                self.numbers[id(part)],
                out,
            )

    def _without_multisampling(self) -> None:
        """Make pyrender draw without multisampling, which would mix the parts' numbers, and hand out what it drew as it
        is.
        """
        from OpenGL import GL

        inner = self.renderer._renderer
        configure = inner._configure_main_framebuffer

        def single() -> None:
            configure()
            if inner._main_fb_ms not in (None, inner._main_fb):  # its buffers live as long as it does
                GL.glDeleteFramebuffers(1, [inner._main_fb_ms])
            inner._main_fb_ms = inner._main_fb

        def read(scene: object, flags: int) -> ImageBytes:
            width, height = inner._main_fb_dims
            GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, inner._main_fb)
            GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
            return np.frombuffer(
                GL.glReadPixels(0, 0, width, height, GL.GL_RGB, GL.GL_UNSIGNED_BYTE), np.uint8
            ).reshape(height, width, 3)

        inner._configure_main_framebuffer, inner._read_main_framebuffer = single, read

    def _mesh(self, part: Part) -> object:
        pyrender = self.pyrender
        material = pyrender.MetallicRoughnessMaterial(baseColorFactor=[1, 1, 1, 1.0])
        uv = None
        if part.texture is not None:
            grey = np.clip(np.round(part.texture * 255), 0, 255).astype(np.uint8)
            material.baseColorTexture = _texture(pyrender, np.repeat(grey[..., None], 3, axis=2))
            uv = part.uv
        primitive = pyrender.Primitive(
            positions=np.asarray(part.mesh.vertices, np.float32),
            indices=np.asarray(part.mesh.faces),
            texcoord_0=None if uv is None else np.asarray(uv, np.float32),
            material=material,
            mode=4,
        )
        return pyrender.Mesh([primitive])


def _texture(pyrender: types.ModuleType, picture: Pixels) -> object:
    """A texture with trilinear mipmaps."""
    from OpenGL import GL

    sampler = pyrender.Sampler(
        magFilter=GL.GL_LINEAR,
        minFilter=GL.GL_LINEAR_MIPMAP_LINEAR,
        wrapS=GL.GL_CLAMP_TO_EDGE,
        wrapT=GL.GL_CLAMP_TO_EDGE,
    )
    return pyrender.Texture(source=picture, source_channels="RGB", sampler=sampler)


def _zoomed(camera: Camera, factor: float) -> Camera:
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= factor
    return replace(camera, matrix=matrix)


class _Pinhole:
    """The oversized pinhole picture behind a camera's image, and the way from one to the other."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        nodes_u, nodes_v = (
            np.arange(-GRID, camera.width + 2 * GRID, GRID),
            np.arange(-GRID, camera.height + 2 * GRID, GRID),
        )
        grid = np.stack(np.meshgrid(nodes_u, nodes_v), axis=-1).astype(float)
        ideal = lens.undistort(grid, camera.matrix, camera.distortion)
        if not np.isfinite(ideal).all():
            raise ValueError(f"camera {camera.name!r}: its lens cannot be undone over the whole image")
        focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1]]) * FINER
        low, high = (ideal * focal).min(axis=(0, 1)), (ideal * focal).max(axis=(0, 1))
        margin = 4
        self.intrinsics = (*focal, *(margin - low))
        self.size = tuple(int(n) for n in np.ceil(high - low + 2 * margin))
        self.splines = [scipy.interpolate.RectBivariateSpline(nodes_v, nodes_u, ideal[..., k]) for k in range(2)]
        x, y = (
            spline(_fine(0, camera.height * SAMPLES), _fine(0, camera.width * SAMPLES)) * focal[k] + margin - low[k]
            for k, spline in enumerate(self.splines)
        )
        self.places = np.stack([x, self.size[1] - 1 - y], axis=-1).astype(np.float32)

    def bend(self, picture: Pixels) -> Singles:
        """(SAMPLES height, SAMPLES width) float32 0..255 of the first channel of a pinhole picture (uint8, last row
        first).
        """
        out = np.empty(self.places.shape[:2], np.float32)
        _bend(picture, self.places, out)
        return out

    def ideal(self, box: tuple[int, int, int, int]) -> Floats:
        """(2, rows + 2, columns + 2) x / z, y / z of the finer picture's elements of a box x0, y0, x1, y1, one more on
        every side.
        """
        x0, y0, x1, y1 = box
        return np.stack([spline(_fine(y0 - 1, y1 + 1), _fine(x0 - 1, x1 + 1)) for spline in self.splines])

    def box(self, points: Floats) -> tuple[int, int, int, int] | None:
        """x0, y0, x1, y1 of the finer picture's elements about points (n, 3) of the camera's frame, or None where none
        is in the picture.
        """
        uv = (lens.project(points, self.camera.matrix, self.camera.distortion) + 0.5) * SAMPLES
        low = np.maximum(np.floor(uv.min(axis=0)).astype(int) - PAD, 0)
        high = np.minimum(
            np.ceil(uv.max(axis=0)).astype(int) + PAD, np.array([self.camera.width, self.camera.height]) * SAMPLES
        )
        return (*low.tolist(), *high.tolist()) if (low < high).all() else None


def _fine(first: int, last: int) -> Floats:
    """px, the centres of elements first .. last - 1 of the finer picture along one axis."""
    return (np.arange(first, last) + 0.5) / SAMPLES - 0.5


@njit(cache=True, nogil=True)
def _bend(picture: Pixels, places: Singles, out: Singles) -> None:
    """Bilinear samples of the first channel of a uint8 picture at places (k, l, 2), in out (k, l) float32."""
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            out[v, u] = bilinear_value(picture, places[v, u, 0], places[v, u, 1], 0)
