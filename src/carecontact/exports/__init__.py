"""Datasets in the formats of other projects, made of recordings."""
