"""The commands that the documents tell, as a reader would type them."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[2]
USAGE = ROOT / "docs" / "commands.md"  # patterns of commands, none of them to be typed as it stands
PAGES = sorted(set((ROOT / "docs").glob("*.md")) - {USAGE}) + [ROOT / "README.md"]
SKETCH = re.compile(r" \.\.|\.\. | \| |\[")  # a line that leaves something to the reader


def commands(page: Path) -> list[str]:
    """Lines of a page's blocks that are commands, without the remark behind each."""
    lines = re.findall(r"^    (rig [a-z].*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    typed = [without_remark(line) for line in lines]
    return [line for line in typed if not SKETCH.search(line)]


def without_remark(line: str) -> str:
    """What a shell executes of a line: all before a # that begins a word."""
    return re.split(r"\s+#", line)[0].rstrip()


def words(command: str) -> list[str]:
    """A command's words after `rig`."""
    return shlex.split(command)[1:]
