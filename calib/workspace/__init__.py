"""What a correction does to the workspace: poses lost and gained, and in each cell how near limits and singularities
are and how sure a pose is.
"""
