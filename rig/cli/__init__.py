"""One file per command or family of commands, with what adds arguments and what runs; they alone see every package.
`main` runs one of them.
"""

from rig.cli.command_line import main as main
from rig.cli.command_line import run_script as run_script
