"""What a certificate promises in the cells of a workspace."""

import numpy as np

from calib.workspace.workspace_cells import Workspace
from rig.formats.checked_entries import Entries


def certified_cell_promises(w: Workspace, certificate: Entries) -> np.ndarray:
    """(c, 2) m and rad: the promise of the smallest box of a certificate's volume that a cell's middle lies in, NaN in
    none; rotation NaN where none
    was measured. certificate : Entries of certificate.json. Raises FileError for one that holds no boxes
    """
    out = np.full((len(w.index), 2), np.nan)
    volume = certificate.table("volume")
    for box, promise in [
        (volume, certificate.table("promise")),
        *((cell, cell.table("promise")) for cell in certificate.tables("cells")),
    ]:
        low, high = (box.array(name, (3,)) for name in ("position_low_m", "position_high_m"))
        inside = ((w.centre >= low) & (w.centre <= high)).all(axis=1)
        out[inside] = promise.number("position_m"), promise.number("rotation_rad", nulls=True)
    return out
