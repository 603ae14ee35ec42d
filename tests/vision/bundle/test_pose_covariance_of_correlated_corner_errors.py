"""Poses scatter as corner errors do that are correlated within an image, uneven or heavy-tailed: by what is drawn, from
laws other than those that the estimate assumes.
"""

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

import vision.bundle.pose_covariance_of_correlated_corner_errors as module
from tests.bench.false_findings import QuietCorners
from vision.bundle.pose_covariance_of_correlated_corner_errors import (
    pose_covariance_by_estimated_corner_errors,
    smooth_image_error_model_of_corners,
)

FRAMES, CAMERAS, SEEN = 120, 3, 24  # SEEN : corners of an image
WIDTH, HEIGHT = 1280, 1024


def drawn_corners(frames=FRAMES, cameras=CAMERAS, seen=SEEN, base=0.0):
    """(SmoothImageErrors, local basis (2n, 6), edges (F + 1,), place (n, 2) in the image from -1 to 1, camera (n,)).

    base : share of the corners that do not depend on the pose, and count by a covariance larger than theirs; with any,
        which they are (n,) bool is returned in place of the camera
    """
    rng = np.random.default_rng(5)
    count = frames * cameras * seen
    frame = np.repeat(np.arange(frames), cameras * seen)
    camera = np.tile(np.repeat(np.arange(cameras), seen), frames)
    place = rng.uniform(-1, 1, (count, 2))
    views = rng.normal(size=(cameras, 2, 6, 3))  # of each camera: shift, and change with the place, by the pose
    jacobian = np.einsum("nixk,nk->nix", views[camera], np.c_[np.ones(count), place])
    still = rng.uniform(size=count) < base
    jacobian[still] = 0
    local = np.concatenate([np.linalg.qr(part)[0] for part in np.split(jacobian.reshape(2 * count, 6), frames)])
    local[np.repeat(still, 2)] = 0
    edges = np.arange(frames + 1) * cameras * seen
    errors = smooth_image_error_model_of_corners(
        SimpleNamespace(frame=frame, camera=camera, uv=(1 + place) * [WIDTH / 2, HEIGHT / 2]),
        [SimpleNamespace(width=WIDTH, height=HEIGHT)] * cameras,
        np.arange(count),
        edges,
        lambda columns: columns,
        local,
        ~still,
    )
    return errors, local, edges, place, still if base else camera


@pytest.fixture(scope="module")
def corners():
    return drawn_corners()


def split(local, drawn, frames=FRAMES):
    """((F, 6) on the frames' own poses, (2n,) the rest) of drawn errors (n, 2)."""
    parts = [(B.T @ e, e - B @ (B.T @ e)) for B, e in zip(np.split(local, frames), np.split(drawn.ravel(), frames))]
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
        assert pose_covariance_by_estimated_corner_errors(errors, rest, local, edges) is None


@pytest.mark.parametrize("frames, cameras, seen", [(100, 1, 4), (300, 2, 4), (1000, 3, 8)])
def test_nor_are_they_in_frames_of_few_corners(frames, cameras, seen):
    errors, local, edges, place, _ = drawn_corners(frames, cameras, seen)
    for seed in range(10):
        _, rest = split(local, np.random.default_rng(seed).normal(size=place.shape), frames)
        assert pose_covariance_by_estimated_corner_errors(errors, rest, local, edges) is None


def test_corners_whose_covariance_is_not_their_own_say_nothing_of_the_errors():
    errors, local, edges, place, still = drawn_corners(base=0.5)
    errors_of_base = np.where(still, 0.2, 1.0)[:, None]
    for seed in range(10):
        _, rest = split(local, errors_of_base * np.random.default_rng(seed).normal(size=place.shape))
        assert pose_covariance_by_estimated_corner_errors(errors, rest, local, edges) is None


@pytest.mark.parametrize("law", [air, uneven, heavy], ids=lambda law: law.__name__)
def test_poses_scatter_as_the_covariance_says(corners, law):
    errors, local, edges, place, camera = corners
    seen, stated = np.zeros((6, 6)), np.zeros((6, 6))
    for seed in range(10):
        poses, rest = split(local, law(np.random.default_rng(seed), place, camera))
        seen += poses.T @ poses / FRAMES / 10
        stated += pose_covariance_by_estimated_corner_errors(errors, rest, local, edges).mean(axis=0) / 10
    ratio = np.linalg.eigvals(np.linalg.solve(stated, seen)).real
    assert np.trace(seen) > 1.2 * 6  # equal and independent errors would make 6 of it
    assert ratio.min() > 0.7 and ratio.max() < 1.4


