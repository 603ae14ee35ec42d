"""What a machine answers when it is calibrated, kind by kind."""
