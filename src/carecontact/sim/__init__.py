"""A compiled world in motion: steps, controllers, rendering, and the tissue bench."""
