"""The results of a sweep: one table of all cells, and whether the order of the policies holds in all of them."""
