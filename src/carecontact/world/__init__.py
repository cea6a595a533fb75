"""Builders of the compiled model around the person: robot, furniture, cameras, sensors, and what is drawn anew for each
seed."""
