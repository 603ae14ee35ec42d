"""What physics the model leaves out: where, which, how large, proved on stretches that were held out."""
