"""The compiled tissue: a MuJoCo engine plugin in C, and what finds, checks and loads it."""
