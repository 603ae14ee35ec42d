"""A rig that is not there: a secret machine, its recordings and pictures, blind campaigns."""
