"""Which trials to run, one process for each, and what is left behind when one crashes."""
