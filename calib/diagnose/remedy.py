"""What an owner can do about each effect of the catalogue, in a sentence."""

from rig.effects import ALL

REMEDIES = {kind.name: kind.action_at("strut 1") for kind in ALL}
