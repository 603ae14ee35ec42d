"""The commands that the documents tell, as a reader would type them."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[2]
USAGE = ROOT / "docs" / "commands.md"  # patterns of commands, none of them to be typed as it stands
PAGES = sorted(set((ROOT / "docs").glob("*.md")) - {USAGE}) + [ROOT / "README.md"]
SKETCH = re.compile(r" \.\.|\.\. | \| |\[")  # a line that leaves something to the reader


def commands(page: Path) -> list[str]:
    """Lines of a page's blocks that are commands, without what is said beside them after two spaces or more."""
    lines = re.findall(r"^    (rig [a-z].*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    parts = [part for line in lines for part in re.split(r"\s{2,}(?=rig )", line)]
    return [re.split(r"\s{2,}", line)[0] for line in parts if not SKETCH.search(re.split(r"\s{2,}", line)[0])]


def words(command: str) -> list[str]:
    """A command's words after `rig`."""
    return shlex.split(command)[1:]
