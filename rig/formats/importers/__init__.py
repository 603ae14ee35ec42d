"""A recording out of what people have: their tables, their names of images, their units, said in plain words and kept
as a recipe.
"""

from rig.formats.importers.import_recipe import Recipe, load, recipe_of_arguments, text
from rig.formats.importers.recording_import import Imported, assemble, unpacked, with_cameras, write

__all__ = ["Imported", "Recipe", "assemble", "load", "recipe_of_arguments", "text", "unpacked", "with_cameras", "write"]
