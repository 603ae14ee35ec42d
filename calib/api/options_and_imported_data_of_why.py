"""Options of `why`, and import of the data that it reads.

WhyOptions states what is known of the data of one machine: a table, a bag, or a folder of either or of images. They are
read, or imported as a recording.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rig.api import import_recording, load
from rig.errors import FileError, RigError
from rig.formats.checked_toml_and_json_entries import nearest_known_word
from rig.formats.importers.arm_from_urdf_dh_or_screw_axis_table import ArmFileOptions, read_arm_file
from rig.formats.importers.foreign_csv_dialect_detection import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_file_import_recipe import TABLES, ForeignTable, Recipe, recipe_of_options
from rig.formats.importers.foreign_pose_table import POSITION
from rig.formats.importers.foreign_table_column_search_and_completion import Cells
from rig.formats.importers.foreign_table_units_and_timestamps import header_name_and_unit
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.local_and_remote_input_files import exists, is_empty, is_folder, list_folder, read_bytes, read_text
from rig.formats.numbers_and_units import ANGLES, LENGTHS
from rig.formats.output_files import write_bytes, write_text
from rig.formats.rig_toml.design_from_rig_toml import LARGEST, design_of_entries
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links
from rig.recording.recording_folder import Recording
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice

TABULAR = (".csv", ".tsv", ".txt", ".dat", ".parquet")
BAGS = (".bag", ".mcap", ".db3")
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
WANTED = (
    "a recording (rig.toml, frames.csv ..), one table of joint values and measured poses, two named commands.csv and "
    "poses.csv, a ROS bag, or folders of images"
)
OF_RECORDING = ("frame", "t", "camera", "image")  # columns of a recording's frames.csv
LISTED = 8
MOST_RADIANS = 6.5  # that joint values reach; so few degrees of travel calibrate nothing


def require_existing_data_path(data: Path) -> None:
    """Require that a path of data exists, else raise FileError.

    It names the nearest that there is; an empty folder is refused too.
    """
    if not exists(data):
        parent = data.parent
        near = nearest_known_word(data.name, list_folder(parent)) if is_folder(parent) else None
        raise FileError(data, "no such file or folder" + (f"; is {str(parent / near)!r} meant?" if near else ""))
    if is_folder(data) and is_empty(data):
        raise FileError(data, f"is an empty folder; it takes {WANTED}")


def is_recording_folder(data: Path) -> bool:
    """Whether a path is a recording's folder.

    Its rig.toml may be missing; among images, frames.csv may also be a table of their times.
    """
    if not is_folder(data) or "frames.csv" not in list_folder(data):
        return False
    header = read_text(data / "frames.csv").partition("\n")[0]
    return {*OF_RECORDING} <= {column.strip() for column in header.split(",")} or not _holds_images(data)


def _holds_images(folder: Path) -> bool:
    """Whether a folder holds images, or folders, which may."""
    return any(Path(name).suffix.lower() in PICTURES or is_folder(folder / name) for name in list_folder(folder))


def import_recipe_of_path(
    data: Path, rig: Path, design: Design, joint_names: Sequence[str] = (), settings: Sequence[str] = ()
) -> Recipe:
    """Recipe of data at a path.

    rig : file of the machine, design : the same; joint_names : its axes' in other files
    settings : "KEY=VALUE" as of `rig import --set`, which decide against what is found out
    Raises FileError for what is no data, RigError where several tables could be meant
    """
    if is_folder(data):
        return _of_folder(data, rig, design, joint_names, settings)
    if data.suffix.lower() in BAGS:
        return _of_bags([data], rig, design, joint_names, settings)
    if data.suffix.lower() in TABULAR:
        return _of_tables({"commands": data, "poses": data}, rig, design, joint_names, settings)
    raise FileError(data, f"is of no kind that is known; there are {', '.join((*TABULAR, *BAGS))}; or {WANTED}")


def _of_folder(data: Path, rig: Path, design: Design, joint_names: Sequence[str], settings: Sequence[str]) -> Recipe:
    names = list_folder(data)
    bags = [data / name for name in names if Path(name).suffix.lower() in BAGS]
    if bags:
        return _of_bags([data] if "metadata.yaml" in names else bags, rig, design, joint_names, settings)
    tables = [name for name in names if Path(name).suffix.lower() in TABULAR]
    known = {Path(name).stem: data / name for name in tables if Path(name).stem in TABLES}
    if "poses" in known:
        known.setdefault("commands", known["poses"])
        return _of_tables(known, rig, design, joint_names, settings)
    if _holds_images(data):
        return recipe_of_options(rig, [data], dict(known), tuple(settings))
    if len(tables) == 1:
        return _of_tables(
            {name: data / tables[0] for name in ("commands", "poses")}, rig, design, joint_names, settings
        )
    listed = ", ".join(names[:LISTED]) + (", .." if len(names) > LISTED else "")
    if not tables:
        raise FileError(data, f"holds no data that are known ({listed}); it takes {WANTED}")
    raise RigError(
        f"{data} holds several tables ({listed}): name one that has joint values and poses, or call the two "
        "commands.csv and poses.csv"
    )


def _of_bags(
    bags: Sequence[Path], rig: Path, design: Design, joint_names: Sequence[str], settings: Sequence[str]
) -> Recipe:
    """Recipe of bags, whose joint states name the joints as the arm's file does."""
    added = [f"commands.columns.{axis}={name}" for axis, name in zip(design.mechanism.axes, joint_names)]
    return recipe_of_options(rig, [], {}, _with_settings(added, settings), bags=bags)


