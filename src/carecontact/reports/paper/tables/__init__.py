"""The paper's tables, one file for each."""
