"""Corners of an image sample, and dictionary mistakes.

The sample is of a recording, and corners are read from it; also mistakes in corners.csv.
"""

from collections import Counter
from collections.abc import Iterator

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Pixels
from rig.checks import Mistake
from rig.errors import FileError
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import Recording
from vision.checks.corner_and_lens_convention_trials import FRAMES
from vision.corners.marker_detection_and_corner_fit import Detection, detect_markers, read_marker_ids
from vision.marker_corner_prediction import MarkerMap, marker_map
from vision.reading.corner_reading_from_recording_images import image_reader
from vision.reading.marker_identity_mistakes_and_expected_marker_places import FAMILIES
from vision.reading.parallel_image_map_rendered_markers_and_white_level import map_images_in_threads

TRIED = 6  # images in which other dictionaries are tried
LEAST = 3  # sightings of an identity of the rig in another dictionary, from which that is named
FEW = 3  # frames looked at before anything is measured
SURE = 0.7  # proof from which that is said
OFF = 0.3  # px by which corners.csv may differ from what is read in the images, in the middle


def image_sample_corners_and_mistakes(recording: Recording) -> tuple[Corners | None, list[Mistake]]:
    """Corners read from a sample of images, and the images' Mistakes.

    They are a recording's images; no corners (None) without images.
    """
    markers = marker_map(recording.design, RigidTransform.identity())
    sights, found = _sights(recording, markers, FRAMES)
    numbers = Counter(int(number) for *_, seen in sights for number in seen.marker)
    found += _other_dictionary_mistakes([image for _, _, image, _ in sights], numbers, markers)
    corners = _corners(sights)
    return corners, found if corners is None else found + list(_against(recording.corners, corners))


def corners_of_sampled_frame_images(recording: Recording) -> Corners | None:
    """Corners read from the images of a few frames.

    None where there are none.
    """
    return _corners(_sights(recording, marker_map(recording.design, RigidTransform.identity()), FEW)[0])


def dictionary_and_identity_mistakes(recording: Recording) -> list[Mistake]:
    """Mistakes of dictionary or identity in a sample of images.

    They are certain; mirroring is one of them.
    """
    markers = marker_map(recording.design, RigidTransform.identity())
    sights, _ = _sights(recording, markers, FEW)
    seen = Counter(int(number) for *_, one in sights for number in one.marker)
    return [
        one
        for one in _other_dictionary_mistakes([image for _, _, image, _ in sights], seen, markers)
        if one.spoils and one.proof >= SURE
    ]


Sight = tuple[int, str, Pixels, Detection]


def _corners(sights: list[Sight]) -> Corners | None:
    """Corners of what was detected, None where that is nothing."""
    rows = [
        (frame, name, int(number), k) for frame, name, _, seen in sights for number in seen.marker for k in range(4)
    ]
    if not rows:
        return None
    frame, name, number, corner = zip(*rows)
    uv = np.concatenate([seen.corners.reshape(-1, 2) for *_, seen in sights if len(seen.marker)])
    return Corners(np.array(frame), list(name), np.array(number), np.array(corner), uv, None)


def _sights(recording: Recording, markers: MarkerMap, count: int) -> tuple[list[Sight], list[Mistake]]:
    """((frame, camera, image, what was detected) of the images of some frames; Mistakes: images that cannot be
    read).
    """
    e, frames = recording.exposures, recording.exposures.times()[0]
    reader = image_reader(recording)
    picked = frames[np.unique(np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int))]
    looked_at, found = [], []
    for frame, name in dict.fromkeys(zip(e.frame.tolist(), e.camera)):
        if frame not in picked or not name:
            continue
        try:
            image = reader(frame, name)
        except FileError as error:
            found.append(Mistake(str(error), "Replace the image, or remove its row from frames.csv", True, 0.9))
            continue
        camera = recording.design.camera(name)
        if image is not None and image.shape == (camera.height, camera.width):
            looked_at.append((frame, name, image))
    seen = map_images_in_threads(
        lambda one: detect_markers(one[2], recording.design.camera(one[1]), markers), looked_at, None
    )
    return [(*one, detection) for one, detection in zip(looked_at, seen)], found


