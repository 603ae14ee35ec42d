"""Export of a calibration or recording to other programs.

Geometry, corrections, lookup tables, lenses and recordings, in the formats of those programs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import metadata
from pathlib import Path

import numpy as np

from calib.api.corrected_command_lookup_table_over_sensor_channels import corrected_command_lookup_table
from calib.correction.correction_tables import axis_correction_tables, grid_commands_and_corrections
from calib.correction.hexapod_correction_c_source_and_shared_c_file_parts import correction_c_source
from calib.correction.hexapod_kinematics_c_source_for_linuxcnc_and_grblhal import (
    grblhal_kinematics_source,
    linuxcnc_kinematics_source,
)
from calib.files import calibration_file
from calib.models.arm.arm_calibration_page_and_c_source import arm_correction_c_source
from calib.models.arm.arm_correction import ArmCorrection
from rig.errors import RigError
from rig.formats.exporters import (
    json_csv_linuxcnc_and_camera_file_exports,
    recording_as_rerun_tum_parquet,
    urdf_and_sdf_export_of_arms_and_hexapods,
)
from rig.formats.output_files import write_bytes, write_text
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_single_hand_mechanism
from rig.model.mechanism_geometry_classes import Arm, FileMechanism, Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Mechanism,
    has_struts,
    is_redundant,
    require_arm,
    require_hexapod,
    require_hexapod_or_redundant_hexapod,
)
from rig.recording.recording_folder import load_recording
from rig.recording.wanted_poses_and_roll_pitch_yaw import load_wanted_poses

TABLES = ("linuxcnc-comp", "grid")  # of corrections, not of the geometry
C_SOURCES = ("c", "linuxcnc-kins", "grblhal-kins")  # all of a correction, for a controller
LOOKUP = "lut"  # of commands over sensor channels
CAMERAS = ("camera-info", "opencv")  # of a rig.toml, a file each
RECORDINGS = ("tum", "parquet")
GEOMETRIES = {
    "genhexkins": ("hexapod",),
    "urdf": ("hexapod", "arm"),
    "sdf": ("hexapod",),
    "json": ("hexapod", "arm", "file"),
    "csv": ("hexapod", "arm", "file"),
}


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """units : "mm" or "m", machine units of LinuxCNC's formats; coupling : of genhexkins, the share of the
    cardans' twist that turns the screws; lead : of the screws, m per revolution, None for what a rig.toml states; parts
    : of linuxcnc-comp and grid, parts of each actuator's interval, None for 64, and 3; poses : of lut, the table of
    wanted poses; over : of lut, {sensor channel: its values, ascending}; zero : of grblhal-kins, m, lengths of the
    struts where the motors count 0, one or six, () for those of the home pose; uncertainty : of lut, {"position": m or
    "rotation": rad} standard uncertainties for which poses are counted
    """

    units: str = "mm"
    coupling: float = 0.0
    lead: float | None = None
    parts: int | None = None
    poses: Path | None = None
    over: Mapping[str, Sequence[float]] = field(default_factory=dict)
    zero: tuple[float, ...] = ()
    uncertainty: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class ExportResult:
    """Files for another program. files : text or bytes by name, "" where there is one alone; summary : of what they
    hold, "" where there is nothing to say; left_out : what of a calibration they do not hold, in words
    """

    files: Mapping[str, str | bytes]
    summary: str = ""
    left_out: tuple[str, ...] = ()

    @property
    def text(self) -> str | None:
        """The text of the one file, None where there are several."""
        found = self.files.get("")
        return found if isinstance(found, str) else None

    def __str__(self) -> str:
        return self.summary or ", ".join(filter(None, self.files)) or "exported"

    def write(self, place: Path) -> None:
        """Write the one file there, or the files into that folder."""
        for name, data in self.files.items():
            path = place / name if name else place
            write_text(path, data) if isinstance(data, str) else write_bytes(path, data)


def export(machine: Path, kind: str, options: ExportOptions = ExportOptions()) -> ExportResult:
    """ExportResult (texts or bytes of files) of a calibration.json, a rig.toml or a recording.

    A recording for tum and parquet; as `rig export` makes it.

    kind : one of TABLES, C_SOURCES, LOOKUP, CAMERAS, RECORDINGS and GEOMETRIES

    Returns ExportResult, files for another program
    Raises RigError for a machine that this format cannot state, and for options out of range
    """
    if options.uncertainty and kind != LOOKUP:
        raise RigError(f"--uncertainty counts poses for a table of --format lut; --format {kind} takes none")
    if options.zero and kind != "grblhal-kins":
        raise RigError(f"--zero states where motors of grblhal-kins count 0; --format {kind} takes none")
    if kind in TABLES:
        return _correction_tables(machine, kind, options)
    if kind in C_SOURCES:
        version, digest = metadata.version("rig"), sha256(machine.read_bytes()).hexdigest()
        origin = f"rig {version} of {machine.name}, SHA-256 {digest}"
        calibration = calibration_file.load(machine)
        correction, physics = calibration.correction, calibration.physics
        if kind == "linuxcnc-kins":
            source = linuxcnc_kinematics_source(correction, physics, origin, options.units)
        elif kind == "grblhal-kins":
            zero = np.resize(options.zero, 6) if len(options.zero) == 1 else np.array(options.zero)
            made = f"rig {version}, calibration {digest[:12]}"
            source = grblhal_kinematics_source(correction, physics, origin, made, zero if options.zero else None)
        elif isinstance(correction, ArmCorrection):
            source = arm_correction_c_source(correction, physics, origin)
        else:
            source = correction_c_source(correction, physics, origin)
        return ExportResult({"": source.text}, "; ".join(source.notes))
    if kind == LOOKUP:
        if options.poses is None:
            raise RigError("lut takes the wanted poses, as --poses FILE")
        table = corrected_command_lookup_table(
            calibration_file.load(machine), load_wanted_poses(options.poses), options.over
        )
        wanted = [table.poses_for(kind, size) for kind, size in options.uncertainty.items()]
        return ExportResult({"": table.csv}, "; ".join([str(table), *wanted]))
    if kind in CAMERAS:
        return _cameras(machine, kind)
    if kind in RECORDINGS:
        return _recording(machine, kind)
    return _geometry(machine, kind, options)


def _geometry(path: Path, kind: str, options: ExportOptions) -> ExportResult:
    """The geometry of a calibration.json or a rig.toml."""
    mechanism, left_out, lead = _machine(path)
    lead = lead if options.lead is None else options.lead
    _require_plausible_coupling(path, options.coupling, lead)
    kinds = GEOMETRIES[kind]
    if mechanism.kind not in kinds:
        raise RigError(
            f"{kind} takes a mechanism of kind {' or '.join(kinds)}; {path} has one of kind {mechanism.kind!r}"
        )
    text = {
        "genhexkins": lambda: json_csv_linuxcnc_and_camera_file_exports.genhexkins_settings(
            require_hexapod(mechanism), options.units, lead, options.coupling
        ),
        "urdf": lambda: (
            urdf_and_sdf_export_of_arms_and_hexapods.arm_urdf(require_arm(mechanism), path.stem)
            if mechanism.link_rows is not None
            else urdf_and_sdf_export_of_arms_and_hexapods.hexapod_urdf(
                require_hexapod_or_redundant_hexapod(mechanism), path.stem
            )
        ),
        "sdf": lambda: urdf_and_sdf_export_of_arms_and_hexapods.hexapod_sdf(
            require_hexapod_or_redundant_hexapod(mechanism), path.stem
        ),
        "json": lambda: json_csv_linuxcnc_and_camera_file_exports.geometry_json(
            mechanism if isinstance(mechanism, FileMechanism) else _exported(mechanism)
        ),
        "csv": lambda: json_csv_linuxcnc_and_camera_file_exports.geometry_csv(
            mechanism if isinstance(mechanism, FileMechanism) else _exported(mechanism)
        ),
    }[kind]()
    return ExportResult({"": text}, left_out=tuple(left_out))


def _require_plausible_coupling(path: Path, coupling: float, lead: float | None) -> None:
    """Raise RigError for a coupling without the screws' lead (m), and for either out of range."""
    if coupling and lead is None:
        raise RigError(
            f"--coupling takes the screws' lead, m per revolution: give --lead, since {path} "
            "does not state it"
            + (" ([actuator] screw_lead)" if path.suffix == ".toml" else " (a rig.toml may, as [actuator] screw_lead)")
        )
    if not -10 <= coupling <= 10 or (lead is not None and not 0 < lead <= 1):
        raise RigError(
            "--coupling is a share between -10 and 10 and --lead is in metres, above 0 and at most 1, not "
            f"{coupling:g} and {lead:g}"
            if lead is not None
            else f"--coupling is a share between -10 and 10, not {coupling:g}"
        )


