"""The product's own files: written whole or not at all, known again by who made them, never over what somebody else
made.
"""

from rig.formats.output_files.atomic_file_and_manifest import (
    MANIFEST,
    STANDARD_OUTPUT,
    FolderManifest,
    require_complete_folder,
    write_bytes,
    write_text,
)
from rig.formats.output_files.command_outputs import CommandOutputs

__all__ = [
    "MANIFEST",
    "STANDARD_OUTPUT",
    "FolderManifest",
    "CommandOutputs",
    "require_complete_folder",
    "write_bytes",
    "write_text",
]
