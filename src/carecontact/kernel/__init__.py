"""The compiled tissue, and what a person does by itself: MuJoCo engine plugins in C, and what finds and loads them."""
