"""The tables and figures of the paper, made from any runs, with its published values beside ours."""
