"""Videos of recorded trials: what is drawn, how it is lit, the charts beside it, and the file."""