def _other_dictionary_mistakes(images: list[Pixels], seen: Counter[int], markers: MarkerMap) -> list[Mistake]:
    """Targets none of whose markers is read in images (height, width) uint8, though another dictionary's are; mirrored
    images.

    seen : how often each identity was read
    """
    lost = [
        name
        for name in dict.fromkeys(markers.target)
        if not any(seen[int(number)] for number, target in zip(markers.id, markers.target) if target == name)
    ]
    if not lost or not images:
        return []
    some = [images[k] for k in np.unique(np.linspace(0, len(images) - 1, min(TRIED, len(images))).round().astype(int))]
    ids = {name: {int(number) for number, target in zip(markers.id, markers.target) if target == name} for name in lost}
    stated = {name: dictionary for name, dictionary in zip(markers.target, markers.dictionary)}
    votes = {
        family: Counter(number for image in some for number in read_marker_ids(image, family)) for family in FAMILIES
    }
    found: dict[str, list[str]] = {}
    for name in lost:
        count = {
            family: sum(votes[family][number] for number in ids[name])
            for family in FAMILIES
            if not _kin(family, stated[name])
        }
        best = max(count, key=lambda family: count[family])
        if count[best] >= LEAST:
            found.setdefault(best, []).append(name)
    out = [
        Mistake(
            "rig.toml: wrong dictionary: the markers of "
            f"{'all targets' if len(names) == len(stated) else ', '.join(names)} are of "
            f"{_least(family, names, ids)}, "
            f"not of {', '.join(sorted({stated[name] for name in names}))}",
            "State their dictionary",
            True,
            0.95,
        )
        for family, names in found.items()
    ]
    if out or len(lost) < len(stated):
        rest = [name for name in lost if not any(name in names for names in found.values())]
        return out + [
            Mistake(
                f"rig.toml: no marker of target {name} is seen in {len(images)} images",
                "Check that it is in view, and its ids and dictionary",
                False,
                0.4,
            )
            for name in rest
        ]
    return list(_none(some, markers, votes))


def _none(images: list[Pixels], markers: MarkerMap, votes: dict[str, Counter[int]]) -> Iterator[Mistake]:
    """Why no marker at all is read."""
    for family in dict.fromkeys(markers.dictionary):
        for code in (1, 0):  # left to right, upside down
            if (
                sum(
                    number in set(markers.id.tolist())
                    for image in images
                    for number in read_marker_ids(cv2.flip(image, code), family)
                )
                >= LEAST
            ):
                yield Mistake(
                    "the images are mirrored (flipped): their markers are read only when flipped back",
                    "Save unflipped camera images",
                    True,
                    0.95,
                )
                return
        if (
            sum(
                number in set(markers.id.tolist())
                for image in images
                for number in read_marker_ids(255 - image, family)
            )
            >= LEAST
        ):
            yield Mistake(
                "the images are negatives, or the markers white on black",
                "Invert the images, or print black on white",
                True,
                0.95,
            )
            return
    family, seen = max(votes.items(), key=lambda one: sum(one[1].values()))
    if sum(seen.values()) >= 2 * LEAST:
        yield Mistake(
            f"rig.toml: none of its markers is seen, but others of {family}: {', '.join(map(str, sorted(seen)[:10]))}",
            "State the ids and the dictionary that are printed",
            True,
            0.7,
        )
    else:
        yield Mistake(
            "no marker of any dictionary is read in the images",
            "Check focus, light and size: a cell of a marker requires at least 3 px",
            True,
            0.5,
        )


def _kin(family: str, stated: str) -> bool:
    """Whether a stated dictionary is a part of a family."""
    return family == stated or (family.endswith("_1000") and stated.rsplit("_", 1)[0] == family.rsplit("_", 1)[0])


def _least(family: str, names: list[str], ids: dict[str, set[int]]) -> str:
    """The smallest dictionary of a family that has all these identities."""
    if not family.endswith("_1000"):
        return family
    most = max(number for name in names for number in ids[name])
    return (
        f"{family.rsplit('_', 1)[0]}_{next(size for size in (50, 100, 250, 1000) if most < size)} (or a larger "
        "one of its kind)"
    )


def _against(stated: Corners | None, seen: Corners) -> Iterator[Mistake]:
    """corners.csv against the corners read in the same images."""
    if stated is None:
        return
    known = {
        key: uv
        for key, uv in zip(
            zip(stated.frame.tolist(), stated.camera, stated.marker.tolist(), stated.corner.tolist()), stated.uv
        )
    }
    pairs = [
        (known[key], uv)
        for key, uv in zip(zip(seen.frame.tolist(), seen.camera, seen.marker.tolist(), seen.corner.tolist()), seen.uv)
        if key in known
    ]
    if len(pairs) < 8:
        return
    a, b = np.array(pairs).swapaxes(0, 1)
    by = np.median(a - b, axis=0)
    if np.abs(by).max() < OFF:
        return
    if np.abs(np.abs(by) - 1).max() < OFF / 2:
        what = "pixels are counted from 1, not from 0"
    elif np.abs(np.abs(by) - 0.5).max() < OFF / 2:
        what = "pixels are shifted by half a pixel: the first pixel's centre is (0, 0), not (0.5, 0.5)"
    else:
        what = "its corners are not those of the images (another size, order or recording)"
    yield Mistake(
        f"corners.csv: {what}: they lie ({by[0]:+.2f}, {by[1]:+.2f}) px from those in the images",
        "Write OpenCV's pixels, or omit corners.csv so that the images are read",
        bool(np.abs(by).max() > 2),
        0.9,
    )
