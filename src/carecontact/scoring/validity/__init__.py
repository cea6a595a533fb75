"""Whether a recording is one that a simulation can have made, checked before anything is scored."""
