"""Tables and the HTML report of a run, made from scores and recordings alone."""
