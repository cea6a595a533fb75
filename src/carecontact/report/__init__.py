"""Tables, pages and pictures that are made from scores and recordings alone."""
