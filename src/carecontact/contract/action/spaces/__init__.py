"""Action spaces: one file each, found by their names."""
