"""The next experiment: what distinguishes the remaining hypotheses, at what cost, and with what chance."""

# the first plans of an investigation, where none is stated
FIRST = "moving:24,sobol:60"  # the first plan of a rig that may be exposed on the way
LOADED = (
    "payload:6"  # besides, where a load may be asked for: at constant load most of a sag hides in the joint geometry
)
STANDING = "sobol:60,ladder:1,repeat:12"  # of one whose struts must stand
