"""One file per command, each with arguments(parser) and run(arguments); they alone see every package, inside run.
`main` runs one of them.
"""

from rig.cli.command_line import main as main
from rig.cli.command_line import run_script as run_script
