"""The blind baselines that repeat the actions of another trial."""
