"""The catalogue of left-out physics, one file an effect; effect_list names them all."""
