"""Why a trial failed: the cause and the evidence for it."""
