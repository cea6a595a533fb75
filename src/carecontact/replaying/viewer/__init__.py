"""Recorded trials in Rerun and in MuJoCo's own viewer."""
