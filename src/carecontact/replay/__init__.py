"""Recorded trials in motion again: their states at any time, videos of them, and viewers."""
