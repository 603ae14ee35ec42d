"""rig doctor completion: print the shell completion script.

For bash, zsh or fish.
"""

from argparse import ArgumentParser, Namespace


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig doctor completion` to a parser."""
    parser.add_argument(
        "shell",
        choices=("bash", "zsh", "fish"),
        help='bash: eval "$(rig doctor completion bash)" in ~/.bashrc; zsh: the same '
        "in ~/.zshrc after compinit; fish: rig doctor completion fish > ~/.config/fish/completions/rig.fish",
    )


def run(arguments: Namespace) -> None:
    """Run `rig doctor completion`.

    Print the completion script of a shell.
    """
    from rig.cli.shared.argument_parser import completion_script

    print(completion_script(arguments.all_commands(), arguments.shell))
