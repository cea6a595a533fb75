"""Runs trials, each in a process of its own, and records those whose process crashes."""
