"""Does anything that a policy is sent depend on what it must not know? Five parts, each able to fail."""
