"""The plan of a sweep: which policies run under which protocols and changes, as one run for each combination."""
