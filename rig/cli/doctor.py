"""rig doctor: check this computer's installation.

Packages, OpenGL, cameras, ports, disk space, threads.
"""

from argparse import ArgumentParser, Namespace

from rig.cli.shared.common_options import add_json_option, print_json


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
