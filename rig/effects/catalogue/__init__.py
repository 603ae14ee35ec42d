"""The catalogue of unmodelled effects, one file an effect; effect_list names them all."""
