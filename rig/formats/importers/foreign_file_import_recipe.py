"""Recipe of an import of foreign files.

What is stated about them, from options or TOML; written back completed.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from rig.array_and_json_types import Json
from rig.errors import RigError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.local_and_remote_input_files import read_text, short_repr
from rig.formats.numbers_and_units import parse_number

SCHEMA = "import/1"
LARGEST = 1 << 20  # bytes
SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
DECIMALS = {"point": ".", "comma": ","}
TIMES = ("s", "ms", "us", "ns", "iso")
ROTATIONS = ("rotvec", "quaternion", "quaternion-wxyz", "quaternion-xyzw")
EULER = tuple(a + b + c for letters in ("xyz", "XYZ") for a in letters for b in letters for c in letters if a != b != c)
TABLES = ("commands", "poses", "sensors", "frames")
UNPACKED = ("folder", "remarks")  # of a Bag, what is found out
FROM_BAG = Path()  # in place of the file of a table that a bag holds
NUMBERS = ("steps_per_mm", "shift", "tolerance", "period")


@dataclass(frozen=True, slots=True)
class ForeignTable:
    """One foreign table. None : not stated, to be found out; columns : pairs (our name, their header)

    relative : "zero" for lengths joint to joint, "home" for lengths from home; shift : s added to its times; zone : as
    +01:00, of ISO times without one; unit : of lengths or angles whose header states none; header : names of columns,
    of a file without; period : s between rows, or between the samples that a column `sample` counts, of one without
    times; rows : of commands, "held" for configurations at which one pose each was measured, "moving" for a log
    """

    file: Path
    separator: str | None = None
    decimal: str | None = None
    time_unit: str | None = None
    zone: str | None = None
    shift: float = 0.0
    unit: str | None = None
    relative: str | None = None
    steps_per_mm: float | None = None
    rotation: str | None = None
    rotation_unit: str | None = None
    header: str | None = None
    period: float | None = None
    rows: str | None = None
    columns: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Images:
    """Folders of images. names : pattern with {camera}, {frame}, {time}; tolerance : s within which exposures are one
    frame;
    cameras : pairs (their word, our camera)."""

    folders: tuple[Path, ...]
    names: str | None = None
    time_unit: str | None = None
    zone: str | None = None
    shift: float = 0.0
    tolerance: float | None = None
    cameras: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Cameras:
    """Cameras of another program. names : pairs (theirs, ours); at : six figures, x y z rx ry rz (m, rad) of the first
    in the base frame, or None.
    """

    files: tuple[Path, ...]
    names: tuple[tuple[str, str], ...] = ()
    at: str | None = None


@dataclass(frozen=True, slots=True)
class Bag:
    """Bags of ROS. topics : pairs (commands or poses, topic); cameras : pairs (ours, topic); sensors : pairs (channel,
    topic)
    folder : what they hold as files, once unpacked; remarks : sentences about that"""

    files: tuple[Path, ...]
    topics: tuple[tuple[str, str], ...] = ()
    cameras: tuple[tuple[str, str], ...] = ()
    sensors: tuple[tuple[str, str], ...] = ()
    folder: Path | None = None
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Recipe:
    """All that is imported, and what is stated about it."""

    rig: Path
    images: Images | None = None
    commands: ForeignTable | None = None
    poses: ForeignTable | None = None
    sensors: ForeignTable | None = None
    frames: ForeignTable | None = None
    cameras: Cameras | None = None
    bag: Bag | None = None
    remarks: tuple[str, ...] = field(default=(), compare=False)


def load_recipe(path: Path, settings: tuple[str, ...] = ()) -> Recipe:
    """Load the Recipe of a TOML file.

    settings : "KEY=VALUE" that replace what it says
    Raises FileError for what is no recipe or no setting.
    """
    root = toml_entries(read_text(path, LARGEST), path)
    root.schema("recipe of an import", SCHEMA)
    _set(root.tree, settings)
    return _recipe(root, path.parent)


def recipe_of_options(
    rig: Path | None,
    folders: list[Path],
    tables: dict[str, Path | None],
    settings: tuple[str, ...],
    cameras: Sequence[Path] = (),
    bags: Sequence[Path] = (),
) -> Recipe:
    """Recipe of command line options.

    Rig, image folders, tables, settings, cameras, bags.
    tables : {one of TABLES: file or None}; cameras, bags : files of them. Raises RigError.
    """
    tree: Json = {} if rig is None else {"rig": str(rig)}
    if folders:
        tree["images"] = {"folders": [str(folder) for folder in folders]}
    if cameras:
        tree["cameras"] = {"files": [str(path) for path in cameras]}
    if bags:
        tree["bag"] = {"files": [str(path) for path in bags]}
    tree |= {name: {"file": str(path)} for name, path in tables.items() if path is not None}
    _set(tree, settings)
    return _recipe(Entries(tree, (), Path("--set"), {(): (None, None)}), Path())


def _set(tree: Json, settings: tuple[str, ...]) -> None:
    for setting in settings:
        key, equals, value = setting.partition("=")
        *above, last = key.strip().split(".", 2)
        if not equals or not above or not last:
            raise RigError(f"--set takes KEY=VALUE with a key as commands.unit, not {short_repr(setting)}")
        inner = tree
        for part in above:
            inner = inner.setdefault(part, {})
            if not isinstance(inner, dict):
                raise RigError(f"--set {short_repr(setting)}: {part} is no table")
        inner[last] = value
        if last in NUMBERS:
            try:
                inner[last] = parse_number(value)
            except ValueError:
                raise RigError(f"--set {key} takes a number, not {short_repr(value)}") from None


def recipe_with_settings(recipe: Recipe, settings: Sequence[str]) -> Recipe:
    """The recipe with settings KEY=VALUE applied.

    They are those that an error supposes: SECTION.columns.NAME=HEADER, images.cameras.WORD=NAME, SECTION.shift=S.
    """
    for setting in settings:
        key, _, value = setting.partition("=")
        section, name, *last = key.split(".", 2)
        part = getattr(recipe, section)
        if part is None:
            continue
        if last:
            changed = replace(part, **{name: (*getattr(part, name), (last[0], value))})
        else:
            changed = replace(part, **{name: parse_number(value)})
        recipe = replace(recipe, **{section: changed})
    return recipe


def _recipe(root: Entries, folder: Path) -> Recipe:
    known = ("rig", "images", "cameras", "bag", *TABLES)
    root.refuse_misspelt(("schema", "said", *known))
    for key in root.tree:
        if key not in ("schema", "said", *known):
            root.fail(f"unknown key {short_repr(key)}; there are {', '.join(known)}", key)
    bag = _bag(root.table("bag"), folder) if "bag" in root.tree else None
    files = {root.table(name).tree.get("file") for name in ("commands", "poses") if name in root.tree}
    if "sensors" in root.tree and len(files) == 1 and bag is None:  # columns of the one table that there is
        root.table("sensors").tree.setdefault("file", files.pop())
    stated: dict[str, Any] = {
        name: _foreign_table(root.table(name), folder, bag) for name in TABLES if name in root.tree
    }
    stated["cameras"] = _cameras(root.table("cameras"), folder) if "cameras" in root.tree else None
    images = _images(root.table("images"), folder, bag) if "images" in root.tree else None
    return Recipe(folder / root.text("rig"), images, bag=bag, **stated)


def _known(entries: Entries, kind: type, found_out: tuple[str, ...] = ()) -> None:
    """Raise FileError for a key that is no field of a kind, or one that is found out, not stated."""
    names = tuple(part.name for part in fields(kind) if part.name not in found_out)
    entries.refuse_misspelt(names)
    for key in entries.tree:
        if key not in names:
            entries.fail(f"unknown key {entries.name(key)!r}; there are {', '.join(names)}", key)


def _pairs(entries: Entries, key: str) -> tuple[tuple[str, str], ...]:
    inner = entries.table(key, optional=True)
    return tuple((str(name), inner.text(name)) for name in inner.tree)


def _bag(e: Entries, folder: Path) -> Bag:
    _known(e, Bag, UNPACKED)
    if "files" not in e.tree:
        e.fail(f"{e.name('files')} is missing: settings of a bag that is not imported")
    topics = _pairs(e, "topics")
    odd = next((name for name, _ in topics if name not in ("commands", "poses")), None)
    if odd is not None:
        e.fail(
            f"unknown key 'bag.topics.{odd}'; there are commands, poses; cameras and sensors have tables of their own",
            "topics",
        )
    return Bag(tuple(folder / name for name in e.texts("files")), topics, _pairs(e, "cameras"), _pairs(e, "sensors"))


def _images(e: Entries, folder: Path, bag: Bag | None) -> Images:
    _known(e, Images)
    folders = e.texts("folders") if bag is None or "folders" in e.tree else ()
    return Images(
        tuple(folder / name for name in folders),
        e.text("names", default=None),
        e.text("time_unit", TIMES, default=None),
        e.text("zone", default=None),
        e.number("shift", 0.0),
        e.number("tolerance", None, least=0.0, most=3600.0, unit="s"),
        _pairs(e, "cameras"),
    )


def _cameras(e: Entries, folder: Path) -> Cameras:
    _known(e, Cameras)
    if "files" not in e.tree:
        e.fail(f"{e.name('files')} is missing: settings of cameras that are not imported")
    return Cameras(tuple(folder / name for name in e.texts("files")), _pairs(e, "names"), e.text("at", default=None))


def _foreign_table(e: Entries, folder: Path, bag: Bag | None) -> ForeignTable:
    from rig.formats.importers.foreign_table_units_and_timestamps import ALL

    _known(e, ForeignTable)
    if "file" not in e.tree and bag is None:
        e.fail(f"{e.name('file')} is missing: settings of a table that is not imported")
    file = folder / e.text("file") if "file" in e.tree else FROM_BAG
    return ForeignTable(
        file,
        e.text("separator", tuple(SEPARATORS), default=None),
        e.text("decimal", tuple(DECIMALS), default=None),
        e.text("time_unit", TIMES, default=None),
        e.text("zone", default=None),
        e.number("shift", 0.0),
        e.text("unit", tuple(ALL), default=None),
        e.text("relative", ("zero", "home"), default=None),
        e.number("steps_per_mm", None, above=0.0),
        e.text("rotation", (*ROTATIONS, *EULER), default=None),
        e.text("rotation_unit", ("rad", "deg"), default=None),
        e.text("header", default=None),
        e.number("period", None, above=0.0, most=3600.0, unit="s"),
        e.text("rows", ("held", "moving"), default=None),
        _pairs(e, "columns"),
    )


def recipe_toml(recipe: Recipe, folder: Path) -> str:
    """TOML text of a Recipe, its paths relative to a folder."""
    import tomlkit

    def path(given: Path) -> str:
        return os.path.relpath(os.path.realpath(given), os.path.realpath(folder))

    document = tomlkit.document()
    for line in ("`rig import --recipe THIS --out REC` repeats it. Determined from the files:", *recipe.remarks):
        document.add(tomlkit.comment(" ".join(line.split())))
    document.add("schema", SCHEMA)
    document.add("rig", path(recipe.rig))
    for name in ("bag", "images", "cameras", *TABLES):
        section = getattr(recipe, name)
        if section is None:
            continue
        table = tomlkit.table()
        for part in fields(section):
            value = getattr(section, part.name)
            if part.name in UNPACKED or _unpacked(value, recipe):
                continue
            if part.name in ("folders", "files"):
                table.add(part.name, [path(one) for one in value])
            elif part.name == "file":
                table.add("file", path(value))
            elif isinstance(value, tuple):
                if value:
                    table.add(part.name, dict(value))
            elif value is not None and not (part.name == "shift" and value == 0):
                table.add(part.name, value)
        document.add(name, table)
    return tomlkit.dumps(document)


def _unpacked(value: object, recipe: Recipe) -> bool:
    """Whether a value is a file, or folders, that a bag was unpacked into: gone when the recipe is read again."""
    bag = recipe.bag.folder if recipe.bag is not None else None
    paths = value if isinstance(value, tuple) else (value,)
    return bag is not None and any(isinstance(path, Path) and path.is_relative_to(bag) for path in paths)
