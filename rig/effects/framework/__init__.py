"""What an effect is and how it is stated, checked, drawn at random, listed, and written as a file."""
