"""Data classes that every layer shares: observation, action, policy card, trial and protocol."""
