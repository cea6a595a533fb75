"""The privileged baseline: it is given the trial's simulation, and its rate is the ceiling."""
