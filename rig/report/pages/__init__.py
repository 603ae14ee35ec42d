"""Pages: those that commands write (document, parts, svg, figure), the one that a run serves (server), and what both
look like.
"""
