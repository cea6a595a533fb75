"""Turns measured indentation trials into a fitted tissue row with a certificate."""
