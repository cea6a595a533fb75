"""Runs of one protocol set side by side."""
