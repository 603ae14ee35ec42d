"""Scene -> ideal image (pyrender, off screen through EGL): the only file that knows OpenGL's axes and pixel centres.

The image is drawn as an oversized pinhole picture, finer than the camera's, and bent through the lens by sampling it
bilinearly at several points of each pixel and taking their mean. Both steps are symmetric about the sample, so corners stay
where the lens model puts them. (cv2.remap would round the places to 1/32 px, which shows.) A pixel centre is at a whole
number for OpenCV and half a pixel further for OpenGL.
"""

import os
import sys
import types
from dataclasses import replace

import numpy as np
from numba import njit
from scipy.interpolate import RectBivariateSpline

from rig.errors import MissingLibrary
from rig.pose import exp
from synthetic.scene import body_poses, shade
from vision import lens

FINER = 1.25  # how many pixels of the pinhole picture to one of the camera's
SAMPLES = 2  # per pixel along either axis, before the pixel's mean
GRID = 16  # px between the points where the lens is undone exactly
ANISOTROPY = 16  # texture samples along a foreshortened face
NEAR, FAR = 0.02, 50.0  # m
TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV camera axes to OpenGL's
PACKAGES = "libegl1 libgl1"


def opengl():
    """The pyrender module without its viewer. Raises MissingLibrary naming the packages where there is no OpenGL."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    if "pyrender" not in sys.modules:
        viewer = types.ModuleType("pyrender.viewer")  # the real one pulls in pyglet and X11
        viewer.Viewer = None
        sys.modules["pyrender.viewer"] = viewer
    try:
        import OpenGL.GL  # noqa: F401  (fails first, and plainly, where the library is missing)
        import pyrender
    except (ImportError, OSError, AttributeError) as error:
        raise MissingLibrary(f"rendering needs OpenGL through EGL, which cannot be loaded here; as root: apt-get install -y {PACKAGES}") from error
    return pyrender


class Renderer:
    """Draws one rig for its cameras. parts : Parts of the scene; design : Design whose cameras look at it."""

    def __init__(self, parts, design, finer=FINER, samples=SAMPLES):
        self.pyrender = opengl()
        self.parts, self.mechanism, self.finer, self.samples = parts, design.mechanism, finer, samples
        self.cameras = {camera.name: _Pinhole(camera, finer, samples) for camera in design.cameras}
        self.scene = self.pyrender.Scene(bg_color=[0, 0, 0, 0], ambient_light=[1, 1, 1])
        self.nodes = [self.scene.add(self._mesh(part)) for part in parts]
        self.eye = None
        width, height = np.max([p.size for p in self.cameras.values()], axis=0)
        try:
            self.renderer = self.pyrender.OffscreenRenderer(int(width), int(height))
        except Exception as error:  # pyrender passes on whatever EGL raises
            raise MissingLibrary(f"no off-screen OpenGL context could be made ({error}); as root: apt-get install -y {PACKAGES}") from None
        self._grey_only()

    def close(self):
        """Give the OpenGL context back."""
        self.renderer.delete()

    def draw(self, camera_name, T_base_platform, mount=None, focal=1.0):
        """(height, width) float32 radiance 0..1 seen by a camera at a pose of the platform.

        mount : (6,) tangent by which the camera's own pose has moved, on the right, or None; focal : factor on its focal length
        """
        pinhole = self.cameras[camera_name]
        poses = body_poses(self.mechanism, T_base_platform)
        for part, node in zip(self.parts, self.nodes):
            matrix = poses[part.body]
            self.scene.set_pose(node, matrix)
            grey = shade(part, matrix)
            node.mesh.primitives[0].material.baseColorFactor = [grey, grey, grey, 1.0]
        if self.eye is not None:
            self.scene.remove_node(self.eye)
        T = pinhole.camera.pose if mount is None else pinhole.camera.pose * exp(mount)
        fx, fy, cx, cy = pinhole.intrinsics
        if focal != 1:
            pinhole = _Pinhole(_zoomed(pinhole.camera, focal), self.finer, self.samples)
            fx, fy, cx, cy = pinhole.intrinsics
        view = self.pyrender.IntrinsicsCamera(fx, fy, cx + 0.5, cy + 0.5, znear=NEAR, zfar=FAR)
        self.eye = self.scene.add(view, pose=T.as_matrix() @ TO_OPENGL)
        self.renderer.viewport_width, self.renderer.viewport_height = pinhole.size
        flags = self.pyrender.RenderFlags.FLAT | self.pyrender.RenderFlags.SKIP_CULL_FACES
        return pinhole.bend(self.renderer.render(self.scene, flags=flags))

    def _grey_only(self):
        """Make pyrender draw without multisampling and hand out the red channel alone, which halves the time.

        Marker edges are edges of textures, smoothed by their mipmaps; multisampling does nothing for them.
        """
        from OpenGL import GL

        inner = self.renderer._renderer
        configure = inner._configure_main_framebuffer

        def single():
            configure()
            inner._main_fb_ms = inner._main_fb

        def read(scene, flags):
            width, height = inner._main_fb_dims
            GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, inner._main_fb)
            GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
            return np.frombuffer(GL.glReadPixels(0, 0, width, height, GL.GL_RED, GL.GL_UNSIGNED_BYTE), np.uint8).reshape(height, width)

        inner._configure_main_framebuffer, inner._read_main_framebuffer = single, read

    def _mesh(self, part):
        pyrender = self.pyrender
        material = pyrender.MetallicRoughnessMaterial(baseColorFactor=[1, 1, 1, 1.0])
        uv = None
        if part.texture is not None:
            grey = np.clip(np.round(part.texture * 255), 0, 255).astype(np.uint8)
            material.baseColorTexture = _texture(pyrender, np.repeat(grey[..., None], 3, axis=2))
            uv = part.uv
        primitive = pyrender.Primitive(positions=np.asarray(part.mesh.vertices, np.float32), indices=np.asarray(part.mesh.faces),
                                       texcoord_0=None if uv is None else np.asarray(uv, np.float32), material=material, mode=4)
        return pyrender.Mesh([primitive])


def _texture(pyrender, picture):
    """A texture that stays sharp along a foreshortened face: trilinear mipmaps with anisotropic samples."""
    from OpenGL import GL

    class Anisotropic(pyrender.Texture):
        def _add_to_context(self):
            super()._add_to_context()
            GL.glBindTexture(self.tex_type, self._texid)
            GL.glTexParameterf(self.tex_type, 0x84FE, ANISOTROPY)  # GL_TEXTURE_MAX_ANISOTROPY
            GL.glBindTexture(self.tex_type, 0)

    sampler = pyrender.Sampler(magFilter=GL.GL_LINEAR, minFilter=GL.GL_LINEAR_MIPMAP_LINEAR, wrapS=GL.GL_CLAMP_TO_EDGE,
                               wrapT=GL.GL_CLAMP_TO_EDGE)
    return Anisotropic(source=picture, source_channels="RGB", sampler=sampler)


def _zoomed(camera, factor):
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= factor
    return replace(camera, matrix=matrix)


class _Pinhole:
    """The oversized pinhole picture behind a camera's image, and the way from one to the other."""

    def __init__(self, camera, finer, samples):
        self.camera, self.samples = camera, samples
        nodes_u, nodes_v = np.arange(-GRID, camera.width + 2 * GRID, GRID), np.arange(-GRID, camera.height + 2 * GRID, GRID)
        grid = np.stack(np.meshgrid(nodes_u, nodes_v), axis=-1).astype(float)
        ideal = lens.undistort(grid, camera.matrix, camera.distortion)
        if not np.isfinite(ideal).all():
            raise ValueError(f"camera {camera.name!r}: its lens cannot be undone over the whole image")
        focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1]]) * finer
        low, high = (ideal * focal).min(axis=(0, 1)), (ideal * focal).max(axis=(0, 1))
        margin = 4
        self.intrinsics = (*focal, *(margin - low))
        self.size = tuple(int(n) for n in np.ceil(high - low + 2 * margin))
        fine = (np.arange(camera.width * samples) + 0.5) / samples - 0.5, (np.arange(camera.height * samples) + 0.5) / samples - 0.5
        x, y = (RectBivariateSpline(nodes_v, nodes_u, ideal[..., k])(fine[1], fine[0]) * focal[k] + margin - low[k] for k in range(2))
        self.places = np.stack([x, self.size[1] - 1 - y], axis=-1).astype(np.float32)

    def bend(self, picture):
        """(height, width) float32 0..1 image of a pinhole picture (uint8, last row first)."""
        out = np.empty((self.camera.height, self.camera.width), np.float32)
        _bend(picture, self.places, self.samples, out)
        return out


@njit(cache=True, nogil=True, fastmath=True)
def _bend(picture, places, samples, out):
    """Mean over samples x samples bilinear samples of a uint8 picture at places (h s, w s, 2), for each pixel of out (h, w)."""
    scale = np.float32(1 / (255 * samples * samples))
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            total = np.float32(0)
            for j in range(samples):
                for i in range(samples):
                    x = places[v * samples + j, u * samples + i, 0]
                    y = places[v * samples + j, u * samples + i, 1]
                    x0, y0 = int(x), int(y)
                    fx, fy = x - x0, y - y0
                    top = picture[y0, x0] + fx * (np.float32(picture[y0, x0 + 1]) - picture[y0, x0])
                    bottom = picture[y0 + 1, x0] + fx * (np.float32(picture[y0 + 1, x0 + 1]) - picture[y0 + 1, x0])
                    total += top + fy * (bottom - top)
            out[v, u] = total * scale
