"""Calibration file (calibration.json), saved and loaded, with its provenance (inputs, data, versions) and frames."""

import hashlib
import json
import math
import platform
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.certification.held_out_pose_error_statistics import Figures, HeldOut
from calib.certification.platform_certification import Certified
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    field_from_entries,
    field_to_dict,
    pose_map_dict,
)
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.files.mechanism_and_physics_entries import (
    mechanism_dict,
    mechanism_from_entries,
    physics_dict,
    physics_from_entries,
    require_known_text,
    require_same_ranges,
    require_schema_contents,
)
from calib.models.arm.arm_certification import CertifiedArm as ArmCertified
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.chain.chain_certification_and_page import CertifiedChain as ChainCertified
from calib.models.machine_parameters_and_file_entries import calibration_with_workspace, machine_model_of_mechanism
from calib.samples.commanded_and_measured_pose_samples import Sampled
from calib.samples.position_confounds_and_poses_on_one_clock import confounds_from_entries, confounds_of_samples
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import workspace_dict, workspace_from_entries
from rig.array_and_json_types import Floats, Json
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import Kinds
from rig.formats import json_toml_and_yaml_loading, local_and_remote_input_files
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.local_and_remote_input_files import read_bytes
from rig.formats.output_files import write_text
from rig.formats.rig_toml.mechanism_entries import write_kinematics_file
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.recording.exposures_and_image_files import LARGEST_IMAGE_FILE
from rig.recording.frame_selection_and_content_hashes import (
    content_hashes_of_frames,
    frames_with_known_hashes,
    sorted_hashes_of_frames,
)
from rig.recording.recording_folder import Recording

PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "rig")
SEED = 0  # of draws; results are the same from run to run


def calibration_with_provenance(
    recording: Recording,
    sampled: Sampled,
    certified: Certified | ArmCertified | ChainCertified,
    claim: Claim,
    arguments: Sequence[str] = (),
    known: tuple[Physics, Floats] | None = None,
    previous_calibration: tuple[Calibration, Json] | None = None,
) -> Calibration:
    """Calibration of a recording's fit, with its provenance.

    Its workspace is computed too.
    arguments : of the command; known : (Physics, covariance of the parameters with it, m^2), or None;
        previous_calibration : on which this is one more pass
    """
    frames, found = sampled.samples.frame, certified.found
    covariance, scatter, together = found.covariance, found.scatter, None
    if isinstance(certified, Certified) and certified.covariance is not None and certified.strut_covariance is not None:
        covariance, together = (
            certified.covariance,
            certified.strut_covariance,
        )  # with all that these samples leave unknown
        scatter = np.sqrt(np.diag(together))
    physics, covariance = (None, covariance) if known is None else known
    source = calibration_provenance(recording, arguments, SEED, sampled.source == "images", sampled.files, sampled.data)
    if previous_calibration is not None:
        source = additional_pass_provenance(source, *previous_calibration)
    return calibration_with_workspace(
        Calibration(
            certified.correction,
            covariance,
            scatter,
            tuple(frames[found.inliers].tolist()),
            tuple(frames[~found.inliers].tolist()),
            certified.held_out,
            source,
            claim,
            physics,
            confounds=confounds_of_samples(sampled.samples, recording.design.mechanism),
            strut_covariance=together,
        )
    )