def _correction_tables(path: Path, kind: str, options: ExportOptions) -> ExportResult:
    """Corrections as tables, and what they leave out."""
    correction = calibration_file.load(path).correction
    if is_redundant(correction.nominal):
        require_hexapod(correction.nominal)  # whose axes are independent of each other
    mechanism = correction.nominal
    if mechanism.link_rows is not None:
        raise RigError(f"{kind} takes a hexapod's calibration; an arm's is corrected by `rig correct`")
    if kind == "linuxcnc-comp" and not has_struts(mechanism):
        raise RigError(
            f"{kind} is for struts, on top of the geometry that genhexkins has; of a kinematics file --format grid "
            "writes the correction, --format json the parameters"
        )
    parts = options.parts if options.parts is not None else 3 if kind == "grid" else 64
    most = 9 if kind == "grid" else json_csv_linuxcnc_and_camera_file_exports.MOST - 1
    if not 1 <= parts <= most:
        raise RigError(f"--intervals is 1 to {most} for {kind}, not {parts}")
    if kind == "grid":
        text = json_csv_linuxcnc_and_camera_file_exports.correction_grid_csv(
            *grid_commands_and_corrections(correction, parts), mechanism.axes, mechanisms.kinematics_of(mechanism).UNIT
        )
        rows = (parts + 1) ** len(mechanism.axes)
        return ExportResult({"": text}, f"{rows} rows; command = x + k, x as the nominal model has it")
    found = axis_correction_tables(correction, parts + 1)
    files = {
        f"joint_{i}.comp": json_csv_linuxcnc_and_camera_file_exports.linuxcnc_compensation_file(
            levels + correction.fitted.strut_zeros[i], trims, options.units
        )
        for i, (levels, trims) in enumerate(zip(found.levels, found.trims))
    }
    return ExportResult(
        files,
        f"COMP_FILE_TYPE = 0, units {options.units}, on top of genhexkins with the calibration's geometry; "
        f"a table for each joint alone leaves {np.sqrt((found.left**2).mean()) * 1e6:.3f} um RMS of the correction",
    )


