"""A recording as it would be if the owner's clock counted from elsewhere."""

import shutil
from decimal import Decimal
from pathlib import Path

ORIGINS = ("0", "3600", "1700000000")


def counted_from(folder: Path, out: Path, origin: str) -> Path:
    """A copy of a recording folder, all times later by a number of seconds, in decimal."""
    shutil.copytree(folder, out)
    for name in ("commands.csv", "frames.csv", "sensors.csv"):
        lines = [line.split(",") for line in (out / name).read_text().splitlines()]
        at = lines[0].index("t")
        for cells in lines[1:]:
            cells[at] = str(Decimal(cells[at]) + Decimal(origin))
        (out / name).write_text("\n".join(map(",".join, lines)) + "\n")
    return out
