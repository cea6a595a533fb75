"""Real to sim: measured indentation trials in, fitted tissue with a certificate out."""
