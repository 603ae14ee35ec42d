"""What the pages of measuring, lenses, workspaces and the rest say, each in a module of its own; rig.report.pages is
their common template.
"""
