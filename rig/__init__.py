"""The machine: what it is, how it moves, how it is commanded, how it misbehaves."""

from rig.compiled import keep_kernels

keep_kernels()
