"""Exposures from the names of image files.

Camera, frame number and time from names of image files, grouped into exposures.
"""

import itertools
import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import FileError, RigError
from rig.formats.importers import foreign_table_units_and_timestamps as times
from rig.formats.importers.foreign_file_import_recipe import Images
from rig.formats.importers.foreign_table_units_and_timestamps import UnclearInput, ambiguity_error
from rig.formats.local_and_remote_input_files import nearest_name_hint, short_repr
from rig.model.design import Design

KINDS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm")
MOST = 1_000_000  # images
STAMP = re.compile(
    r"\d{4}-?\d\d-?\d\d[T_]\d\d:?\d\d:?\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?|(?<!\d)\d{10,19}(?:\.\d+)?(?!\d)"
)
FIGURE = re.compile(r"\d+(?:\.\d+)?")
MOST_DIGITS = 15
CAMERA = "\0"  # stands in a name where the camera was
LONGEST = 0.02  # s; exposures of one frame that are farther apart are not taken for one unless it is stated
PARTS = {"camera": r"(?P<camera>[^/]+?)", "frame": r"(?P<frame>\d{1,15})", "time": r"(?P<time>[0-9TZ:_.,+-]+?)"}


@dataclass(frozen=True, slots=True)
class ImageFile:
    """An image: path; camera : ours; frame : number or None; stamp : text of its time or None."""

    path: Path
    camera: str
    frame: int | None
    stamp: str | None


@dataclass(frozen=True, slots=True, eq=False)
class ImportedExposures:
    """Exposures in order. frame : n numbers; t : n exact s, or None where names tell no times; camera : n names;
    path : n files.
    """

    frame: list[int]
    t: list[Decimal] | None
    camera: list[str]
    path: list[Path]
    images: Images
    remarks: tuple[str, ...]

    def times(self) -> list[Decimal]:
        """t. Raises RigError where it is not stated."""
        if self.t is None:
            raise RigError("nothing states when the images were taken")
        return self.t


def list_image_files(images: Images, design: Design) -> list[ImageFile]:
    """List the image files of the folders.

    Sorted by name, with camera, frame number or time.
    Raises RigError where names do not tell camera and frame or time.
    """
    cameras = {c.name.lower(): c.name for c in design.cameras}
    for theirs, ours in images.cameras:
        if ours.lower() not in cameras:
            raise RigError(
                f"images.cameras: rig.toml has no camera {short_repr(ours)}; it has "
                f"{', '.join(cameras.values()) or 'none'}"
            )
        cameras[theirs.lower()] = cameras[ours.lower()]
    found = []
    for folder in images.folders:
        if not folder.is_dir():
            raise FileError(folder, f"is no folder of images{nearest_name_hint(folder)}")
        files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in KINDS and path.is_file())
        if not files:
            raise FileError(folder, f"holds no images ({', '.join(kind[1:] for kind in KINDS)})")
        found += image_files_of_folder(files[:MOST], folder, cameras, images.names, [c.name for c in design.cameras])
    return found


def image_files_of_folder(
    files: list[Path], folder: Path, cameras: dict[str, str], name_pattern: str | None, rig_cameras: list[str]
) -> list[ImageFile]:
    """Image files of one folder.

    With camera, frame number or time from their names.
    cameras : {word in lower case: camera}; name_pattern : how names are built, None for as they come ours : names of
        the
    cameras of rig.toml
    rig_cameras : names of the cameras of rig.toml

    Raises FileError that names all words of files that stand for no camera of rig.toml, with the settings that would
    say which, and where a name does not tell frame or time
    """
    unknown: dict[str, Path] = {}
    remarks = []
    for path in files:
        word, rest, parts = _camera(path, folder, cameras, name_pattern, rig_cameras)
        if word is None or word.lower() not in cameras:
            unknown.setdefault(word or (rest.rsplit("/", 1)[0] if "/" in rest else rest), path)
        else:
            remarks.append((path, word, rest, parts))
    if unknown:
        meant = [
            f"images.cameras.{theirs}={rig_cameras[k % len(rig_cameras)] if rig_cameras else 'cam0'}"
            for k, theirs in enumerate(list(unknown)[: max(len(rig_cameras), 1)])
        ]
        settings = " ".join(f"--set '{one}'" for one in meant)
        raise UnclearInput(
            f"{next(iter(unknown.values()))}: "
            f"of which camera is it? rig.toml has {', '.join(rig_cameras) or 'none'}; {settings}, or the other "
            "way about, states the meaning of a word, --set 'images.names={camera}_{frame}' how names are built",
            tuple(meant),
            len(unknown) <= len(rig_cameras),
        )
    return [
        _picture(path, cameras[word.lower()], word, rest, parts if name_pattern else None)
        for path, word, rest, parts in remarks
    ]


