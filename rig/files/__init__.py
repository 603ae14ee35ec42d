"""The product's own files: written whole or not at all, known again by who made them, never over what somebody else made."""

from rig.files.made import MANIFEST, Made, complete
from rig.files.outputs import Outputs
from rig.files.whole import STANDARD_OUTPUT, write_bytes, write_text

__all__ = ["MANIFEST", "STANDARD_OUTPUT", "Made", "Outputs", "complete", "write_bytes", "write_text"]