def _with_settings(added: Sequence[str], settings: Sequence[str]) -> tuple[str, ...]:
    """Settings that a user states, after those that were found out of anything else."""
    stated = {setting.partition("=")[0].strip() for setting in settings}
    return (*(setting for setting in added if setting.partition("=")[0] not in stated), *settings)


def _of_tables(
    tables: dict[str, Path], rig: Path, design: Design, joint_names: Sequence[str], settings: Sequence[str]
) -> Recipe:
    """Recipe of tables, columns of commands found by the joints' names where they have them."""
    if not design.mechanism.axes:
        raise RigError(
            f'nothing can be commanded of a mechanism of kind "{design.mechanism.kind}", so that a table of commands '
            "calibrates nothing"
        )
    cells = read_foreign_table_header_and_cells(ForeignTable(tables["commands"]), "commands")
    holds_poses = tables.get("poses") == tables["commands"]
    found = _columns_by_joint_name(cells, design.mechanism.axes, joint_names, holds_poses)
    added = [f"commands.columns.{axis}={header}" for axis, header in found.items()]
    if _is_radians(cells, design, found):
        added.append("commands.unit=rad")
    return recipe_of_options(rig, [], dict(tables), _with_settings(added, settings))


def _columns_by_joint_name(
    cells: Cells, axes: Sequence[str], joint_names: Sequence[str], holds_poses: bool
) -> dict[str, str]:
    """{axis: header} of the columns whose headers are the joints' names, but for units; none where columns q1.. qn
    are there.

    holds_poses : whether measured positions are in the same table. Then capitals separate slides X, Y, Z from measured
        x, y, z: a header that is a position's name is no joint's of another case
    """
    headers = {_bare(header): header for header in cells.header}
    if {axis.lower() for axis in axes} <= {bare.lower() for bare in headers}:
        return {}
    positions = {word for words in POSITION.values() for word in words} if holds_poses else set()
    others = {bare.lower(): header for bare, header in headers.items() if bare not in positions}
    found = {axis: headers.get(_bare(name), others.get(_bare(name).lower())) for axis, name in zip(axes, joint_names)}
    return {axis: header for axis, header in found.items() if header is not None}


def _bare(header: str) -> str:
    """A header without its unit and without a word for position or axis."""
    return re.sub(r"(?i)(_pos(ition)?|/position|[ _]axis)$", "", header_name_and_unit(header)[0].strip())


def _is_radians(cells: Cells, design: Design, found: dict[str, str]) -> bool:
    """Whether turning joints' values, of which no header states the unit, are too small for degrees."""
    if not has_links(design.mechanism) or design.mechanism.slides.any():
        return False
    headers = {header: k for k, header in enumerate(cells.header)}
    columns = [headers[found.get(axis, axis)] for axis in design.mechanism.axes if found.get(axis, axis) in headers]
    if not columns or any(cells.unit(k) in (*ANGLES, *LENGTHS) for k in columns):
        return False
    return max(abs(value) for k in columns for value in cells.numbers(k)) <= MOST_RADIANS


NOISE = (2e-5, 2e-4)  # m, rad; of a laser tracker and its six-degree-of-freedom probe, where nobody states any


