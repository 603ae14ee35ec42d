"""How the tree is written: the linter and the type checker are clean, functions short, what is public told."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("rig", "vision", "calib", "synthetic")


def quiet(*command: str) -> str:
    """What a tool prints about the tree; nothing where it is content."""
    done = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True)
    return "" if done.returncode == 0 else done.stdout + done.stderr


def test_linter_is_clean():
    assert quiet("ruff", "check", "-q", ".") == ""
