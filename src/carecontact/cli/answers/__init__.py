"""What commands answer with `--json`: one model for each kind of line, from which the JSON Schema files are made."""
