"""Soft tissue by finite elements, as a judge of the simulated tissue that shares no equation with it."""
