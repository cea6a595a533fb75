"""Recorded trials in motion again: their states at any time, as video and in viewers."""
