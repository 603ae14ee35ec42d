"""rig doctor: check this computer's installation.

Packages, OpenGL, cameras, ports, disk space, threads.
`rig doctor completion` prints shell completion for bash, zsh or fish; `rig doctor kernels` compiles ahead.
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.cli.shared.shared_output_controller_hand_and_worker_options import add_json_option, print_json


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig doctor` to a parser."""
    add_json_option(parser)


def run(arguments: Namespace) -> int:
    """Run `rig doctor`.

    Check this computer's installation and print it.

    Exit status 1 where something is missing without which a plain installation does not work.
    """
    from rig.compute.installation_inventory import installation_inventory

    found = installation_inventory()
    if arguments.json:
        print_json(
            {
                "schema": "doctor/1",
                "found": [
                    {"about": one.about, "state": one.state, "text": one.text, "todo": one.todo} for one in found
                ],
            }
        )
    else:
        wide = max(len(one.about) for one in found)
        for one in found:
            print(f"{one.state:8} {one.about:{wide}}  {one.text}" + (f"; {one.todo}" if one.todo else ""))
    return int(any(one.state == "missing" for one in found))


def arguments_of_completion(parser: ArgumentParser) -> None:
    """Add the arguments of `rig doctor completion` to a parser."""
    parser.add_argument(
        "shell",
        choices=("bash", "zsh", "fish"),
        help='bash: eval "$(rig doctor completion bash)" in ~/.bashrc; zsh: the same '
        "in ~/.zshrc after compinit; fish: rig doctor completion fish > ~/.config/fish/completions/rig.fish",
    )


def run_completion(arguments: Namespace) -> None:
    """Run `rig doctor completion`.

    Print the completion script of a shell.
    """
    from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import completion_script

    print(completion_script(arguments.all_commands(), arguments.shell))


def arguments_of_kernels(parser: ArgumentParser) -> None:
    """Add the arguments of `rig doctor kernels` to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path, help="a hexapod with cameras")


def run_kernels(arguments: Namespace) -> None:
    """Run `rig doctor kernels`: compile what runs and measurements of a rig take.

    No later command waits for it then.
    """
    from calib.online.run_options_cameras_sensors_and_observer import compile_kernels_for_run
    from rig.formats.rig_toml import design_from_rig_toml

    design = design_from_rig_toml.load_design(arguments.design)
    print(
        "compiled: what runs and measurements of this rig take"
        if compile_kernels_for_run(design, in_two_processes=True)
        else "nothing compiled: ahead, only kernels of hexapods whose cameras see a cube on the platform are"
    )