def _camera(
    path: Path, folder: Path, cameras: dict[str, str], names: str | None, ours: list[str]
) -> tuple[str | None, str, dict[str, str]]:
    """(word that stands for its camera or None, the name with its folder, parts by the stated pattern) of an image's
    file.
    """
    name = str(path.relative_to(folder).with_suffix("")).replace("\\", "/")
    parts = _by_pattern(path, name, names) if names else {}
    rest = name if "/" in name else f"{folder.name}/{name}"
    word = parts.get("camera")
    if word is None:
        word = next(
            (
                w
                for w in sorted(cameras, key=len, reverse=True)
                if re.search(rf"(?<![a-z0-9]){re.escape(w)}(?![a-z0-9])", rest.lower())
            ),
            None,
        )
    if word is None and len(ours) == 1:
        word = ours[0]
    return word, rest, parts


def _picture(path: Path, camera: str, word: str, rest: str, parts: dict[str, str] | None) -> ImageFile:
    """Picture of a file. word : that stands for its camera; rest : its name with its folder; parts : of it by the
    stated pattern, None for none
    """
    if parts is not None:
        return ImageFile(path, camera, int(parts["frame"]) if "frame" in parts else None, parts.get("time"))
    stem = rest.rsplit("/", 1)[-1]
    stem = re.sub(rf"(?<![a-z0-9]){re.escape(word)}(?![a-z0-9])", CAMERA, stem, flags=re.IGNORECASE)
    return ImageFile(path, camera, *_figures(path, stem))


def _by_pattern(path: Path, name: str, names: str) -> dict[str, str]:
    wanted = re.escape(names).replace(r"\*", ".*?")
    for part, expression in PARTS.items():
        wanted = wanted.replace(re.escape(f"{{{part}}}"), expression, 1)
    if r"\{" in wanted or not set(re.findall(r"\?P<(\w+)>", wanted)) & {"frame", "time"}:
        raise RigError(
            f"images.names = {short_repr(names)}: a pattern has {{frame}} or {{time}}, {{camera}} where "
            "folders do not state it, and * for "
            "anything"
        )
    found = re.fullmatch(wanted, name if "/" in names else name.rsplit("/", 1)[-1])
    if found is None:
        raise FileError(path, f"its name is not as images.names = {short_repr(names)} has it")
    return found.groupdict()


def _figures(path: Path, stem: str) -> tuple[int | None, str | None]:
    """(frame, time) of what is left of a file's name."""
    stamp = STAMP.search(stem)
    rest = stem if stamp is None else stem[: stamp.start()] + " " + stem[stamp.end() :]
    figures = FIGURE.findall(rest)
    if stamp is None and len(figures) == 1 and "." in figures[0]:
        return None, figures[0]
    if len(figures) > 1:
        raise ambiguity_error(
            f"{path}: which figure of its name is the frame's number?",
            [
                (f"{figure}{tail}", f"images.names={_pattern(stem, k, part)}")
                for part, tail in (("{frame}", ""), ("{time}", ", a time"))
                for k, figure in enumerate(FIGURE.findall(stem))
            ],
        )
    if stamp is None and not figures:
        raise FileError(
            path, "its name has neither frame nor time; number the images, or give a table of them: --frames FILE.csv"
        )
    if figures and "." in figures[0]:
        figures = []
    if figures and len(figures[0]) > MOST_DIGITS:
        raise FileError(path, f"a frame's number has at most {MOST_DIGITS} digits, not {len(figures[0])}")
    return (int(figures[0]) if figures else None), (stamp[0] if stamp else None)


def _pattern(stem: str, k: int, part: str) -> str:
    """A pattern of names in which the k-th figure of a stem is a part, and the others are anything."""
    count = itertools.count()
    return FIGURE.sub(lambda found: part if next(count) == k else "*", stem).replace(CAMERA, "{camera}")