def _cameras(path: Path, kind: str) -> ExportResult:
    """The lenses of a rig.toml, a file for each camera."""
    found = design_from_rig_toml.load_design(path).cameras
    if not found:
        raise RigError(f"{path} has no cameras")
    written = (
        json_csv_linuxcnc_and_camera_file_exports.ros_camera_info
        if kind == "camera-info"
        else json_csv_linuxcnc_and_camera_file_exports.opencv_camera_yaml
    )
    return ExportResult({f"{camera.name}.yaml": written(camera) for camera in found})


def _recording(path: Path, kind: str) -> ExportResult:
    """The poses or the tables of a recording."""
    found = load_recording(path)
    if kind == "tum":
        text = recording_as_rerun_tum_parquet.tum_trajectory(found)
        return ExportResult({"": text}, f"{len(text.splitlines()) - 1} poses")
    tables = recording_as_rerun_tum_parquet.parquet_tables(path)
    return ExportResult({f"{name}.parquet": data for name, data in tables.items()})


def _machine(path: Path) -> tuple[Mechanism, list[str], float | None]:
    """(mechanism, what corrects beyond it, in lines, the screws' lead in m or None) of a calibration.json or a
    rig.toml.
    """
    if path.suffix == ".toml":
        design = design_from_rig_toml.load_design(path)
        return design.mechanism, [], design.actuator.screw_lead

    calibration = calibration_file.load(path, several_hands=True)
    correction, left_out = calibration.correction, []
    if calibration.physics is not None and calibration.physics.compensable_effects():
        names = ", ".join(f"{e.label()} at {e.place}" for e in calibration.physics.compensable_effects())
        left_out.append(f"the calibration compensates {names} besides the geometry, which this format does not contain")
    if correction.posed:
        left_out.append(f"maps in pose space ({len(correction.posed)}) are not in this format")
    every = correction.extension is not None
    axes = [str(i + 1) for i, part in enumerate(correction.remainder) if part is not None or every]
    if axes:
        left_out.append(f"the calibration corrects axes {', '.join(axes)} beyond any geometry")
    return correction.fitted, left_out, None


def _exported(mechanism: Mechanism) -> Hexapod | Arm:
    """The mechanism, which has links or struts that can be written."""
    require_single_hand_mechanism(mechanism, "geometry is exported")
    return (
        require_arm(mechanism) if mechanism.link_rows is not None else require_hexapod_or_redundant_hexapod(mechanism)
    )
