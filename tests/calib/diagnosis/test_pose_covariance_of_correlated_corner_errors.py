"""Poses scatter as corner errors do that are correlated within an image, uneven or heavy-tailed: by what is drawn, from
laws other than those that the estimate assumes.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.diagnosis.problems.platform.pose_covariance_of_correlated_corner_errors import (
    pose_covariance_of_unlike_errors,
    smooth_image_errors,
)
from tests.bench.false_findings import QuietCorners

FRAMES, CAMERAS, SEEN = 120, 3, 24  # SEEN : corners of an image
WIDTH, HEIGHT = 1280, 1024


@pytest.fixture(scope="module")
def corners():
    """(SmoothImageErrors, local basis (2n, 6), edges (F + 1,), place (n, 2) in the image from -1 to 1, camera (n,))."""
    rng = np.random.default_rng(5)
    count = FRAMES * CAMERAS * SEEN
    frame = np.repeat(np.arange(FRAMES), CAMERAS * SEEN)
    camera = np.tile(np.repeat(np.arange(CAMERAS), SEEN), FRAMES)
    place = rng.uniform(-1, 1, (count, 2))
    seen = SimpleNamespace(frame=frame, camera=camera, uv=(1 + place) * [WIDTH / 2, HEIGHT / 2])
    edges = np.arange(FRAMES + 1) * CAMERAS * SEEN
    views = rng.normal(size=(CAMERAS, 2, 6, 3))  # of each camera: shift, and change with the place, by the pose
    jacobian = np.einsum("nixk,nk->nix", views[camera], np.c_[np.ones(count), place]).reshape(2 * count, 6)
    local = np.concatenate([np.linalg.qr(part)[0] for part in np.split(jacobian, FRAMES)])
    cameras = [SimpleNamespace(width=WIDTH, height=HEIGHT)] * CAMERAS
    errors = smooth_image_errors(seen, cameras, np.arange(count), edges, np.tile(np.eye(2), (count, 1, 1)), local)
    return errors, local, edges, place, camera


def split(local, drawn):
    """((F, 6) on the frames' own poses, (2n,) the rest) of drawn errors (n, 2)."""
    parts = [(B.T @ e, e - B @ (B.T @ e)) for B, e in zip(np.split(local, FRAMES), np.split(drawn.ravel(), FRAMES))]
    return np.array([pose for pose, _ in parts]), np.concatenate([rest for _, rest in parts])


def air(rng, place, camera):
    waves = [np.cos(a * place[:, 0] + b) * np.cos(c * place[:, 1] + d) for a, b, c, d in rng.uniform(0, 2.5, (5, 4))]
    image = np.repeat(np.arange(FRAMES * CAMERAS), SEEN)
    sizes = rng.normal(size=(FRAMES * CAMERAS, len(waves), 2))
    return rng.normal(size=place.shape) + np.einsum("nk,nkc->nc", np.stack(waves, axis=1), sizes[image])


def uneven(rng, place, camera):
    return rng.normal(size=place.shape) * (1 + 2 * (place**2).sum(axis=1) + 2 * (camera == 1))[:, None]


def heavy(rng, place, camera):
    return np.clip(rng.standard_t(3, size=place.shape), -5, 5)


def test_equal_and_independent_errors_are_told_from_no_others(corners):
    errors, local, edges, place, _ = corners
    for seed in range(20):
        _, rest = split(local, np.random.default_rng(seed).normal(size=place.shape))
        assert pose_covariance_of_unlike_errors(errors, rest, local, edges) is None


@pytest.mark.parametrize("law", [air, uneven, heavy], ids=lambda law: law.__name__)
def test_poses_scatter_as_the_covariance_says(corners, law):
    errors, local, edges, place, camera = corners
    seen, stated = np.zeros((6, 6)), np.zeros((6, 6))
    for seed in range(10):
        poses, rest = split(local, law(np.random.default_rng(seed), place, camera))
        seen += poses.T @ poses / FRAMES / 10
        stated += pose_covariance_of_unlike_errors(errors, rest, local, edges).mean(axis=0) / 10
    ratio = np.linalg.eigvals(np.linalg.solve(stated, seen)).real
    assert np.trace(seen) > 1.2 * 6  # equal and independent errors would make 6 of it
    assert ratio.min() > 0.75 and ratio.max() < 1.35


@pytest.mark.parametrize("number", [7, 9, 26], ids=lambda number: QuietCorners(number, 3000).spoils)
def test_no_strut_is_to_blame_for_what_images_make_of_poses(number):
    assert not QuietCorners(number, 3000).findings()