def group_images_into_exposures(
    image_files: list[ImageFile], images: Images, are_plausible: Callable[[Floats], bool]
) -> ImportedExposures:
    """Group image files into exposures.

    By frame number, else by time.
    are_plausible : whether times (n,) s from the first can be so.

    Raises FileError for names that are not built alike.
    """
    numbered, timed = [p.frame is not None for p in image_files], [p.stamp is not None for p in image_files]
    if any(numbered) and not all(numbered) or any(timed) and not all(timed):
        odd = image_files[(numbered if any(numbered) and not all(numbered) else timed).index(False)]
        known = ", ".join(sorted({p.camera for p in image_files}))
        raise FileError(
            odd.path,
            f"its name is not built as the others', read as images of {known}; a camera that rig.toml lacks "
            "is to be put "
            "there, --set 'images.names=..' says how names are built, and other images go into another folder",
        )
    message: tuple[str, ...] = ()
    t = None
    if all(timed):
        stamps = [p.stamp.replace("_", "T") for p in image_files if p.stamp is not None]
        read = times.read_times(
            stamps,
            "images",
            "names of images",
            images.time_unit,
            images.zone,
            images.shift,
            lambda t: are_plausible(np.sort(t)),
        )
        t, message, images = read.seconds, read.remarks, replace(images, time_unit=read.unit, zone=read.zone)
    numbers = [p.frame for p in image_files if p.frame is not None]
    if len(numbers) < len(image_files):
        if t is None:
            raise FileError(image_files[0].path, "its name has neither a frame nor a time")
        return _grouped(image_files, t, images, message)
    if images.tolerance is not None:
        raise RigError("images.tolerance groups images by their times, and these have frame numbers; leave it out")
    order = sorted(range(len(image_files)), key=lambda k: (numbers[k], image_files[k].camera))
    _once([(numbers[k], image_files[k].camera, image_files[k].path) for k in order])
    return ImportedExposures(
        [numbers[k] for k in order],
        None if t is None else [t[k] for k in order],
        [image_files[k].camera for k in order],
        [image_files[k].path for k in order],
        images,
        message,
    )


def _once(rows: list[tuple[int, str, Path]]) -> None:
    seen: dict[tuple[int, str], Path] = {}
    for frame, camera, path in rows:
        if (frame, camera) in seen:
            raise FileError(path, f"is frame {frame} of camera {camera}, as {seen[frame, camera]} is")
        seen[frame, camera] = path


def _grouped(found: list[ImageFile], t: list[Decimal], images: Images, remarks: tuple[str, ...]) -> ImportedExposures:
    """Exposures that are at most a tolerance apart become one frame, each at its own time."""
    order = sorted(range(len(found)), key=lambda k: (t[k], found[k].camera))
    within, tolerance_remarks = _tolerance(found, t, order, images)
    groups: list[list[int]] = []
    for k in order:
        if groups and float(t[k] - t[groups[-1][0]]) <= within:
            groups[-1].append(k)
        else:
            groups.append([k])
    frame, at, widest = [], [], 0.0
    for number, group in enumerate(groups):
        cameras = [found[k].camera for k in group]
        if len(set(cameras)) < len(cameras):
            twice = next(c for c in cameras if cameras.count(c) > 1)
            raise RigError(
                f"{found[group[0]].path}: within {within:g} s camera {twice} has several images, so they are "
                "not of one frame; a smaller "
                "tolerance separates them: --set images.tolerance=S"
            )
        widest = max(widest, float(t[group[-1]] - t[group[0]]))
        frame += [number] * len(group)
        at += [t[k] for k in group]
    flat = [k for group in groups for k in group]
    remarks = (
        *remarks,
        *tolerance_remarks,
        f"images within {within:g} s of each other are one frame (the widest {widest * 1e3:.3g} ms)",
    )
    return ImportedExposures(
        frame,
        at,
        [found[k].camera for k in flat],
        [found[k].path for k in flat],
        replace(images, tolerance=within),
        remarks,
    )


def _tolerance(
    found: list[ImageFile], t: list[Decimal], order: list[int], images: Images
) -> tuple[float, tuple[str, ...]]:
    """(s, sentences): as stated, or a quarter of the shortest time between two images of one camera. Raises RigError
    where exposures lie between.
    """
    if images.tolerance is not None:
        return images.tolerance, ()
    own: dict[str, list[Decimal]] = defaultdict(list)
    for k in order:
        own[found[k].camera].append(t[k])
    apart = [float(b - a) for times_of in own.values() for a, b in zip(times_of, times_of[1:])]
    within = min(LONGEST, 0.25 * min(apart, default=4 * LONGEST))
    gaps = np.array([float(t[b] - t[a]) for a, b in zip(order, order[1:]) if found[a].camera != found[b].camera])
    between = gaps[(gaps > within) & (gaps < 0.5 * min(apart, default=np.inf))] if len(own) > 1 else gaps[:0]
    if len(between):
        far = float(between.max())
        raise ambiguity_error(
            f"names of images: exposures of different cameras are {between.min():.3g} to {far:.3g} s apart: "
            "are they of one frame?",
            [("yes", f"images.tolerance={far * 1.01:.3g}"), ("no", f"images.tolerance={within:.3g}")],
        )
    return within, ()
