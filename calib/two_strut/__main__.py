"""Entry point python -m calib.two_strut FOLDER.

It writes the worked example's figures as SVG files.
"""

import sys
from pathlib import Path

from calib.two_strut.two_strut_patent_example_and_figures import two_strut_example_figures
from rig.formats.output_files import write_text

if len(sys.argv) != 2:
    sys.exit("usage: python -m calib.two_strut FOLDER")
folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
for name, text in two_strut_example_figures().items():
    write_text(folder / f"{name}.svg", text)
