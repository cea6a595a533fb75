"""The null arm that repeats another trial's actions."""
