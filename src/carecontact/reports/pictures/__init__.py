"""Pictures of what a policy saw and noted."""
