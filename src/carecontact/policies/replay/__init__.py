"""The blind baseline that repeats another trial's actions."""
