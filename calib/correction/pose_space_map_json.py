"""The pose-space map of a calibration as calibration.json holds it: written as a dict, read from Entries."""

from calib.correction.interpolation import interpolation_methods
from calib.correction.pose_space_map import NAMES, PoseMap
from calib.correction.summand_extension import pose_coordinate_indices
from rig.formats.checked_entries import Entries
from rig.formats.json_tree import Json
from rig.model.mechanism_kinds import Struts
from rig.model.pose import pose_to_entry


def pose_map_dict(pose_map: PoseMap) -> Json:
    """dict of a PoseMap, as JSON holds it."""
    return {
        "home": pose_to_entry(pose_map.home),
        "coordinates": [NAMES[i] for i in pose_map.coordinates],
        "field": interpolation_methods.field_to_dict(pose_map.field),
    }


def pose_map_from_entries(table: Entries, nominal: Struts) -> PoseMap:
    """PoseMap of what `pose_map_dict` gave, as Entries, of a mechanism. Raises FileError for anything else."""
    some = pose_coordinate_indices(nominal)
    if table.texts("coordinates") != tuple(NAMES[i] for i in some):
        table.fail(
            f"{table.name('coordinates')} must be {', '.join(NAMES[i] for i in some)} for a mechanism of "
            f"kind {nominal.kind!r}",
            "coordinates",
        )
    return PoseMap(table.pose("home"), some, interpolation_methods.field_from_entries(table.table("field"), len(some)))
