"""The product's own files: written whole or not at all, known again by who made them, never over what somebody else
made.
"""

from rig.formats.output_files.atomic_file_writing_and_process_locks import STANDARD_OUTPUT, write_bytes, write_text
from rig.formats.output_files.staged_command_outputs_with_overwrite_protection import CommandOutputs
from rig.formats.output_files.staged_folder_and_manifest import (
    MANIFEST,
    FolderManifest,
    require_folder_of_uninterrupted_command,
)

__all__ = [
    "MANIFEST",
    "STANDARD_OUTPUT",
    "FolderManifest",
    "CommandOutputs",
    "require_folder_of_uninterrupted_command",
    "write_bytes",
    "write_text",
]
