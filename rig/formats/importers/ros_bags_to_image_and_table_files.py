"""ROS bags unpacked into image files and tables in a folder.

ROS 1 and 2 bags and MCAP files, topics selected by type.

Source: ROS, common_interfaces (sensor_msgs, geometry_msgs, nav_msgs) and REP 103: m, rad, quaternions x y z w; read by
    the package rosbags
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from rig.array_and_json_types import Floats, Json
from rig.errors import FileError, MissingLibrary, RigError
from rig.formats.checked_toml_and_json_entries import rig_part_name_problem
from rig.formats.importers.foreign_file_import_recipe import FROM_BAG, TABLES, Bag, ForeignTable, Images, Recipe
from rig.formats.importers.foreign_table_units_and_timestamps import ambiguity_error
from rig.formats.importers.ros_messages_to_images_and_rows import (
    IMAGES,
    JOINTS,
    POSES,
    TEMPERATURES,
    Message,
    Topic,
    append_table_row_of_ros_message,
    append_time_of_ros_message,
    write_image_message,
)
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.output_files import write_bytes
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

MOST = 5_000_000  # messages
SAME_MOMENT = 50_000_000  # ns that a pose may be from an image, to be of its frame


def unpack_bags(recipe: Recipe, design: Design, folder: Path) -> Recipe:
    """Unpack the bags of a recipe into a folder.

    Returns the Recipe of the unpacked files
    Raises MissingLibrary without rosbags, FileError for what cannot be read, RigError where several topics can be meant
    """
    bag = recipe.bag
    if bag is None:
        return recipe
    with _opened(bag.files) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
    bag = _resolved(bag, kinds, design, recipe)
    wanted = {topic: Topic(topic, kinds[topic]) for _, topic in _parts(bag)}
    ours = {topic: name for name, topic in bag.cameras}
    for count, (name, received, message) in enumerate(_messages(bag.files, wanted)):
        if count >= MOST:
            raise FileError(bag.files[0], f"holds more than {MOST} messages of the topics that are imported")
        topic = wanted[name]
        append_time_of_ros_message(topic, message, received, bag.files[0])
        if name in ours:
            write_image_message(folder / "images" / ours[name], topic, message, bag.files[0])
        else:
            append_table_row_of_ros_message(topic, message, bag.files[0])
    empty = next((topic.name for topic in wanted.values() if not topic.t), None)
    if empty:
        raise FileError(bag.files[0], f"topic {empty} has no messages")
    bare = ", ".join(topic.name for topic in wanted.values() if not topic.stamped)
    lines = (f"{bare}: messages have no stamps, so their times are those at which they were received",) if bare else ()
    return _recipe(
        recipe,
        replace(bag, folder=folder, remarks=lines + tuple(f"{topic} is {part}" for part, topic in _parts(bag))),
        wanted,
        design,
    )


@contextmanager
def _opened(files: tuple[Path, ...]) -> Iterator["AnyReader"]:
    """A reader of bags. Raises MissingLibrary, and FileError for whatever it cannot make sense of."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingLibrary("ROS bags and MCAP files need the package rosbags: pip install 'rig[ros]'") from None
    missing = next((path for path in files if not path.exists()), None)
    if missing:
        raise FileError(missing, "no such file or folder")
    try:
        with AnyReader(list(files), default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
    except (RigError, MemoryError):
        raise
    except AnyReaderError as error:
        raise FileError(files[0], f"is not a readable bag: {error}") from None
    except (
        Exception
    ) as error:  # a damaged file makes the reader fail in ways of its own, none of them the user's concern
        raise FileError(
            files[0], f"is not a readable bag, or it is damaged: {type(error).__name__}: {short_repr(str(error))}"
        ) from error


def _messages(files: tuple[Path, ...], topics: Collection[str]) -> Iterator[tuple[str, int, Message]]:
    """(topic, ns at which it was received, message) in order of time."""
    with _opened(files) as reader:
        for connection, received, raw in reader.messages([c for c in reader.connections if c.topic in topics]):
            yield connection.topic, received, cast(Message, reader.deserialize(raw, connection.msgtype))


def _parts(bag: Bag) -> list[tuple[str, str]]:
    return [
        *((f"camera {name}", topic) for name, topic in bag.cameras),
        *bag.topics,
        *((f"sensor {name}", topic) for name, topic in bag.sensors),
    ]


def _resolved(bag: Bag, kinds: dict[str, str], design: Design, recipe: Recipe) -> Bag:
    """The Bag with all its topics, those that are not stated by their types. Raises RigError for what is not there or
    could be several.
    """
    for part, topic in _parts(bag):
        if topic not in kinds:
            raise FileError(
                bag.files[0],
                f"has no topic {short_repr(topic)} for {part}; it has {', '.join(sorted(kinds)) or 'none'}",
            )
    for stated, permitted in (
        (bag.cameras, IMAGES),
        (bag.sensors, TEMPERATURES),
        *(((pair,), JOINTS if pair[0] == "commands" else POSES) for pair in bag.topics),
    ):
        for name, topic in stated:
            if kinds[topic] not in permitted:
                raise FileError(
                    bag.files[0], f"topic {topic} is of type {kinds[topic]}, and {name} takes {', '.join(permitted)}"
                )
    found = dict(bag.topics)
    for part, permitted in (("commands", JOINTS if design.mechanism.axes else ()), ("poses", POSES)):
        table = getattr(recipe, part)
        if part in found or (table is not None and table.file != FROM_BAG):
            continue
        topics = sorted(topic for topic, kind in kinds.items() if kind in permitted)
        if len(topics) > 1:
            raise ambiguity_error(
                f"{bag.files[0]}: several topics can be {part}",
                [(kinds[topic], f"bag.topics.{part}={topic}") for topic in topics],
            )
        if topics:
            found[part] = topics[0]
    cameras = bag.cameras or (() if recipe.images and recipe.images.folders else _cameras(bag, kinds, design))
    if not cameras and "poses" not in found and recipe.poses is None and not (recipe.images and recipe.images.folders):
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items()))
        raise FileError(bag.files[0], f"holds no images and no poses; its topics are {listed or 'none'}")
    return replace(bag, topics=tuple(found.items()), cameras=tuple(cameras))


