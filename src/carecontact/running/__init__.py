"""Runs trials: the worker that forks for each, the supervisor, its engines, and the checks before a run."""
