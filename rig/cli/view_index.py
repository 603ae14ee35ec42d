"""rig view index: write an index page of pages.

Of all pages below a folder, each with its verdict.
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.cli.shared.common_options import add_overwrite_option
from rig.errors import RigError


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig view index` to a parser."""
    parser.add_argument(
        "folder",
        metavar="DIR",
        type=Path,
        nargs="?",
        default=Path("."),
        help="gets index.html; this one by default. Commands that write a page below it keep it up to date",
    )
    add_overwrite_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig view index`.

    Write the index page of all pages below a folder.
    """
    from rig.report.pages.page_templates_and_index_page import NAME, list_pages_below_folder, write_index_page

    if not arguments.folder.is_dir():
        raise RigError(f"{arguments.folder}: no such folder")
    write_index_page(arguments.outputs.file(arguments.folder / NAME), arguments.folder)
    known = list_pages_below_folder(arguments.folder)
    for found in known:
        print(f"{found.state:6} {found.path}: {found.why}")
    print(f"written: {arguments.folder / NAME}" + ("" if known else "; there is no page yet"))
