"""rig completion: print the completion script for bash, zsh or fish."""

from argparse import ArgumentParser, Namespace


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument(
        "shell",
        choices=("bash", "zsh", "fish"),
        help='bash: eval "$(rig completion bash)" in ~/.bashrc; zsh: the same '
        "in ~/.zshrc after compinit; fish: rig completion fish > ~/.config/fish/completions/rig.fish",
    )


def run(arguments: Namespace) -> None:
    """Print the shell's completion of all commands and options, file names where files are named."""
    import argparse
    from pathlib import Path

    import shtab

    parser = arguments.all_commands()
    commands = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    for command in commands.choices.values():
        for action in command._actions:
            if action.type is Path or getattr(action.type, "__name__", "") == "file_or_stdout":
                action.complete = shtab.FILE
    print(shtab.complete(parser, arguments.shell))
