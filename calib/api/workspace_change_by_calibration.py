"""Workspace change by a calibration.

Poses lost and gained, room to limits, singularities, error bounds.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.files import calibration_file
from calib.models.machine_parameters_and_file_entries import calibration_with_workspace
from calib.workspace import workspace_page
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import (
    COLUMNS,
    Workspace,
    certified_cell_promises,
    pose_description_of_axis_margin_map,
    workspace_dict,
    workspace_rows,
)
from rig.array_and_json_types import Floats, Json
from rig.errors import FileError, RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.local_and_remote_input_files import read_bytes
from rig.formats.output_files import write_text
from rig.model import mechanisms
from rig.recording.corner_and_pose_csv_tables import write_table
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import OneLineRepr, Verdict, result_html
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice, ignore_notice


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class WorkspaceResult(OneLineRepr):
    """What a calibration does to the workspace. calibration; name : of its file; workspace : in cells; certified :
    (c, 2) m and rad that a certificate promises in them, or None
    """

    calibration: Calibration
    name: str
    workspace: Workspace
    certified: Floats | None

    @property
    def unit(self) -> str:
        """Unit of the axes' travel."""
        return mechanisms.travel_unit(self.calibration.correction.nominal)

    @property
    def verdict(self) -> Verdict:
        """The verdict on the workspace."""
        summary = workspace_page.workspace_lines(self.workspace, self.unit)[0].removeprefix("workspace: ")
        return workspace_page.workspace_verdict(self.workspace, summary)

    def lines(self) -> list[str]:
        """What is known of it, in words, after the verdict."""
        lines, correction = workspace_page.workspace_lines(self.workspace, self.unit), self.calibration.correction
        if self.certified is not None:
            lines.append(workspace_page.certified_cell_promises_line(self.certified))
        if correction.extension is not None or any(correction.remainder):
            lines.append(
                "beyond the recorded configurations what is corrected on top of the geometry is extrapolated; "
                "its bound grows there"
            )
        return lines

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.lines())

    def tree(self) -> Json:
        """What `rig workspace --json` prints."""
        margins = pose_description_of_axis_margin_map(self.calibration.correction)
        return {"verdict": self.verdict.tree(), **workspace_dict(self.workspace), "room_of": margins}

    def write(self, folder: Path, links: Sequence[Link] = ()) -> None:
        """Write the map into a folder, as data, as a table and as a page."""
        write_text(folder / "workspace.json", json.dumps(self.tree(), allow_nan=False) + "\n")
        write_table(folder / "workspace.csv", COLUMNS, workspace_rows(self.workspace))
        margins = pose_description_of_axis_margin_map(self.calibration.correction)
        workspace_page.write_workspace_page(
            folder / "workspace.html", self.name, self.workspace, self.unit, margins, self.certified, links
        )


def analyse_workspace(path: Path, certificate: Path | None = None, notice: Notice = ignore_notice) -> WorkspaceResult:
    """Workspace analysis of a calibration.json (WorkspaceResult).

    As `rig workspace` makes it.
    certificate : of this calibration, in JSON, or None; notice : called where the workspace has to be worked out
    Raises RigError for a chain, FileError for a file that is no certificate of this calibration
    """
    calibration = calibration_file.load(path)
    if calibration.correction.nominal.bodies:
        raise RigError(f"{path} is of a chain, which reaches most poses in many ways: it has no map of its workspace")
    if calibration.workspace is None:
        notice(f"{path} was made before calibrations contained their workspace: computed now")
        calibration = calibration_with_workspace(calibration)
    workspace = calibration.workspace
    assert workspace is not None
    certified = None
    if certificate is not None:
        certified = certified_cell_promises(workspace, load_certificate(certificate, path))
    return WorkspaceResult(calibration, path.name, workspace, certified)


def load_certificate(path: Path, calibration: Path) -> Entries:
    """Load the entries of a certificate.

    Raises FileError for a file that is none, or one of another calibration
    """
    tree = json_toml_and_yaml_loading.load_json(path, "certificate", "certificate/1")
    marks = tree.table("inputs_sha256")
    mine = hashlib.sha256(read_bytes(calibration)).hexdigest()
    if mine not in {marks.table(name).text("file", default=None) for name in marks.tree}:
        raise FileError(path, f"certifies another calibration than {calibration}: its hash is not among inputs_sha256")
    return tree
