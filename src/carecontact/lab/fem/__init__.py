"""Soft tissue by finite elements: a reference for the simulated tissue that shares no equation with it."""
