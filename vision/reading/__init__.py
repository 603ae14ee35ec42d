"""Images of a recording -> its corners: read where markers ought to be, whole or while the recording grows."""
