"""A recording from existing files: their tables, their names of images, their units, said in plain words and kept
as a recipe.
"""

from rig.formats.importers.foreign_file_import_recipe import Recipe, load_recipe, recipe_of_options, recipe_toml
from rig.formats.importers.recording_import_from_foreign_files import (
    ImportedRecording,
    assemble_recording,
    design_with_imported_cameras,
    unpack_recipe_bags,
    write_recording,
)

__all__ = [
    "ImportedRecording",
    "Recipe",
    "assemble_recording",
    "load_recipe",
    "recipe_of_options",
    "recipe_toml",
    "unpack_recipe_bags",
    "design_with_imported_cameras",
    "write_recording",
]
