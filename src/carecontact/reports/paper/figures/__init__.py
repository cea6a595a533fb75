"""The paper's figures, one file for each."""
