"""What a protocol says and how its file is read: the schema of every section, gates, tissue sets, overrides and
locks."""