@dataclass(frozen=True, slots=True)
class WhyOptions:
    """What is known beside the data. arm : file of the arm, a URDF or a table of rows; rig : a rig.toml, None for
    neither, where the data have their own

    position_sigma : m, rotation_sigma : rad, of the instrument that measured an arm's poses; None for NOISE, assumed
    settings : "KEY=VALUE" as of `rig import --set`; anyway : whether to go on though a mistake makes results
    meaningless
    Raises RigError for an arm and a rig.toml both
    """

    arm: ArmFileOptions = ArmFileOptions()
    rig: Path | None = None
    position_sigma: float | None = None
    rotation_sigma: float | None = None
    settings: tuple[str, ...] = ()
    anyway: bool = False

    def __post_init__(self) -> None:
        if self.arm.file is not None and self.rig is not None:
            raise RigError("--urdf or --dh and --rig both state the machine; give only one")
        for name in ("position_sigma", "rotation_sigma"):
            value = getattr(self, name)
            if value is not None and not 0 < value <= 1:
                raise RigError(f"--{name.replace('_', '-')} takes a size above 0 and up to 1, not {value:g}")
            if value is not None and self.arm.file is None:
                raise RigError(f"--{name.replace('_', '-')} belongs to --urdf or --dh; rig.toml has [instrument]")


def recording_and_whether_noise_is_assumed(
    data: Path, options: WhyOptions, folder: Path, notice: Notice
) -> tuple[Recording, bool]:
    """Recording of data, and whether its poses' noise is assumed.

    It is loaded as it is, or imported to a folder.
    folder : gets a folder `recording`; notice : called with lines on what was read
    Raises as `why`
    """
    arm = read_arm_file(options.arm)
    is_recording = is_recording_folder(data)
    if arm is None and options.rig is None:
        if is_recording and "rig.toml" in list_folder(data):
            return load(data), False
        names = list_folder(data) if is_folder(data) else [data.name]
        if is_folder(data) and "rig.toml" in names:
            return recording_and_whether_noise_is_assumed(data, replace(options, rig=data / "rig.toml"), folder, notice)
        if any(Path(name).suffix.lower() in PICTURES for name in names):
            raise RigError(
                f"{data} holds images and does not state the machine that they show: add --rig rig.toml (`rig new "
                "design` writes one). A lens, from photographs of a printed board, is determined by `rig lens`"
            )
        raise RigError(
            f"{data} does not state the machine: add --urdf FILE.urdf, --dh FILE.csv (Denavit-Hartenberg rows) or "
            "--rig rig.toml"
        )
    for line in () if arm is None else arm.lines:
        notice(line)
    if arm is None:
        assert options.rig is not None
        text = read_text(options.rig, LARGEST)
    else:
        text = arm.rig_toml() + _instrument_text(options)
    stated = folder / "rig.toml" if options.rig is None else options.rig
    design = design_of_entries(toml_entries(text, stated))
    into = folder / "recording"
    if is_recording:
        _copy_without_machine(data, into, notice)
        write_text(into / "rig.toml", text)
        return load(into), arm is not None and options.position_sigma is None
    if arm is not None:
        write_text(stated, text)
    recipe = import_recipe_of_path(data, stated, design, () if arm is None else arm.joint_names, options.settings)
    into.mkdir()
    imported, remarks = import_recording(recipe, into, data)
    if arm is not None:
        stated.unlink()
    for line in (*imported.remarks, *map(str, remarks)):
        notice(line)
    return load(into), arm is not None and options.position_sigma is None


def _copy_without_machine(data: Path, folder: Path, notice: Notice) -> None:
    """Copy a recording's files, all but its rig.toml."""
    for path in sorted(path for path in data.rglob("*") if path.is_file()):
        if path == data / "rig.toml":
            notice(f"{path} is not read: the machine is stated otherwise")
            continue
        into = folder / path.relative_to(data)
        into.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(into, read_bytes(path))


def _instrument_text(options: WhyOptions) -> str:
    """Text of [instrument]."""
    position, rotation = (
        default if value is None else value
        for value, default in zip((options.position_sigma, options.rotation_sigma), NOISE)
    )
    lines = ["[instrument]", 'base = "free"', 'tool = "free"', f"position_sigma = {position!r}   # m"]
    return "\n".join([*lines, f"rotation_sigma = {rotation!r}   # rad", ""])