def _cameras(bag: Bag, kinds: dict[str, str], design: Design) -> list[tuple[str, str]]:
    """(our name, topic) of image topics: the camera's name is a part of the topic's, or there is one of each."""
    topics, names = (
        sorted(topic for topic, kind in kinds.items() if kind in IMAGES),
        [camera.name for camera in design.cameras],
    )
    found = [(name, topic) for name in names for topic in topics if name in topic.split("/")]
    if len(topics) == len(names) == 1:
        found = [(names[0], topics[0])]
    twice = next((name for name, _ in found if sum(other == name for other, _ in found) > 1), None)
    if twice:
        raise ambiguity_error(
            f"{bag.files[0]}: several topics can be camera {twice}",
            [(kinds[topic], f"bag.cameras.{twice}={topic}") for name, topic in found if name == twice],
        )
    if topics and not found:
        raise RigError(
            f"{bag.files[0]}: of which cameras are {', '.join(topics)}? rig.toml has {', '.join(names) or 'none'}; "
            f"--set bag.cameras.{names[0] if names else 'cam0'}={topics[0]} says it"
        )
    return found


def _recipe(recipe: Recipe, bag: Bag, topics: dict[str, Topic], design: Design) -> Recipe:
    """The Recipe with the bag's images and tables as files."""
    assert bag.folder is not None
    changes: Json = {"bag": bag}
    if bag.cameras:
        changes["images"] = replace(
            recipe.images or Images(()), folders=(bag.folder / "images",), names="{camera}/{time}", time_unit="ns"
        )
    for part, name in bag.topics:
        topic, table = topics[name], getattr(recipe, part) or ForeignTable(FROM_BAG)
        order = sorted(range(len(topic.t)), key=topic.t.__getitem__)
        if part == "poses" and bag.cameras:
            order = _near(
                order, topic, sorted({t for _, camera in bag.cameras for t in topics[camera].t}), bag.files[0]
            )
        unit = (
            "m"
            if part == "poses" or not has_links(design.mechanism)
            else None
            if design.mechanism.slides.any()
            else "rad"
        )
        changes[part] = replace(
            table,
            file=_table(bag.folder / f"{part}.csv", topic.header, [(topic.t[k], topic.rows[k]) for k in order]),
            separator="comma",
            decimal="point",
            time_unit="ns",
            unit=table.unit or unit,
        )
    if bag.sensors:
        t, columns = _resampled_sensors([(name, topics[topic]) for name, topic in bag.sensors], bag.files[0])
        file = _table(
            bag.folder / "sensors.csv", tuple(name for name, _ in bag.sensors), list(zip(t, columns.tolist()))
        )
        changes["sensors"] = replace(
            recipe.sensors or ForeignTable(FROM_BAG), file=file, separator="comma", decimal="point", time_unit="ns"
        )
    recipe = replace(recipe, **changes)
    lacking = next(
        (part for part in TABLES if (table := getattr(recipe, part)) is not None and table.file == FROM_BAG), None
    )
    if lacking:
        raise RigError(f"{bag.files[0]}: holds no {lacking}, of which something is stated")
    return recipe


def _table(place: Path, header: tuple[str, ...], rows: list[tuple[int, list[float]]]) -> Path:
    text = "\n".join([",".join(("t", *header)), *(",".join([str(t), *map(repr, row)]) for t, row in rows)])
    write_bytes(place, (text + "\n").encode())
    return place


def _near(order: list[int], topic: Topic, images: list[int], file: Path) -> list[int]:
    """The one pose that is nearest to each image. Raises FileError where there is none within SAME_MOMENT."""
    t = np.array([topic.t[k] for k in order])
    nearest = {int(np.abs(t - stamp).argmin()): stamp for stamp in images}
    if not any(abs(int(t[k]) - stamp) <= SAME_MOMENT for k, stamp in nearest.items()):
        raise FileError(file, f"no pose of {topic.name} is within {SAME_MOMENT / 1e9:g} s of any image")
    return [order[k] for k, stamp in sorted(nearest.items()) if abs(int(t[k]) - stamp) <= SAME_MOMENT]


def _resampled_sensors(channels: list[tuple[str, Topic]], file: Path) -> tuple[list[int], Floats]:
    """(times ns, (n, channels) degrees C) of sensors at each other's times, straight lines between their own, where all
    of them have been read.
    """
    bad = next((name for name, _ in channels if rig_part_name_problem(name)), None)
    if bad is not None:
        raise RigError(f"bag.sensors: {rig_part_name_problem(bad)}")
    first, last = max(min(topic.t) for _, topic in channels), min(max(topic.t) for _, topic in channels)
    t = sorted({stamp for _, topic in channels for stamp in topic.t if first <= stamp <= last})
    if not t:
        raise FileError(
            file, f"{', '.join(topic.name for _, topic in channels)}: no time at which all of them were read"
        )
    at = np.array([stamp - first for stamp in t], float)
    columns = []
    for _, topic in channels:
        order = sorted(range(len(topic.t)), key=topic.t.__getitem__)
        columns.append(np.interp(at, [float(topic.t[k] - first) for k in order], [topic.rows[k][0] for k in order]))
    return t, np.stack(columns, axis=1)
