"""Images of a recording -> its corners, whole or while it grows: read where markers ought to be; and whose marker each
is.
"""