def test_memory_does_not_grow_as_the_square_of_the_cameras():
    frames, cameras, seen = 400, 8, 6
    rng = np.random.default_rng(3)
    air = np.repeat(rng.normal(size=(frames * cameras, 2)), seen, axis=0)
    tracemalloc.start()
    try:
        errors, local, edges, place, _ = drawn_corners(frames, cameras, seen)
        _, rest = split(local, air + rng.normal(size=place.shape), frames)
        assert pose_covariance_by_estimated_corner_errors(errors, rest, local, edges) is not None
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < frames * (20 * cameras) ** 2 * 8  # bytes of all frames' products of all columns


def test_rounds_are_those_of_whole_frames(monkeypatch):
    """One round of expectation and maximisation is what each frame's whole matrix of all cameras' columns gives,
    also where some cameras see nothing in some frames."""
    monkeypatch.setattr(module, "ROUNDS", 1)
    _, local, _, place, _ = drawn_corners(30, 3, 12)
    rng = np.random.default_rng(7)
    frame, camera = np.repeat(np.arange(30), 36), np.tile(np.repeat(np.arange(3), 12), 30)
    seen = np.flatnonzero((frame % 4 != 1) | (camera != 1))
    rows = (2 * seen[:, None] + [0, 1]).ravel()
    edges = np.searchsorted(frame[seen], np.arange(31))
    errors = smooth_image_error_model_of_corners(
        SimpleNamespace(frame=frame[seen], camera=camera[seen], uv=(1 + place[seen]) * [WIDTH / 2, HEIGHT / 2]),
        [SimpleNamespace(width=WIDTH, height=HEIGHT)] * 3,
        np.arange(len(seen)),
        edges,
        lambda columns: columns,
        np.concatenate([np.linalg.qr(part)[0] for part in np.split(local[rows], 2 * edges[1:-1])]),
        np.ones(len(seen), bool),
    )
    basis = np.concatenate([np.linalg.qr(part)[0] for part in np.split(local[rows], 2 * edges[1:-1])])
    left, share = rng.normal(size=2 * len(seen)), rng.uniform(0.5, 2, 30)
    width, white, smooth = errors.columns.shape[1], 1.3, 0.02
    along, summed, squares = np.zeros((30, 3, width)), np.zeros((width, width)), 0.0
    for f in range(30):
        part = slice(2 * edges[f], 2 * edges[f + 1])
        cameras = np.repeat(camera[seen], 2)[part]
        whole = np.concatenate([errors.columns[part] * (cameras == c)[:, None] for c in range(3)], axis=1)
        whole = whole - basis[part] @ (basis[part].T @ whole)
        noise, prior = white * share[f], smooth * np.eye(3 * width)
        squares += float(np.sum((whole.T @ whole) ** 2))
        along[f] = (whole.T @ left[part]).reshape(3, width)
        gain = prior @ whole.T @ np.linalg.inv(whole @ prior @ whole.T + noise * np.eye(len(whole)))
        mean, posterior = (gain @ left[part]).reshape(3, width), prior - gain @ whole @ prior
        for c in np.unique(cameras):
            own = slice(width * c, width * (c + 1))
            summed += np.outer(mean[c], mean[c]) + posterior[own, own]
    summed /= len(errors.frame)
    alike = (summed[::2, ::2] + summed[1::2, 1::2]) / 2
    _, Sigma = module._smooth_covariance(errors, along, share, white, smooth)
    np.testing.assert_allclose(Sigma, np.kron(alike, np.eye(2)), rtol=1e-7, atol=1e-12)
    assert errors.sum_of_squares() == pytest.approx(squares, rel=1e-9)


@pytest.mark.parametrize("number", [7, 9, 26], ids=lambda number: QuietCorners(number, 3000).spoils)
def test_no_strut_is_to_blame_for_what_images_make_of_poses(number):
    assert not QuietCorners(number, 3000).findings()