def calibration_provenance(
    recording: Recording,
    arguments: Sequence[str],
    seed: int,
    used_images: bool,
    other_files: Iterable[Path] = (),
    data: Iterable[str] = (),
) -> Json:
    """Provenance of a calibration as a dict.

    Hashes of its inputs and their data, versions, arguments and seed.

    Marks of the data: see rig.recording.frame_selection_and_content_hashes.
    recording : Recording; used_images : whether they were read; other_files : other files that were read, data : marks
        of theirs
    """
    files: dict[str, str] = {}
    for k, part in enumerate(recording.apart):
        own = _input_digests(part.recording, used_images)
        files |= (
            {f"{k + 1} {part.recording.name}/{name}": digest for name, digest in own.items()}
            if recording.parts
            else own
        )
    files.update({Path(path).name: _hash([path]) for path in other_files})
    return {
        "recording": recording.name,
        "inputs_sha256": files,
        "data": sorted({*sorted_hashes_of_frames(content_hashes_of_frames(recording)), *data}),
        "arguments": list(arguments),
        "seed": seed,
        "versions": package_versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _input_digests(recording: Recording, used_images: bool) -> dict[str, str]:
    """{file: SHA-256} of a recording's files, its images together. used_images : whether they were read"""
    folder = recording.folder
    files = {
        name: _hash([folder / name])
        for name in local_and_remote_input_files.list_folder(folder)
        if name.endswith((".toml", ".csv"))
    }
    if used_images:
        names = sorted(name for name in recording.exposures.image if name)
        files[f"images ({len(names)})"] = _hash([folder / name for name in names])
    return files


def package_versions() -> dict[str, str]:
    """Versions of the packages that results depend on.

    Returns {package name: version}
    """
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def additional_pass_provenance(own: Json, previous_provenance: Calibration, requested_pass: Json) -> Json:
    """Provenance of an additional pass.

    Its own, the passes before it, and the marks of all data.
    """
    retained = ("recording", "inputs_sha256", "arguments", "created", "pass")
    first = {name: previous_provenance.provenance[name] for name in retained if name in previous_provenance.provenance}
    passes = [*previous_provenance.provenance.get("passes", []), first]
    return {
        **own,
        "pass": requested_pass,
        "data": [*previous_provenance.provenance.get("data", []), *own["data"]],
        "passes": passes,
    }


def frames_used_in_calibration(calibration: Calibration, recording: Recording) -> list[int]:
    """Frames of a recording that were used in a calibration.

    Directly or through its measurement.
    """
    return frames_with_known_hashes(content_hashes_of_frames(recording), calibration.provenance.get("data", ()))


def _hash(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(read_bytes(Path(path), LARGEST_IMAGE_FILE))
    return digest.hexdigest()


SCHEMA = "calibration/1"
WITH_PHYSICS = (
    "calibration/2"  # which a program that knows no physics refuses, as it would leave half of the correction out
)
WITH_POSE_MAPS = "calibration/3"  # which one that knows no maps in pose space refuses for the same reason
UNITS = "m, rad, s; covariances in their products"
CONTENTS: dict[
    str, tuple[tuple[str, ...], tuple[str, ...]]
] = {  # what a schema's files must hold, and what they cannot
    SCHEMA: ((), ("physics", "pose_maps")),
    WITH_PHYSICS: (("physics",), ("pose_maps",)),
    WITH_POSE_MAPS: (("pose_maps",), ()),
}

_NONE = Figures(0, (math.nan,) * 3, (math.nan,) * 3, (math.nan,) * 6, (math.nan,) * 2)
NOT_HELD_OUT = HeldOut(
    _NONE, _NONE, (math.nan,) * 2, (math.nan,) * 3, 0
)  # keeps the file's shape where nothing was held out


def save(path: Path | str, calibration: Calibration) -> None:
    """Save a Calibration as calibration.json.

    It is written whole or not at all, and beside it the kinematics file it is of.
    Raises FileError where another kinematics file of that name is there
    """
    write_kinematics_file(Path(path).parent, calibration.correction.nominal)
    write_calibration_json(path, calibration)


def write_calibration_json(path: Path | str, calibration: Calibration) -> None:
    """Write calibration.json alone, whole or not at all."""
    write_text(path, calibration_json_text(calibration))


def calibration_json_text(calibration: Calibration) -> str:
    """Text of a Calibration's calibration.json."""
    correction = calibration.correction
    model = machine_model_of_mechanism(correction.nominal)
    tree = {
        "schema": WITH_POSE_MAPS if correction.posed else SCHEMA if calibration.physics is None else WITH_PHYSICS,
        "units": UNITS,
        "frames": model.frames[0],
        "nominal": mechanism_dict(correction.nominal),
        "fitted": mechanism_dict(correction.fitted),
        "parameter_order": model.parameter_order(correction.nominal),
        "parameter_covariance": calibration.covariance.tolist(),
        model.scatter_key: calibration.scatter.tolist(),
        **({} if calibration.strut_covariance is None else {"strut_covariance": calibration.strut_covariance.tolist()}),
        "remainder": json_toml_and_yaml_loading.json_data(correction.remainder),
        **({"extension": field_to_dict(correction.extension)} if correction.extension is not None else {}),
        **({"pose_maps": [pose_map_dict(one) for one in correction.posed]} if correction.posed else {}),
        **({"visited": correction.visited.tolist()} if isinstance(correction, ArmCorrection) else {}),
        "fit": {"frames": list(calibration.frames), "left_out": list(calibration.left_out)},
        "held_out": json_toml_and_yaml_loading.nan_to_null(asdict(calibration.held_out or NOT_HELD_OUT)),
        "claim": calibration.claim and asdict(calibration.claim),
        **({} if calibration.physics is None else {"physics": physics_dict(calibration.physics)}),
        **({} if calibration.workspace is None else {"workspace": workspace_dict(calibration.workspace)}),
        **({} if calibration.confounds is None else {"confounds": calibration.confounds.tree()}),
        "provenance": calibration.provenance,
    }
    return json.dumps(tree, indent=1) + "\n"


def load(path: Path | str, effect_kinds: Kinds = BY_NAME, several_hands: bool = False) -> Calibration:
    """Load a Calibration from calibration.json.

    effect_kinds : effects that it may hold; several_hands : whether it may be of an arm with several hands. Raises
    FileError
    """
    tree = json_toml_and_yaml_loading.load_json(Path(path), "calibration", SCHEMA, WITH_PHYSICS, WITH_POSE_MAPS)
    nominal, fitted = mechanism_from_entries(tree.table("nominal"), True), mechanism_from_entries(tree.table("fitted"))
    require_same_ranges(tree, nominal, fitted)
    if hand_names(nominal) and not several_hands:
        names = ", ".join(hand_names(nominal))
        tree.fail(f"is of an arm with several hands ({names}), for which this is not done", "nominal")
    schema = tree.text("schema")
    require_schema_contents(tree, *CONTENTS[schema])
    model, axes = machine_model_of_mechanism(nominal), len(nominal.axes)
    extension = field_from_entries(tree.table("extension"), axes) if "extension" in tree.tree else None
    correction = model.correction_from_entries(tree, nominal, fitted, _parts_in(tree, axes), extension)
    for key, known in (
        ("units", (UNITS,)),
        ("frames", model.frames),
        ("parameter_order", (model.parameter_order(nominal),)),
    ):
        require_known_text(tree, key, known)
    count = model.parameter_count(nominal)
    fit = tree.table("fit")
    return Calibration(
        correction,
        covariance_from_entries(tree, count),
        _spread_in(tree, model.scatter_key, axes),
        fit.wholes("frames"),
        fit.wholes("left_out"),
        _held_out_in(tree.table("held_out")),
        _provenance_in(tree),
        _claim_in(tree.table("claim")) if tree.get("claim", None) is not None else None,
        physics_from_entries(tree.table("physics"), nominal, count, effect_kinds) if "physics" in tree.tree else None,
        workspace_from_entries(tree.table("workspace")) if tree.get("workspace", None) is not None else None,
        confounds_from_entries(tree.table("confounds")) if tree.get("confounds", None) is not None else None,
        _strut_covariance_in(tree) if "strut_covariance" in tree.tree else None,
    )


def _parts_in(tree: Entries, axes: int) -> list[Entries | None]:
    """The remainder's table of each axis, None where an axis has none."""
    listed = tree.get("remainder")
    if (
        not isinstance(listed, list)
        or len(listed) != axes
        or not all(part is None or isinstance(part, dict) for part in listed)
    ):
        tree.fail(f"remainder must list {axes} parts, each a table or null", "remainder")
    return [
        None if part is None else Entries(part, ("remainder", i), tree.file, tree.places)
        for i, part in enumerate(listed)
    ]


def covariance_from_entries(tree: Entries, count: int, key: str = "parameter_covariance") -> Floats:
    """Covariance (count, count) from a file's entries, symmetric to rounding.

    Raises FileError for what is none.
    """
    covariance = tree.array(key, (count, count))
    scale = np.sqrt(np.abs(np.diag(covariance)))
    if (
        (np.diag(covariance) < 0).any()
        or (np.abs(covariance) > 1.001 * np.outer(scale, scale) + 1e-30).any()
        or not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-300)
    ):
        tree.fail(f"{key} is not a covariance", key)
    return covariance


def _spread_in(tree: Entries, key: str, axes: int) -> Floats:
    values = tree.array(key, (None,))
    counts = (6, 3) if key == "pose_scatter" else (axes,)  # 3: an arm whose rotations were never measured
    if len(values) not in counts:
        tree.fail(f"{key} must have {counts[0]} numbers, got {len(values)}", key)
    if (values < 0).any():
        tree.fail(f"{key} must not be negative, got {values.tolist()}", key)
    return values


def _strut_covariance_in(tree: Entries) -> Floats:
    """(axes, axes) m^2, whose diagonal are the squares of strut_scatter; not in files of before it was worked out."""
    scatter = tree.array("strut_scatter", (None,))
    covariance = covariance_from_entries(tree, len(scatter), "strut_covariance")
    if not np.allclose(np.diag(covariance), scatter**2, rtol=1e-6, atol=1e-30):
        tree.fail("strut_covariance must have the squares of strut_scatter on its diagonal", "strut_covariance")
    return covariance


def _held_out_in(table: Entries) -> HeldOut | None:
    """HeldOut, or None where nothing was held out."""
    ratio, after = table.array("ratio", (3,), nulls=True), _figures_in(table.table("after"))
    configurations = (
        table.whole("configurations", 0) if "configurations" in table.tree else after.n
    )  # not in files of before they were counted
    return (
        HeldOut(
            _figures_in(table.table("before")),
            after,
            tuple(table.array("floor", (2,), nulls=True).tolist()),
            tuple(ratio.tolist()),
            configurations,
        )
        if after.n
        else None
    )


def _claim_in(table: Entries) -> Claim:
    def numbers(name: str) -> tuple[float, ...] | None:
        return None if table.get(name) is None else tuple(table.array(name, (3,)).tolist())

    def rows(name: str) -> tuple[tuple[float, ...], ...] | None:
        return None if table.get(name) is None else tuple(map(tuple, table.array(name, (2, 3)).tolist()))

    return Claim(
        table.whole("distinct", 0),
        table.whole("determined", 0),
        table.whole("better", 0),
        table.whole("unknowns", 0),
        table.text("tolerance"),
        table.text("workspace"),
        rows("before"),
        rows("after"),
        numbers("ratio"),
        numbers("measured"),
        None if table.get("reason") is None else table.text("reason"),
        *(table.texts(name) if name in table.tree else () for name in ("unexplained", "unrecorded")),
    )


def _figures_in(table: Entries) -> Figures:
    return Figures(
        table.whole("n", 0),
        *(
            tuple(table.array(name, (count,), nulls=True).tolist())
            for name, count in (("position", 3), ("rotation", 3), ("bias", 6), ("mean", 2))
        ),
    )


def _provenance_in(tree: Entries) -> Json:
    """The dict that `calibration_provenance` made: what is read from it again is checked."""
    table = tree.table("provenance")
    if "data" in table.tree:
        table.texts("data")
    return table.tree
